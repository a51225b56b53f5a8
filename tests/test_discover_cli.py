"""`sysid-trib discover`: the story, JSON, files and figures of a discovery, and what it refuses."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_csv
from helpers import FIVE, W, library_of_formulas, overlaps, paper_run, sentences_of

from sysid_trib import Model, discover, load, plots
from sysid_trib.commands.terminal import print_blocks
from sysid_trib.discovery.demodulation import trend
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.printing.blocks import Layer
from sysid_trib.printing.discovery import discovery_blocks, remedy
from sysid_trib.printing.discovery_tables import effects_table, ranking_table
from sysid_trib.printing.json_results import discovery_json
from sysid_trib.printing.layout import coefficient_text
from sysid_trib.printing.next_step import SECOND_RECORD, next_step
from sysid_trib.results.discoveries import credible_set, strongest
from sysid_trib.results.files import save
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation.findings import residual_of
from sysid_trib.validation.verdict import record_noise

VISCOUS = {"zeta": "2*v"}
OFFERED = {"drag": "v*abs(v)", "cubic": "x**3", "rubber": "x*abs(x)", "wild": "sqrt(2.25 - x**2)*x"}
OF_DISCOVERY = [
    *(plots.story, plots.overview),
    *(plots.disagreement, plots.ranking),
]
TIME = np.arange(0.0, 8.0, 0.02)
CHILDREN = {
    *("record", "discrepancy", "discrepancy_after", "detectability", "detectability_after", "ranking"),
    *("steps", "omnibus", "before", "after", "holdout"),
}


def decayed(seed, noise=1e-3, start=0.3, time=TIME, **formulas):
    """A record of zeta = 0.01 and one further force, with its coefficient first: `x**3=(0.5, ...)`."""
    library = library_of_formulas(**VISCOUS, **{k: text for k, (text, _) in formulas.items()})
    coefficients = {"zeta": 0.01} | {k: value for k, (_, value) in formulas.items()}
    moved = trajectory(Model(library, coefficients, W), time, start, 0.0).angle
    return moved + noise * np.random.default_rng(seed).standard_normal(len(time))


def toml(path, formulas):
    blocks = [f'[[force]]\nsymbol = "{k}"\nformula = "{text}"\n' for k, text in formulas.items()]
    path.write_text("\n".join(blocks), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Libraries of a viscous friction and of four candidates, and a record that lacks none of them."""
    there = tmp_path_factory.mktemp("discover")
    toml(there / "viscous.toml", VISCOUS)
    toml(there / "offered.toml", OFFERED)
    write_csv(there / "plain.csv", TIME, decayed(1))
    write_csv(there / "worn.csv", TIME, decayed(6, worn=("2*v", 0.002)))
    write_csv(there / "large.csv", TIME, decayed(5, start=2.0))
    write_csv(there / "cubic.csv", TIME, decayed(2, cubic=("x**3", 0.8)))
    write_csv(there / "cubic_2.csv", TIME, decayed(3, start=0.5, cubic=("x**3", 0.8)))
    write_csv(there / "even.csv", TIME, decayed(4, even=("x**2", 0.4)))
    return there


def small(folder, *arguments):
    libraries = ("--library", folder / "viscous.toml", "--candidates", folder / "offered.toml")
    return run("discover", *arguments, *libraries, "--explain")


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    """The embedded example: (tree, JSON)."""
    path = tmp_path_factory.mktemp("twin") / "twin.nc"
    ending = run("discover", "--json", "-o", path)
    assert (ending.status, ending.err) == (0, "")
    return load(path), json.loads(ending.out, parse_constant=pytest.fail)


def story(tree):
    return "\n".join(sentences_of(discovery_blocks(tree)))


def test_twin_is_explained_by_its_two_elastic_forces(twin):
    tree, found = twin
    assert found["verdict"] == "explained"
    assert [step["symbol"] for step in found["steps"]] == ["nu", "epsilon"]
    for step in found["steps"]:
        assert abs(step["coefficient"] - FIVE[step["symbol"]]) < 4.5 * step["standard_error"]
        assert step["residual_after"] < step["residual_before"]
        assert step["holdout_after"] < step["holdout_before"]
        assert step["gain"] > 20.0
        assert step["prediction_z"] > 0.0
        assert 0.0 <= step["random_force_after"] <= step["random_force_before"]
        assert step["probability_of_chance"] == 0.0
    assert found["converged"] is True
    assert set(tree.children) == CHILDREN
    # The noise is known from twelve rows a period of two thirds of the record, to four percent.
    assert found["residual"] == pytest.approx(found["noise"], rel=0.1)


