"""The overview: each panel shows the numbers of the result, and the missing force has honest errors."""

import numpy as np
import pytest
import xarray as xr
from helpers import FIVE, NOISE, W, decay, library_of_formulas, overlaps, paper_run
from matplotlib.collections import QuadMesh

import sysid_trib as st
from sysid_trib.plots.at_a_glance import COEFFICIENT_RANGE
from sysid_trib.plots.overview_data import overview_data
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation.residual_force import model_force, residual_force

FORCES = st.load_library()
PANELS = 9


@pytest.fixture(scope="module")
def tree():
    record = paper_run(FIVE, sampling_rate=50.0).decay(7)
    pair = [method.identify(record, FORCES) for method in (st.methods.Averaging(), st.methods.Direct())]
    return st.cross_check(record, *pair, draws=16)


@pytest.fixture(scope="module")
def simpler(tree):
    """The same with a force left out, and one of the methods broken."""
    record, library = tree["record"].to_dataset()[["angle"]], FORCES.select(["lambda", "zeta", "epsilon"])
    pair = [method.identify(record, library) for method in (st.methods.Averaging(), st.methods.Direct())]
    return st.cross_check(record, *pair, draws=16)


def texts(figure):
    return [text for panel in figure.axes for text in (panel.get_xlabel(), panel.get_ylabel())]


def test_every_panel_has_axes_with_units(tree):
    figure = st.plots.overview(tree, width=7.2)
    figure.canvas.draw()
    panels = [panel for panel in figure.axes if panel.get_subplotspec() is not None]
    assert len([panel for panel in panels if panel.get_title(loc="left").startswith("(")]) == PANELS
    assert figure.get_size_inches()[0] == 7.2
    for unit in ("(rad)", "(mrad)", "(s)", "(%)"):
        assert any(unit in text for text in texts(figure))


@pytest.mark.parametrize("which", ["tree", "simpler"])
def test_nothing_overlaps(which, request):
    figure = st.plots.overview(request.getfixturevalue(which), width=3.46)
    assert overlaps(figure) == []


def test_intervals_end_before_the_numbers(tree):
    """Of a coefficient that is not determined, an arrow says that its interval goes on."""
    undetermined = tree.copy(deep=True)
    errors = undetermined["direct"].standard_error
    row = errors.force.values.tolist().index("nu")
    errors.values[row] = 3.0 * abs(undetermined["direct"].coefficient.values[row])
    panel = next(p for p in st.plots.overview(undetermined).axes if "intervals" in p.get_xlabel())
    drawn = (np.atleast_1d(part.get_xdata()) for part in panel.lines[:-2])
    right = max(float(np.max(x)) for x in drawn if x.size)
    assert right == COEFFICIENT_RANGE[1]
    arrows = [part for part in panel.lines if part.get_marker() == ">"]
    assert [round(part.get_ydata()[0]) for part in arrows] == [row]
    numbers = [text.get_window_extent().x0 for text in panel.texts]
    assert min(numbers) > panel.transData.transform((right, row))[0]


def test_shares_are_those_of_the_result(tree):
    data, direct = overview_data(tree), tree["direct"].to_dataset()
    a = float(data.weighed.amplitude[-1])
    assert a == pytest.approx(float(tree["envelope"].amplitude.max()))
    expected = st.physics.weights(direct, a)
    np.testing.assert_allclose(data.weighed.decay_share.isel(amplitude=-1), expected.decay_share)


