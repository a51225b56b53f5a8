"""Laws in SI units, the coefficient of friction, the calibration's error, and two samples' laws compared."""

import json

import numpy as np
import pytest
import xarray as xr
from command_line import run as command
from helpers import paper_run
from known_results import PAPER, W, correlated, known

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.printing.law_difference import law_sentences
from sysid_trib.results.law_curves import stretches
from sysid_trib.results.variables import group_names
from sysid_trib.smooth_laws import bands

INERTIA, LOAD, RADIUS = (2e-3, 4e-5), (3.0, 0.06), (0.02, 4e-4)
DRY = {"lambda": 1e-3, "zeta": 0.004, "delta": 0.02}


def with_laws(coefficients, covariance=None, *, library=None, largest=0.3):
    """An identification whose laws follow from its coefficients."""
    result = known(coefficients, covariance, library=library)
    laws = bands.laws_of(result, {"x": largest, "v": largest * W})
    values, places = bands.law_variables(laws, [np.zeros_like(law.covariance) for law in laws])
    return result.assign_coords(places).assign(values)


def uncertain(coefficients, part=0.01, **options):
    values = np.array([*coefficients.values(), W])
    return with_laws(coefficients, correlated(values, part), **options)


def friction(coefficients, speed):
    """Friction over the inertia at a speed in rad/s."""
    v = speed / W
    return W**2 * (coefficients["lambda"] + 2.0 * coefficients["zeta"] * v + coefficients["delta"] * v**2)


def test_laws_and_mu_are_the_forces_of_the_coefficients():
    data = st.physics.laws_in_si(uncertain(DRY), inertia=INERTIA, load=LOAD, radius=RADIUS)
    torque = INERTIA[0] * friction(DRY, data.speed.values)
    np.testing.assert_allclose(data.friction, torque, rtol=1e-12)
    np.testing.assert_allclose(data.restoring, INERTIA[0] * W**2 * data.displacement, rtol=1e-12)
    np.testing.assert_allclose(data.friction_coefficient, torque / (LOAD[0] * RADIUS[0]), rtol=1e-12)
    np.testing.assert_allclose(data.sliding_speed, RADIUS[0] * data.speed)
    units = {"friction": "N m", "restoring": "N m", "friction_coefficient": "1", "sliding_speed": "m/s"}
    assert {name: data[name].attrs["units"] for name in units} == units
    assert np.all(data.friction_coefficient_low < data.friction_coefficient)


def test_errors_of_given_quantities_agree_with_repeated_measurements():
    """The stated error is the scatter of the law at a sliding speed over draws of measured quantities."""
    result = with_laws(DRY)
    stated = st.physics.laws_in_si(result, inertia=INERTIA, load=LOAD, radius=RADIUS)
    random, found = np.random.default_rng(1), []
    at = stated.sliding_speed.values[[0, 20, 38]]
    for _ in range(300):
        given = [(random.normal(*pair), 0.0) for pair in (INERTIA, LOAD, RADIUS)]
        drawn = st.physics.laws_in_si(result, inertia=given[0], load=given[1], radius=given[2])
        found.append(np.interp(at, drawn.sliding_speed, drawn.friction_coefficient))
    error = stated.friction_coefficient_standard_error.values[[0, 20, 38]]
    np.testing.assert_allclose(np.std(found, axis=0), error, rtol=0.15)
    # One error for all speeds: their errors are correlated.
    covariance = stated.friction_covariance.values
    root = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(covariance / np.outer(root, root), 1.0, rtol=1e-9)
    np.testing.assert_allclose(root / stated.friction, INERTIA[1] / INERTIA[0], rtol=1e-9)


def test_calibration_error_is_in_the_laws_except_proportional_ones():
    part = 0.02
    result = st.physics.with_scale_error(with_laws(DRY), part)
    # F - v F' of a constant is it, of a square minus it, of a straight line zero.
    v = result.speed.values / W
    expected = part * W**2 * np.abs(DRY["lambda"] - DRY["delta"] * v**2)
    inner = slice(1, -1)
    np.testing.assert_allclose(
        result.friction_error_of_calibration.values[inner], expected[inner], rtol=0.05, atol=1e-5
    )
    assert result.restoring_error_of_calibration.max() < 1e-6
    np.testing.assert_allclose(result.friction_high - result.friction, result.friction - result.friction_low)
    tree = xr.DataTree.from_dict({"direct": with_laws(DRY)})
    again = st.physics.with_scale_error(tree, part)["direct"]
    np.testing.assert_array_equal(again.friction_standard_error, result.friction_standard_error)


def in_mm(result):
    """The laws as those of a displacement."""
    changed = result.copy()
    for name, variable in changed.variables.items():
        if str(variable.attrs.get("units", "")).startswith("rad"):
            units = variable.attrs["units"].replace("rad", "mm")
            changed[name] = (variable.dims, variable.values, variable.attrs | {"units": units})
    return changed