def test_the_twins_phase_slips_most_at_large_amplitude(twin):
    attrs, spans = twin[0]["discrepancy"].attrs, twin[0]["discrepancy"].to_dataset()
    assert attrs["parts"][0] == "phase"
    assert attrs["where"] == "large amplitude"
    # nu < 0: softer at large amplitude; a mean frequency is then too high there, too low at small ones.
    order = np.argsort(spans.amplitude.values)
    assert spans.frequency_error.values[order[-1]] < 0.0 < spans.frequency_error.values[order[0]]
    after = twin[0]["discrepancy_after"]
    assert (after.attrs["parts"], after.attrs["where"]) == ([], "")
    assert np.isnan(after.departure_time)


def test_story_of_the_twin(twin):
    tree, found = twin
    told = story(tree)
    gaps = [residual_of(tree, model) / record_noise(tree) for model in ("before", "after")]
    assert f"{gaps[0]:.3g} times the noise" in told
    assert "The start model (lambda, zeta, delta)" in told
    assert "Most of the gap is in the phase, mostly at large amplitude." in told
    assert "a conservative force is missing, or the clock is wrong." in told
    rows = zip(*(column.cells for column in effects_table(tree, details=True).columns), strict=True)
    for step, row in zip(found["steps"], rows, strict=True):
        assert row[:3] == (step["symbol"], step["name"], step["formula"])
        for what, cell in (("residual", row[5]), ("holdout", row[6])):
            pair = (step[f"{what}_{when}"] / found["residual_noise"] for when in ("before", "after"))
            assert cell == "{:.3g} to {:.3g}".format(*pair)
        assert row[7] == f"{step['gain']:.3g}"
        for other in step["indistinguishable_from"]:
            assert f"{other['symbol']} ({other['formula']})" in told
    # Gravity and a magnet, whose curves are cubic here, soften; this spring hardens.
    assert not found["steps"][1]["indistinguishable_from"]
    assert f"with nu and epsilon the gap is {gaps[1]:.3g} times the noise" in told
    assert "Not testable on this record: " in told
    assert "held out worse" not in told
    besides = re.search("The model has besides (.*)[.]", told)[1]
    assert [one.split(" = ")[0] for one in besides.split(", ")] == ["w", "lambda", "zeta", "delta"]
    zeta = tree["after"].sel(force="zeta")
    assert f"zeta = {zeta.coefficient.item():.6f} ± {zeta.standard_error.item():.6f}" in besides
    ranking = ranking_table(tree).columns
    assert [*ranking[0].cells][:2] == ["nu", "epsilon"]
    detectable = dict(zip(ranking[0].cells, ranking[-1].cells, strict=True))
    assert any(f"{value:.2g}" == detectable.get(s) for s, value in found["detectable"].items() if value)


def test_layers_of_the_text(twin, capsys):
    tree = twin[0]
    texts = {}
    for layer in Layer:
        print_blocks(discovery_blocks(tree, ["Record: swing.csv"]), layer)
        texts[layer] = capsys.readouterr().out
    for text in texts.values():
        verdict, _, *lines = text.splitlines()
        assert verdict.startswith("Explained: with nu and epsilon the gap is ")
        for symbol in ("nu", "epsilon"):
            row = next(line for line in lines if line.startswith(f"{symbol} "))
            assert coefficient_text(tree["steps"].isel(step=["nu", "epsilon"].index(symbol))) in row
    assert len(texts[Layer.QUIET].splitlines()) == 5
    for layer in (Layer.DEFAULT, Layer.EXPLAIN):
        assert "Record: swing.csv" in texts[layer]
        assert "these names stand: nu in 3 of 3; epsilon in 3 of 3." in texts[layer]
        assert "may be present and unseen" in texts[layer]
    assert "fall of the deviance" in texts[Layer.EXPLAIN]
    assert "fall of the deviance" not in texts[Layer.DEFAULT]