def test_errors_of_the_missing_force_are_those_of_the_noise():
    """Of a right model its cells are standard normal: over records the RMS of all is one."""
    run = paper_run(FIVE)
    known = []
    for seed in range(6):
        record = run.decay(seed)
        result = st.methods.Direct(random_force="off").identify(record, FORCES)
        surface = residual_force(record, result)
        z = (surface.force / surface.force_standard_error).values
        known.append(np.sqrt(np.nanmean(z**2)))
    assert np.mean(known) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("formula", "axis", "expected"),
    [("x**3", "x", lambda x: 0.4 * x**3), ("v*abs(v)", "v", lambda v: 0.06 * v * np.abs(v))],
)
def test_the_missing_force_is_the_one_that_was_left_out(formula, axis, expected):
    library = library_of_formulas(zeta="2*v", hidden=formula)
    coefficient = 0.4 if axis == "x" else 0.06
    time = np.arange(0.0, 40.0, 0.01)
    motion = trajectory(st.Model(library, {"zeta": 0.004, "hidden": coefficient}, W), time, 0.5, 0.0).angle
    record = decay(time, motion, 3, NOISE)
    whole = st.methods.Direct(random_force="off", reference_frequency=W).identify(record, library)
    lacking = whole.sel(force=["zeta"], other_force=["zeta"])
    surface = residual_force(record, lacking)
    at, error = surface[axis], surface[f"force_of_{axis}_standard_error"].values
    mean = surface[f"force_of_{axis}"].values
    inner = np.abs(at.values) < 0.45
    # Means over cells of a curved force: within the errors and a hundredth of its largest value.
    away = np.abs(mean - expected(at.values))[inner]
    assert np.all(away < 5.0 * error[inner] + 0.05 * np.max(np.abs(expected(at.values))))
    assert np.max(np.abs(mean / error)) > 20.0


def test_force_along_a_motion_is_the_models():
    library = library_of_formulas(zeta="2*v", cubic="x**3")
    model = st.Model(library, {"zeta": 0.01, "cubic": 0.3}, W)
    tau = np.linspace(0.0, 6.0, 50)
    x, v = np.cos(tau), -np.sin(tau)
    np.testing.assert_allclose(model_force(model, tau, x, v, tau / W), 0.02 * v + 0.3 * x**3)


def test_a_broken_model_never_sets_a_scale(tree):
    broken = tree.copy(deep=True)
    broken["record"].simulated_angle.values[0] = 50.0 * np.sin(broken["record"].time.values)
    # The first two of an overview are the backbone.
    for panel in st.plots.overview(broken).axes[2:4]:
        assert max(map(abs, panel.get_ylim())) < 10.0
    broken["record"].simulated_angle.values[1] = np.nan
    figure = st.plots.overview(broken)
    assert any(text.get_text() == "all methods failed" for panel in figure.axes for text in panel.texts)
    assert any(isinstance(part, QuadMesh) for panel in figure.axes for part in panel.collections)


def test_another_unit_is_drawn_as_it_is(tree):
    other = tree.copy(deep=True)
    other["record"].angle.attrs["units"] = other["backbone"].amplitude.attrs["units"] = "mm"
    figure = st.plots.overview(other)
    assert not any("rad)" in text for text in texts(figure))
    assert any(text == "displacement (mm)" for text in texts(figure))


@pytest.mark.slow
def test_overview_of_a_comparison_and_of_a_discovery(tree):
    record = tree["record"].to_dataset()[["angle"]]
    compared = st.compare(record, FORCES, [st.methods.Direct(), st.methods.Averaging()])
    data = overview_data(compared)
    assert list(data.results) == [compared["comparison"].attrs["best"]]
    # The legend names the only model; a long name would not fit beside the panel.
    assert st.plots.overview(compared).axes[1].get_ylabel() == "record \N{MINUS SIGN} model (mrad)"
    assert data.holds
    assert st.plots.overview(compared).axes
    offered = FORCES.select(["nu", "epsilon", "alpha"])
    named = st.discover(record, FORCES.select(["lambda", "zeta", "delta"]), offered)
    data = overview_data(named)
    assert set(data.weighed.force.values) == {"lambda", "zeta", "delta", "nu", "epsilon"}
    assert st.plots.overview(named).axes
    assert isinstance(data.missing, xr.Dataset)
