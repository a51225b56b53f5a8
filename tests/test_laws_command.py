"""`sysid-trib laws`: the friction law and the restoring force as curves, printed, drawn and written."""

import csv
import json
import re

import numpy as np
import pytest
from command_line import run, write_csv

import sysid_trib as st
from sysid_trib.printing.laws import laws_blocks, laws_csv, laws_json, laws_latex
from sysid_trib.reporting.contents import contents_of
from sysid_trib.reporting.page import page
from sysid_trib.results import law_curves
from sysid_trib.results.kinds import kind_of

FREQUENCY, AMPLITUDE, NOISE = 9.0, 0.3, 1e-4
TIME = np.arange(0.0, 12.0, 0.02)
COEFFICIENTS = {"zeta": 0.01, "delta": 0.03, "epsilon": 0.2}


def record_of(coefficients=COEFFICIENTS, *, time=TIME, amplitude=AMPLITUDE, seed=0):
    library = st.load_library()
    motion = st.simulate(st.Model(library, coefficients, FREQUENCY), time, amplitude)
    return time, motion.angle.values + NOISE * np.random.default_rng(seed).standard_normal(len(time))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A record, a second run, one that swings farther, and the output of the command for the first."""
    there = tmp_path_factory.mktemp("laws")
    write_csv(there / "run.csv", *record_of())
    write_csv(there / "large.csv", *record_of(amplitude=0.4, seed=1))
    outputs = ("-o", there / "laws.nc", "--csv", there / "laws.csv", "--latex", there / "laws.tex")
    ending = run("laws", there / "run.csv", "--test", there / "large.csv", "--json", *outputs)
    assert (ending.status, ending.err) == (0, "")
    (there / "laws.json").write_text(ending.out, encoding="utf-8")
    return there


@pytest.fixture(scope="module")
def tree(folder):
    return st.load(folder / "laws.nc")


def true_friction(speed):
    v = speed / FREQUENCY
    return FREQUENCY**2 * (2.0 * COEFFICIENTS["zeta"] * v + COEFFICIENTS["delta"] * v * np.abs(v))


def test_bands_hold_the_laws_that_made_the_record(tree):
    result = st.best(tree)
    seen = result.speed_visited.values
    speed, x = result.speed.values[seen], result.displacement.values[result.displacement_visited.values]
    restoring = FREQUENCY**2 * (x + COEFFICIENTS["epsilon"] * x**3)
    for law, truth in (("friction", true_friction(speed)), ("restoring", restoring)):
        low, high = (result[f"{law}_{end}"].values[: len(truth)] for end in ("low", "high"))
        assert np.all((low <= truth) & (truth <= high)), law


def test_json_has_the_names_of_the_variables_and_the_numbers_of_the_result(folder, tree):
    data = json.loads((folder / "laws.json").read_text(encoding="utf-8"))
    assert data["answer"] == tree["judged"].attrs["preferred"] == "direct"
    assert data["verdict"] == "explained"
    for name, method in data["methods"].items():
        for key in ("speed", "friction", "friction_low", "friction_high", "restoring", "displacement"):
            np.testing.assert_allclose(method[key], tree[name][key].values)
    assert len(data["agreement"]["friction_z"]) == tree["agreement"].sizes["speed"]
    assert data["feeds_energy"] == {"certainly": [], "seemingly": [], "beyond": []}
    assert data["test"][0]["residual_over_motion"] < 0.01


def test_csv_and_latex_hold_the_preferred_laws_with_their_bands(folder, tree):
    rows = list(csv.DictReader((folder / "laws.csv").read_text(encoding="utf-8").splitlines()))
    friction = [row for row in rows if row["law"] == "friction"]
    result = st.best(tree)
    np.testing.assert_allclose([float(row["value"]) for row in friction], result.friction.values)
    np.testing.assert_allclose([float(row["low"]) for row in friction], result.friction_low.values)
    assert {row["unit_at"] for row in friction} == {"rad/s"}
    assert {row["visited"] for row in rows} == {"True", "False"}
    latex = (folder / "laws.tex").read_text(encoding="utf-8")
    assert latex.count(r"\begin{tabular}") == 2
    assert r"$\mathrm{rad}\,\mathrm{s}^{-2}$" in latex
    assert "extrapolated" in latex


def test_a_saved_result_prints_the_same(folder, tree):
    assert kind_of(tree) == "laws"
    again = folder / "again.nc"
    st.save(tree, again)
    assert st.load(again).identical(tree)
    assert laws_csv(st.load(again)) == (folder / "laws.csv").read_text(encoding="utf-8")


def test_the_page_contains_the_figure_and_its_command(folder, tree):
    text = page(tree)
    assert text.count("<svg") == 1
    headings = re.findall(r"<h2>(.*?)</h2>", text)
    assert headings[:2] == ["Friction against speed", "Restoring force against displacement"]
    assert "tree = st.laws(decay)" in text
    ending = run("report", folder / "laws.nc", "-o", folder / "laws.html")
    assert (ending.status, ending.err) == (0, "")


def test_the_equation_is_exported(folder):
    ending = run("export", folder / "laws.nc")
    assert ending.status == 0
    names: dict = {}
    exec(compile(ending.out, "laws", "exec"), names)
    at_rest = names["f"](0.0, names["start"](0.0, 1.5))
    assert -at_rest[1] == pytest.approx(true_friction(1.5), rel=0.02)


def test_a_table_shows_speeds_up_to_the_range_and_one_beyond(folder):
    ending = run("laws", folder / "run.csv", "--fix", "lambda=0")
    assert ending.status == 0
    assert ending.out.startswith("The laws explain the record: the residual is noise.\n")
    assert ending.out.count("visited     ") == 14
    rows = [line for line in ending.out.splitlines() if line.endswith("extrapolated")]
    assert len(rows) == 2
    assert "The methods agree" in ending.out
    assert "To see whether another record of the rig follows these laws: sysid-trib laws" in ending.out


def test_a_prediction_that_leaves_the_range_is_reported(folder):
    ending = run("laws", folder / "run.csv", "--test", folder / "large.csv", "--quiet")
    assert "beyond the 0.3 rad covered by the laws" in ending.out


@pytest.mark.slow
def test_a_displacement_is_shown_in_its_unit(folder):
    time, x = record_of()
    write_csv(folder / "mm.csv", time, 100.0 * x, "time (s),displacement (mm)")
    ending = run("laws", folder / "mm.csv", "-o", folder / "mm.nc")
    assert ending.status == 0, ending.err
    assert "Friction over the mass (mm/s^2) against speed (mm/s)" in ending.out
    result = st.best(st.load(folder / "mm.nc"))
    visited = result.displacement.values[result.displacement_visited.values]
    assert visited.max() == pytest.approx(100.0 * AMPLITUDE, rel=0.01)
    assert result.speed.attrs["units"] == "mm/s"
    assert np.interp(150.0, result.speed, result.friction) == pytest.approx(
        100.0 * true_friction(1.5), rel=0.02
    )


def test_friction_that_feeds_energy_in_is_reported(tree):
    """A law whose band is below zero at low speed, one that may be, and a continuation that falls below."""
    changed = tree.copy(deep=True)
    result = changed["direct"].to_dataset()
    friction, high, low = (
        result[name].values.copy() for name in ("friction", "friction_high", "friction_low")
    )
    friction[:6], high[:3], low[:6], high[3:6] = -0.2, -0.1, -0.3, 0.1
    friction[-2:] = -1.0
    result = result.assign(
        friction=("speed", friction), friction_high=("speed", high), friction_low=("speed", low)
    )
    step = result.speed.values[0]
    found = law_curves.feeding(result)
    np.testing.assert_allclose(found["certainly"], [(step, 3 * step)])
    np.testing.assert_allclose(found["seemingly"], [(4 * step, 6 * step)])
    np.testing.assert_allclose(found["beyond"], [(49 * step, 50 * step)])
    changed["direct"].dataset = result
    said = "\n".join(sentence for block in laws_blocks(changed) for sentence in block.sentences)
    assert "Friction feeds energy in at" in said
    assert "does not determine whether it feeds energy in" in said
    assert "would feed energy in at" in said


def test_a_law_that_is_not_odd_is_compared_by_its_odd_part(tree):
    """A law of both sides, with a difference between the directions that averages do not see."""
    result = tree["direct"].to_dataset()
    half = result.sizes["speed"]
    speed = result.speed.values
    both = np.concatenate([-speed[::-1], speed])
    even = 0.3 * speed**2
    covariance = np.kron(np.eye(2), result.friction_covariance.values)
    values = np.concatenate([(even - result.friction.values)[::-1], even + result.friction.values])
    names = ("friction", "friction_standard_error", "friction_low", "friction_high", "friction_covariance")
    wide = result.drop_dims(["speed", "other_speed"]).assign_coords(speed=both, other_speed=both)
    wide = wide.assign(
        {
            names[0]: ("speed", values),
            names[1]: ("speed", np.ones(2 * half)),
            names[2]: ("speed", values - 1.0),
            names[3]: ("speed", values + 1.0),
            names[4]: (("speed", "other_speed"), covariance),
            "speed_visited": ("speed", np.abs(both) <= speed[39] * 1.001),
        }
    )
    odd = law_curves.odd_part(wide, "friction")
    np.testing.assert_allclose(odd.friction, result.friction, atol=1e-12)
    places, z = law_curves.apart({"averaging": result, "direct": wide}, "friction")
    np.testing.assert_allclose(places, speed[:40])
    np.testing.assert_allclose(z, 0.0, atol=1e-6)
    curves = law_curves.curves_of({"averaging": result, "direct": wide}, "friction", "direct", mirrored=True)
    np.testing.assert_allclose(curves["averaging"].values, -curves["averaging"].values[::-1])


def test_few_half_periods_give_the_laws_of_the_named_forces(tmp_path):
    write_csv(tmp_path / "short.csv", *record_of(time=np.arange(0.0, 2.3, 0.01)))
    ending = run("laws", tmp_path / "short.csv")
    assert ending.status == 0, ending.err
    # The first words, so that nobody takes the figure for a measured curve.
    assert ending.out.startswith("The record does not determine a curve. Laws of the named forces")
    assert re.search(r"[4-7] half periods are too few for a curve", ending.out)
    assert re.search(r"Named forces by \w+: lambda = .* ± ", ending.out)
    assert "Next: sysid-trib identify " in ending.out


def test_the_sections_of_the_page_have_titles_of_their_own(tree):
    titles = [section["title"] for section in contents_of(tree)[2]]
    assert len(titles) > 4
    assert sorted(set(titles)) == sorted(titles)


@pytest.mark.parametrize("width", [88.0, 180.0])
def test_the_label_of_the_restoring_force_takes_one_line(tree, width):
    figure = st.plots.laws(tree, width=width / 25.4)
    figure.draw_without_rendering()
    label = figure.axes[1].get_ylabel()
    assert "w^2" in label
    assert "\n" not in label


def test_figures_fit_a_column_and_a_page(tree):
    for width in (3.46, 7.2):
        figure = st.plots.laws(tree, width=width)
        assert figure.get_size_inches()[0] == width
        labels = [ax.get_xlabel() for ax in figure.axes]
        assert labels == ["speed (rad/s)", "displacement (rad)"]


def test_a_result_whose_methods_all_failed_is_drawn_and_reported(tree):
    """As `laws` makes it of a record whose amplitude hardly changes, where the motion of direct diverges."""
    failed = tree.copy(deep=True)
    failed["judged"].dataset = failed["judged"].to_dataset().sel(model=["direct"])
    failed["judged"].dataset = (
        failed["judged"].to_dataset().assign(failure=("model", ["its motion diverges"]))
    )
    failed["judged"].attrs |= {"preferred": "direct", "averaging_failed": "no envelope"}
    del failed["averaging"], failed["agreement"]
    figure = st.plots.laws(failed)
    figure.draw_without_rendering()
    assert [[text.get_text() for text in ax.texts] for ax in figure.axes] == [["all methods failed"]] * 2
    assert "Direct failed: its motion diverges" in page(failed)


def test_latex_and_json_of_one_method_alone(tree):
    """A result whose averaging failed, as `laws` makes it."""
    alone = tree.copy(deep=True)
    alone["judged"].dataset = alone["judged"].to_dataset().sel(model=["direct"])
    alone["judged"].attrs["averaging_failed"] = "no envelope"
    del alone["averaging"], alone["agreement"]
    said = "\n".join(sentence for block in laws_blocks(alone) for sentence in block.sentences)
    assert "Averaging failed: no envelope. The laws are those of direct alone." in said
    assert list(laws_json(alone)["methods"]) == ["direct"]
    assert r"\toprule" in laws_latex(alone)


def test_formulas_within_the_band_stand_in_a_table_with_their_residuals(tree):
    """One long line with all formulas of a law was not read."""
    blocks = [block for block in laws_blocks(tree) if block.caption.startswith("Formulas within the band")]
    assert len(blocks) == 2
    for block, law in zip(blocks, ("friction", "restoring"), strict=True):
        heads = [str(column.header) for column in block.table.columns]
        assert heads == ["formula", *(["residual"] if "held_out_rms" in tree[f"{law}_formulas"] else [])]
        count = min(4, tree[f"{law}_formulas"].sizes["alternative"])
        assert block.table.row_count == count > 0