def test_the_default_text_hides_no_warning(twin, capsys):
    tree = twin[0].copy(deep=True)
    steps, tests = tree["steps"].to_dataset(), tree["omnibus"].to_dataset()
    steps["worsens_holdout"] = ("step", [False, True])
    steps["significant"] = ("step", [False, True])
    steps["collinear"] = ("step", [True, True])
    tests.significant[-1] = True
    tree["steps"], tree["omnibus"] = type(tree)(steps), type(tree)(tests)
    tree.attrs["verdict"] = "unknown effect"
    print_blocks(discovery_blocks(tree, []), Layer.DEFAULT)
    printed = capsys.readouterr().out
    for warning in (
        "Unknown effect: the named effects do not explain the record",
        "the coefficient of nu is not significant",
        "epsilon is in the fit only: the model before it predicts what was held out better",
        "nu and epsilon nearly cancel other forces of the model",
        "The omnibus test rejects that nothing is missing",
    ):
        assert warning in printed


def test_json_follows_the_schema(twin):
    tree, found = twin
    assert {"disagreement", "steps", "verdict", "noise", "residual", "model"} <= set(found)
    keys = (
        *("symbol", "name", "formula", "family", "kind", "coefficient", "standard_error", "shapes", "z"),
        *("p_value", "indistinguishable_from", "residual_before", "residual_after"),
    )
    for step in found["steps"]:
        assert set(keys) <= set(step)
        assert step["symbol"] not in [other["symbol"] for other in step["indistinguishable_from"]]
        words = {"symbol", "name", "formula", "probability"}
        assert all(set(other) == words for other in step["indistinguishable_from"])
        likely = [step["probability"], *(other["probability"] for other in step["indistinguishable_from"])]
        assert all(p > 0.0 for p in likely)
        assert sum(likely) <= 1.0 + 1e-3
    assert set(found["model"]["coefficients"]) == set(FIVE)
    assert found["disagreement_after"]["departure_time"] is None
    assert len(found["disagreement"]["spans"]["time"]) == tree["discrepancy"].sizes["span"]
    assert found["residual"] == pytest.approx(residual_of(tree, "after"))


def test_saved_and_read_back_the_same(twin, tmp_path):
    save(twin[0], tmp_path / "again.nc")
    assert load(tmp_path / "again.nc").identical(twin[0])
    assert discovery_json(twin[0]) | {"next": twin[0].attrs["next"]} == twin[1]


@pytest.mark.slow
def test_figures_are_written(folder, tmp_path):
    ending = small(folder, folder / "cubic.csv", "--plot", tmp_path / "new" / "figures")
    assert (ending.status, ending.err) == (0, "")
    names = {path.name for path in (tmp_path / "new" / "figures").iterdir()}
    assert names == {
        f"{name}.{ending}"
        for name in ("overview", "story", "disagreement", "ranking")
        for ending in ("pdf", "png")
    }


def test_story_in_one_picture(twin):
    tree = twin[0]
    record, before, after, explained = plots.story(tree).axes
    angle = tree["record"].to_dataset().angle.values
    for panel, model in ((before, "before"), (after, "after")):
        gap = 1e3 * (angle - tree["record"].simulated_angle.sel(model=model).values)
        np.testing.assert_allclose(panel.lines[0].get_ydata(), gap)
    assert [text.get_text() for text in explained.get_yticklabels()] == ["start model", "+ nu", "+ epsilon"]
    marks = [line.get_xdata()[0] for line in explained.lines if line.get_linestyle() == "None"]
    expected = [residual_of(tree, "before"), *tree["steps"].residual_after.values]
    np.testing.assert_allclose(marks, np.array(expected) / record_noise(tree))
    named = [text.get_text() for text in explained.texts if " = " in text.get_text()]
    assert [text.partition(" = ")[0].split(", ")[-1] for text in named] == ["nu", "epsilon"]
    assert [text.partition("; ")[2] for text in named] == ["", ""]
    assert {panel.get_ylabel() for panel in (record, before, after)} == {"angle (rad)", "gap (mrad)"}


@pytest.mark.parametrize("draw", OF_DISCOVERY, ids=lambda draw: draw.__name__)
def test_figures_say_what_is_held_out(twin, draw):
    assert draw(twin[0]).get_supxlabel() == "Held out, and not in this figure: the last third of the record."


@pytest.fixture(scope="module")
def plain(folder):
    """A record that lacks nothing: how the command ended, and its tree."""
    ending = small(folder, folder / "plain.csv", "-o", folder / "plain.nc")
    assert (ending.status, ending.err) == (0, "")
    return ending, load(folder / "plain.nc")


@pytest.mark.slow
def test_the_story_of_a_record_that_lacks_nothing_names_nothing(plain):
    assert plots.story(plain[1]).axes[-1].get_title(loc="left") == "(d) no effect named"