def test_a_displacement_takes_a_mass_and_gives_newtons():
    result = uncertain(DRY)
    shown = in_mm(result).assign(noise=result.noise.assign_attrs(units="mm"))
    data = st.physics.laws_in_si(shown, mass=(0.5, 0.005), load=LOAD)
    np.testing.assert_allclose(data.speed, 1e-3 * result.speed)
    np.testing.assert_allclose(data.friction, 0.5e-3 * result.friction)
    np.testing.assert_allclose(data.friction_coefficient, data.friction / LOAD[0])
    assert (data.friction.attrs["units"], data.speed.attrs["units"]) == ("N", "m/s")
    assert data.displacement.attrs["units"] == "m"
    with pytest.raises(UsageError, match="Give the mass"):
        st.physics.laws_in_si(shown, inertia=INERTIA)
    for unit in ("px", "V", "au"):
        of_unit = result.assign(noise=result.noise.assign_attrs(units=unit))
        with pytest.raises(UsageError, match=f"torques of an angle; this record is in {unit}"):
            st.physics.laws_in_si(of_unit, inertia=INERTIA)
    with pytest.raises(UsageError, match="this record is in rad"):
        st.physics.laws_in_si(result, mass=(0.5, 0.0))


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({}, "SI units need the inertia"),
        ({"inertia": INERTIA, "load": LOAD}, "SI units need the inertia"),
        ({"inertia": (-1.0, 0.0)}, "must be a positive number"),
        ({"inertia": INERTIA, "load": (0.0, 0.0), "radius": RADIUS}, "must be a positive number"),
    ],
)
def test_missing_or_impossible_quantities_are_refused(given, match):
    with pytest.raises(UsageError, match=match):
        st.physics.laws_in_si(uncertain(DRY), **given)


def test_an_identification_without_laws_is_refused():
    with pytest.raises(UsageError, match="contains no friction law"):
        st.physics.laws_in_si(known(PAPER), inertia=INERTIA)


BOTH_WAYS = parse_library(
    {
        "force": [
            {"symbol": "lambda", "formula": "sign(v)"},
            {"symbol": "even", "formula": "abs(v)"},
        ]
    },
    "test",
)


def test_the_figure_and_table_show_visited_range_band_and_units():
    given = {"inertia": INERTIA, "load": LOAD, "radius": RADIUS}
    data = st.physics.laws_in_si(uncertain(DRY), **given)
    (panel,) = st.plots.friction_coefficient(data).axes
    assert panel.get_xlabel() == "sliding speed (m/s)"
    visited = data.sliding_speed.values[data.speed_visited.values]
    np.testing.assert_array_equal(panel.lines[0].get_xdata(), visited)
    plain = st.plots.friction_coefficient(st.physics.laws_in_si(uncertain(DRY), inertia=INERTIA)).axes[0]
    assert (plain.get_xlabel(), plain.get_ylabel()) == ("speed (rad/s)", "friction (N m)")
    table = st.physics.law_table(data, "friction_coefficient")
    assert list(table)[:2] == ["sliding_speed (m/s)", "friction_coefficient (1)"]
    assert len(table) == data.sizes["speed"]
    with pytest.raises(UsageError, match="no friction_coefficient"):
        st.physics.law_table(uncertain(DRY), "friction_coefficient")
    # A law of both directions: two curves.
    asymmetric = st.physics.laws_in_si(uncertain({"lambda": 1e-3, "even": 2e-3}, library=BOTH_WAYS), **given)
    (panel,) = st.plots.friction_coefficient(asymmetric).axes
    assert [text.get_text() for text in panel.get_legend().get_texts()].count("95 % band") == 2
    assert all(np.all(line.get_xdata() >= 0.0) for line in panel.lines)


# Two samples.

MORE = DRY | {"delta": 0.03}


def test_where_laws_differ_is_where_the_band_excludes_zero():
    first, second = uncertain(MORE, 0.002), uncertain(DRY, 0.002, largest=0.2)
    found = st.physics.law_difference(first, second)
    expected = friction(MORE, found.speed.values) - friction(DRY, found.speed.values)
    np.testing.assert_allclose(found.friction_difference, expected, atol=2e-5)
    # The common range is that of the smaller record.
    assert found.speed.max() <= 0.2 * W
    error = np.hypot(found.friction_first_standard_error, found.friction_second_standard_error)
    np.testing.assert_allclose(found.friction_difference_standard_error, error, rtol=1e-9)
    assert found.attrs["verdict"] == "friction differs"
    assert found.friction_p_value < 1e-6
    assert found.restoring_p_value > 0.5
    excluded = (found.friction_difference_low > 0.0) | (found.friction_difference_high < 0.0)
    np.testing.assert_array_equal(found.friction_differs, excluded)
    turned = st.physics.law_difference(second, first)
    np.testing.assert_allclose(turned.friction_z, -found.friction_z)
    same = st.physics.law_difference(first, first)
    assert (same.attrs["verdict"], same.friction_p_value.item()) == ("no difference", 1.0)
    with pytest.raises(UsageError, match="two results of laws"):
        st.physics.law_difference(first, known(PAPER))
    with pytest.raises(UsageError, match="no range of speed in common"):
        st.physics.law_difference(first, uncertain(DRY, largest=0.005))
    (left, _) = st.plots.law_difference(found).axes
    assert left.get_xlabel() == "speed (rad/s)"


