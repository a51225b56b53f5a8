"""`sysid-trib discover`: the story, JSON, files and figures of a discovery, and what it refuses."""

import json
import re

import numpy as np
import pytest
from command_line import run, write_csv
from helpers import FIVE, W, library_of_formulas, sentences_of

from sysid_trib import Model, load
from sysid_trib.commands.next_step import alternatives, next_step
from sysid_trib.commands.options import SearchOptions
from sysid_trib.plots.figure import figures_of
from sysid_trib.printing import discovery, layout
from sysid_trib.results.files import save
from sysid_trib.results.judged import record_noise, residual_of
from sysid_trib.simulation.trajectory import trajectory

VISCOUS = {"zeta": "2*v"}
OFFERED = {"drag": "v*abs(v)", "cubic": "x**3", "rubber": "x*abs(x)", "wild": "sqrt(2.25 - x**2)*x"}
TIME = np.arange(0.0, 8.0, 0.02)
CHILDREN = {
    *("record", "discrepancy", "discrepancy_after", "detectability", "detectability_after", "ranking"),
    *("steps", "omnibus", "before", "after", "holdout", "judged"),
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
    """Libraries with viscous friction and four candidates, and a record in which no effect is missing."""
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
    return "\n".join(sentences_of(discovery.discovery_blocks(tree)))


def test_twin_is_explained_by_its_two_elastic_forces(twin):
    tree, found = twin
    assert (found["verdict"], found["search_outcome"]) == ("explained", "explained")
    assert [step["symbol"] for step in found["steps"]] == ["nu", "epsilon"]
    for step in found["steps"]:
        assert abs(step["coefficient"] - FIVE[step["symbol"]]) < 4.5 * step["standard_error"]
        assert step["residual_after"] < step["residual_before"]
        assert step["holdout_after"] < step["holdout_before"]
        assert step["gain"] > 20.0
        assert step["prediction_z"] > 0.0
        assert 0.0 <= step["random_force_after"] <= step["random_force_before"]
        assert step["chance_probability"] == 0.0
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


def test_parts_that_are_not_predicted_are_stated_and_fitted_next(twin):
    tree = twin[0].copy(deep=True)
    assert next_step(tree)[0] == "identify"
    tree["holdout"].rms[-1] = 3.4 * record_noise(tree)
    assert "But the residual is 3.4 times the noise on the held-out part (the last third)." in story(tree)
    # Two methods are fitted to the whole record: the search need not be run again.
    assert next_step(tree)[0] == "identify"
    given = SearchOptions(max_effects=2)
    assert alternatives(tree, given)[-1].endswith(": sysid-trib discover --max-effects 2 --refit")
    tree["refitted"] = True
    assert "But" not in story(tree)
    assert next_step(tree)[0] == "identify"


def test_json_follows_the_schema(twin):
    tree, found = twin
    assert {"disagreement", "steps", "verdict", "noise", "residual", "model"} <= set(found)
    for step in found["steps"]:
        assert step["symbol"] not in [other["symbol"] for other in step["indistinguishable_from"]]
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
    assert layout.plain(discovery.discovery_json(twin[0])) | {"next": twin[0].attrs["next"]} == twin[1]


@pytest.mark.slow
def test_figures_are_written(folder, tmp_path):
    ending = small(folder, folder / "cubic.csv", "--plot", tmp_path / "new" / "figures")
    assert (ending.status, ending.err) == (0, "")
    names = {path.name for path in (tmp_path / "new" / "figures").iterdir()}
    figures = [figure.draw.__name__ for figure in figures_of("discover")]
    assert names == {f"{name}.{ending}" for name in figures for ending in ("pdf", "png")}


@pytest.fixture(scope="module")
def plain(folder):
    """A record that lacks nothing: how the command ended, and its tree."""
    ending = small(folder, folder / "plain.csv", "-o", folder / "plain.nc")
    assert (ending.status, ending.err) == (0, "")
    return ending, load(folder / "plain.nc")


def test_nothing_is_missing(plain):
    ending = plain[0]
    assert "No missing effect was found" in ending.out
    assert "Missing effects" not in ending.out
    assert "the coefficient of five standard errors" in ending.out
    # No command that was there before: one would go round in circles.
    assert "\nNext: sysid-trib plan " in ending.out


def test_an_effect_outside_of_the_library_stays_unknown(folder, tmp_path):
    ending = small(folder, folder / "even.csv", "--json", "-o", tmp_path / "even.nc")
    found = json.loads(ending.out)
    assert found["search_outcome"] == "unknown effect"
    assert found["verdict"] == found["judged"]["after"]["verdict"]
    assert found["omnibus"]["p_value"] < 0.01
    told = story(load(tmp_path / "even.nc"))
    assert re.search(
        "Unknown effect: (with .* )?the model (is approximate|does not explain the record)", told
    )
    assert "The omnibus test shows that an effect is missing" in told


@pytest.mark.slow
def test_no_release_is_suggested_for_identical_effects(folder):
    offered = toml(folder / "same.toml", OFFERED | {"again": "2*x**3"})
    out = run(
        "discover", folder / "cubic.csv", "--library", folder / "viscous.toml", "--candidates", offered
    ).out
    assert "No run of this kind separates cubic and again: " in out
    assert "would separate them" not in out


def test_runs_that_differ_are_reported(folder, tmp_path):
    ending = small(folder, folder / "plain.csv", folder / "worn.csv", "-o", tmp_path / "both.nc")
    assert ending.status == 0
    assert re.search("The runs differ: chi-square .* The largest difference is in zeta", ending.out)
    agreeing = json.loads(small(folder, folder / "cubic.csv", folder / "cubic_2.csv", "--json").out)
    assert len(agreeing["records"]) == 2
    assert set(agreeing["disagreement"]["spans"]["run"]) == {0, 1}
    (step,) = agreeing["steps"]
    assert step["symbol"] == "cubic"
    assert abs(step["coefficient"] - 0.8) < 4.5 * step["standard_error"]
    told = agreeing["homogeneity"]
    assert told["chi_square"][0] < told["gain"][0]
    assert told["p_value"][-1] > 1e-3


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
    assert "The library has no candidate" in ending.complaint


def test_the_table_of_effects_describes_its_columns(twin):
    tables = [
        block for block in discovery.discovery_blocks(twin[0]) if block.title != "Models and candidates"
    ]
    effects = [b for b in tables if b.table is not None and "fitted / noise" in map(str, heads(b.table))]
    assert len(effects) == 2
    for block in effects:
        assert "on the fitted part (fitted) and on the last third (held out)" in block.caption


def heads(table):
    return [column.header for column in table.columns]