def test_disagreement_map_is_blank_without_samples_and_centred(twin):
    found = twin[0]["discrepancy"].to_dataset()
    mesh = plots.disagreement(twin[0]).axes[0].collections[0]
    shown = mesh.get_array()
    blank = np.ma.getmaskarray(shown).T
    assert np.all(blank[found.samples.values == 0])
    filled = ~blank
    np.testing.assert_allclose(shown.T[filled], 1e3 * found.force.values[filled])
    assert mesh.norm.vcenter == 0.0
    assert mesh.norm.vmin == -mesh.norm.vmax


def test_errors_of_the_disagreement_map_are_those_of_the_noise(twin, plain):
    for tree in (twin[0], plain[1]):
        found = tree["discrepancy_after"].to_dataset()
        z = (found.force / found.standard_error).where(found.samples >= 5).values
        assert 0.7 < np.sqrt(np.nanmean(z**2)) < 1.4
    before = twin[0]["discrepancy"].to_dataset()
    beyond = (abs(before.force) > 3.0 * before.standard_error).where(before.samples >= 5, False)
    dots = plots.disagreement(twin[0]).axes[0].lines[0]
    assert len(dots.get_xdata()) == beyond.sum() > 0


@pytest.mark.slow
@pytest.mark.parametrize("draw", [plots.disagreement, plots.overview])
def test_a_figure_of_a_column_is_whole(twin, draw):
    figure = draw(twin[0], width=3.46)
    assert overlaps(figure) == []
    # Drawn once for the PDF and again for the PNG: labels that have no room move out by then.
    figure.draw_without_rendering()
    inside = figure.bbox.padded(1.0)
    for panel in figure.axes:
        extent = panel.get_tightbbox(figure.canvas.get_renderer())
        assert inside.x0 <= extent.x0 < extent.x1 <= inside.x1
        assert inside.y0 <= extent.y0 < extent.y1 <= inside.y1


def test_ranking_shows_the_scores_with_their_threshold(twin):
    tree = twin[0]
    panels = plots.ranking(tree).axes
    # A move may exchange effects: each was chosen for good at a step of its own.
    chosen = sorted(set(tree["steps"].selection_step.values.astype(int).tolist()))
    assert len(panels) in (len(chosen), len(chosen) + 1)
    for scan, ax in zip([*chosen, -1], panels, strict=False):
        labels = [text.get_text() for text in ax.get_yticklabels()]
        points = [line for line in ax.lines if line.get_linestyle() == "None"]
        z = tree["ranking"].z.isel(selection_step=scan).sel(candidate=labels).values
        np.testing.assert_allclose([line.get_xdata()[0] for line in points], np.abs(z))
        threshold = tree["ranking"].threshold.values[scan]
        assert f"(threshold {threshold:.3g})" in ax.get_xlabel()
        dashed = [line for line in ax.lines if line.get_linestyle() == "--"]
        if ax.get_xlim()[0] < threshold:
            assert dashed[0].get_xdata()[0] == threshold
        else:
            # All are far beyond it: the axis shows in what they differ.
            assert not dashed
            low, high = ax.get_xlim()
            assert np.ptp(np.abs(z)) > 0.5 * (high - low)
        assert labels[:3] == strongest(tree["ranking"].to_dataset().isel(selection_step=[scan]), 3)
        assert np.nanmax(np.abs(tree["ranking"].z.isel(selection_step=scan))) == np.max(np.abs(z))
        assert scan == -1 or [line for line in ax.lines if line.get_marker() == "D"]


def test_nothing_is_missing(plain):
    ending = plain[0]
    assert "No missing effect was found" in ending.out
    assert "What is missing" not in ending.out
    assert "the coefficient of five standard errors" in ending.out


@pytest.mark.parametrize("candidates", [OFFERED, {"stiff": "x"}])
@pytest.mark.slow
def test_nothing_is_missing_or_nothing_testable_is_drawn_too(folder, tmp_path, candidates):
    offered = toml(tmp_path / "offered.toml", candidates)
    found = tmp_path / "found.nc"
    files = ("--library", folder / "viscous.toml", "--candidates", offered, "-o", found, "--plot", tmp_path)
    assert run("discover", folder / "plain.csv", *files).status == 0
    ending = run("report", found, "-o", tmp_path / "found.html")
    assert (ending.status, ending.err) == (0, "")
    assert (tmp_path / "ranking.png").exists()


def test_a_candidate_that_is_not_finite_on_this_motion_is_told(folder):
    ending = small(folder, folder / "large.csv")
    assert (ending.status, ending.err) == (0, "")
    assert re.search(r"Not testable on this record: wild \(.*not finite", ending.out)