@pytest.mark.slow
def test_equal_laws_differ_at_the_rate_of_the_level():
    """In draws of two samples with the same law 5 % of bands exclude zero, and p-values are uniform."""
    values = np.array([*DRY.values(), W])
    covariance = correlated(values, 0.01)
    covariance[-1] = covariance[:, -1] = 0.0
    root = np.linalg.cholesky(covariance[:-1, :-1])
    random, p_values, differing = np.random.default_rng(2), [], []
    for _ in range(100):
        pair = [
            with_laws(dict(zip(DRY, values[:-1] + root @ random.standard_normal(3), strict=True)), covariance)
            for _ in range(2)
        ]
        found = st.physics.law_difference(*pair)
        p_values.append(found.friction_p_value.item())
        differing.append(bool(found.friction_differs.any()))
    assert 0 <= sum(differing) <= 12
    assert 0.35 < np.mean(p_values) < 0.65
    assert 0.15 < np.mean(np.array(p_values) < 0.3) < 0.45


def test_an_odd_law_is_compared_with_one_of_both_directions():
    odd = uncertain({"lambda": 1e-3}, 0.001, library=BOTH_WAYS)
    both = uncertain({"lambda": 1e-3, "even": 2e-3}, 0.001, library=BOTH_WAYS)
    found = st.physics.law_difference(odd, both)
    v = found.speed.values / W
    np.testing.assert_allclose(found.friction_difference, -(W**2) * 2e-3 * np.abs(v), atol=1e-9)
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=found.attrs), "law_difference": found})
    first, _ = law_sentences(tree)
    # Against the motion: larger one way, smaller the other.
    assert "larger at -" in first
    assert "smaller at 0." in first


def test_stretches_of_places():
    places, chosen = np.arange(6.0), np.array([True, False, True, True, False, True])
    assert stretches(places, chosen) == [(0.0, 0.0), (2.0, 3.0), (5.0, 5.0)]
    assert stretches(places, ~chosen & False) == []


@pytest.mark.slow
def test_the_command_compares_laws(tmp_path):
    runs = {
        name: paper_run(c, duration=15.0, sampling_rate=50.0) for name, c in {"a": MORE, "b": DRY}.items()
    }
    for seed, (name, run) in enumerate(runs.items()):
        run.decay(seed).to_dataframe().to_csv(tmp_path / f"{name}.csv")
    files = [str(tmp_path / f"{name}.csv") for name in runs]
    out, page = str(tmp_path / "d.nc"), str(tmp_path / "d.html")
    ending = command("difference", *files, "--laws", "-o", out, "--plot", str(tmp_path))
    assert ending.status == 0, ending.err
    assert ending.out.startswith("The friction of a.csv is larger at ")
    assert (tmp_path / "law_difference.pdf").exists()
    data = json.loads(command("difference", *files, "--laws", "--json").out)
    assert data["laws"]["verdict"] == "friction differs"
    assert len(data["laws"]["friction"]["difference"]) == len(data["laws"]["friction"]["speed"])
    kept = st.load(out)
    assert {"law_difference", "laws_first", "laws_second"} <= set(kept.children)
    assert command("report", out, "-o", page).status == 0
    assert group_names("record", 2)[1] in kept.children


@pytest.mark.slow
def test_the_command_laws_gives_the_coefficient_of_friction(tmp_path):
    record, table = tmp_path / "a.csv", tmp_path / "laws.csv"
    paper_run(DRY, duration=15.0, sampling_rate=50.0).decay(0).to_dataframe().to_csv(record)
    given = ("--inertia", "2e-3±4e-5", "--load", "3±0.06", "--radius", "0.02±4e-4", "--scale", "1±0.005")
    ending = command("laws", str(record), *given, "--csv", str(table), "--plot", str(tmp_path), "--json")
    assert ending.status == 0, ending.err
    si = json.loads(ending.out)["si"]
    speed, mu, error = (
        np.array(si[name])
        for name in ("sliding_speed", "friction_coefficient", "friction_coefficient_standard_error")
    )
    truth = INERTIA[0] * friction(DRY, speed / RADIUS[0]) / (LOAD[0] * RADIUS[0])
    visited = np.array(si["speed_visited"])
    assert np.all(np.abs(mu - truth)[visited] < 4.0 * error[visited])
    assert np.all(error > 0.025 * mu)
    assert si["units"]["sliding_speed"] == "m/s"
    assert "direct in SI units,friction_coefficient,sliding_speed," in table.read_text()
    assert (tmp_path / "friction_coefficient.pdf").exists()
    refused = command("laws", str(record), "--load", "3")
    assert refused.status != 0
    assert "coefficient of friction also needs the load" in refused.err