def test_an_effect_outside_of_the_library_stays_unknown(folder, tmp_path):
    ending = small(folder, folder / "even.csv", "--json", "-o", tmp_path / "even.nc")
    found = json.loads(ending.out)
    assert found["verdict"] == "unknown effect"
    assert found["generic_p_value"] < 0.01
    told = story(load(tmp_path / "even.nc"))
    assert re.search("Unknown effect: the (model does|named effects do) not explain the record", told)
    assert "The omnibus test rejects" in told


@pytest.mark.slow
def test_a_held_out_window_takes_no_part(folder, tmp_path):
    path = tmp_path / "cubic.nc"
    ending = small(folder, folder / "cubic.csv", "--holdout", "6:", "-o", path, "--max-effects", "1")
    assert (ending.status, ending.err) == (0, "")
    tree = load(path)
    assert tree["steps"].symbol.values.tolist() == ["cubic"]
    assert tree["record"].time.values.max() < 6.0
    assert tree.attrs["held_out"] == "from 6 s on"
    assert tree["holdout"].rms.values[1] < 0.5 * tree["holdout"].rms.values[0]
    assert "held out: from 6 s on" in ending.out
    assert f"Written: {path}" in ending.out


@pytest.mark.slow
def test_runs_that_differ_are_told(folder, tmp_path):
    ending = small(folder, folder / "plain.csv", folder / "worn.csv", "-o", tmp_path / "both.nc")
    assert ending.status == 0
    assert re.search("The runs differ: chi-square .* The largest difference is in zeta", ending.out)
    agreeing = json.loads(small(folder, folder / "cubic.csv", folder / "cubic_2.csv", "--json").out)
    assert len(agreeing["records"]) == 2
    assert set(agreeing["disagreement"]["spans"]["run"]) == {0, 1}
    (step,) = agreeing["steps"]
    assert step["symbol"] == "cubic"
    assert abs(step["coefficient"] - 0.8) < 4.5 * step["standard_error"]
    told = agreeing["run_differences"]
    assert told["chi_square"][0] < told["gain"][0]
    assert told["p_value"][-1] > 1e-3


def test_candidates_that_the_model_has_are_left_out_and_told(folder, tmp_path):
    doubled = toml(tmp_path / "doubled.toml", {"again": "v*2", "cubic": "x**3"})
    libraries = ("--library", folder / "viscous.toml", "--candidates", doubled)
    ending = run("discover", folder / "plain.csv", *libraries, "--explain")
    assert "Not offered, because the model has them: again." in ending.out


def test_what_would_break_a_tie():
    forces = library_of_formulas(
        cubic="x**3", gravity="sin(x) - x", drag="v**3", drift="t*x", friction="sign(v)"
    )
    said = {
        ("cubic", "gravity"): "larger amplitude",
        ("cubic", "drift"): "0.6 of the amplitude",
        ("drag", "friction"): "0.2 of the amplitude",
    }
    for pair, words in said.items():
        assert words in remedy([forces[symbol] for symbol in pair])


def test_trend_finds_where_a_rate_differs():
    tau = np.linspace(0.0, 200.0, 24)
    amplitude = 0.3 * np.exp(-0.01 * tau)
    rates = {
        "large amplitude": amplitude,
        "small amplitude": 0.01 / amplitude,
        "late times": 1e-3 * tau,
        "all amplitudes": np.full_like(tau, 0.02),
    }
    error, run_of = np.full_like(tau, 1e-3), np.zeros_like(tau)
    for where, rate in rates.items():
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(tau)
        value = np.concatenate([[0.0], np.cumsum(steps)])
        found, place = trend(value, error, run_of, tau, amplitude)
        assert place == where
        np.testing.assert_allclose(found, rate, rtol=1e-6, atol=1e-12)


def test_without_a_step_there_is_a_tree_too(folder):
    decay = paper_run(FIVE, duration=6.0).decay(1)
    model = library_of_formulas(**VISCOUS, d="v*abs(v)", n="x*abs(x)", e="x**3")
    tree = discover(decay, model, library_of_formulas(fifth="x**5"), max_effects=0)
    assert discovery_json(tree)["steps"] == []
    assert plots.ranking(tree).axes
    assert isinstance(model, ForceLibrary)


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (("nowhere.csv",), 2, "nowhere.csv"),
        (("--forces", ""), 2, "names no force"),
        (("--forces", "alpha"), 2, "cannot be separated from the frequency"),
        (("--forces", "mu"), 2, "no force 'mu'"),
        (("--candidates", "nothing_such"), 2, "no library 'nothing_such'"),
        (("--max-effects", "-1"), 2, "max-effects"),
        (("--quiet", "--explain"), 2, "--explain prints more and --quiet prints less: choose one."),
        (("--max-effects", "many"), 2, "max-effects"),
        (("--holdout", "5"), 2, "--holdout '5' must be START:STOP"),
        (("--holdout", "5:x"), 2, "--holdout: 'x'"),
        (("--holdout", "5:10"), 2, "must reach to the start or the end"),
        (("--holdout", "90:"), 1, "holds out nothing"),
        (("--holdout", ":90"), 1, "holds out all"),
        (("--reference-frequency", "-1"), 2, "--reference-frequency"),
        (("-o", "result.csv"), 2, ".nc"),
        (("--window", ":0.5"), 1, ""),
    ],
)
def test_bad_command(arguments, status, reason):
    ending = run("discover", *arguments)
    assert ending.status == status
    assert reason in ending.complaint


def test_bad_candidates(folder, tmp_path):
    broken = tmp_path / "broken.toml"
    broken.write_text('[[force]]\nsymbol = "a"\nformula = "__import__(1)"\n', encoding="utf-8")
    ending = run("discover", "--candidates", broken)
    assert ending.status == 1
    assert "broken.toml" in ending.complaint
    other = toml(tmp_path / "other.toml", {"zeta": "v**3"})
    ending = run("discover", "--candidates", other)
    assert ending.status == 2
    assert "'zeta' (v**3) has the symbol of another force" in ending.complaint
    same = toml(tmp_path / "same.toml", VISCOUS)
    ending = run("discover", folder / "plain.csv", "--library", same, "--candidates", same)
    assert ending.status == 2
    assert "No candidate is left" in ending.complaint


def test_a_named_effect_is_the_most_probable_and_no_probability_is_nought(twin):
    tree = twin[0].copy(deep=True)
    steps = tree["steps"].to_dataset().copy(deep=True)
    steps.credible.loc[{"step": 0, "candidate": "gravity"}] = True
    steps.tie_probability.loc[{"step": 0, "candidate": "gravity"}] = 0.998
    steps.tie_probability.loc[{"step": 0, "candidate": "nu"}] = 0.002
    tree["steps"] = xr.DataTree(steps)
    told = story(tree)
    assert next(iter(effects_table(tree).columns[0].cells)) == "gravity (fitted by nu)"
    assert "nu < 0.01, gravity 1.00" in told
    assert "0.00" not in told.split("equal prior")[1].splitlines()[0]
    assert "Explained: with gravity (fitted by nu) and epsilon the gap is " in told


def test_a_discovery_that_decides_nothing_says_so(twin):
    tree = twin[0].copy(deep=True)
    after = tree["after"].to_dataset()
    less = 10.0 * float(abs(after.coefficient / after.standard_error).max())
    wide = {"standard_error": less * after.standard_error, "covariance": less**2 * after.covariance}
    tree["after"] = xr.DataTree(after.assign(wide))
    tree.attrs["verdict"] = "nothing missing"
    assert "The record decides nothing" in story(tree)
    assert next_step(tree).command == "identify"


def test_the_next_step_after_a_discovery(twin):
    tree = twin[0].copy(deep=True)
    tied = any(len(credible_set(tree["steps"].to_dataset().isel(step=at))) > 1 for at in range(2))
    # The example is no file beside which another could be given.
    assert next_step(tree).command == "identify"
    tree["record"].attrs["record_checksum"] = "of a file"
    assert next_step(tree).records == ((SECOND_RECORD,) if tied else ())
    tree.attrs["verdict"] = "unknown effect"
    steps = tree["steps"].to_dataset()
    tree["steps"] = xr.DataTree(steps.assign(credible=steps.candidate == steps.symbol))
    assert "plot" in next_step(tree).options
    ranking = tree["ranking"].to_dataset()
    tree["ranking"] = xr.DataTree(ranking.assign(significant=xr.ones_like(ranking.significant)))
    tree.attrs["max_effects"] = 2
    assert next_step(tree).options == {"max-effects": "4"}
    out_of_time = tree.copy()
    out_of_time.attrs["out_of_time"] = "3 s"
    assert next_step(out_of_time).without == ("time_limit",)
    tree.attrs["verdict"] = "explained"
    assert next_step(tree).options["forces"] == ",".join(tree["after"].force.values)
