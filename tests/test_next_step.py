"""Verdicts and next steps: texts for models that hold or do not, and the command that follows."""

import dataclasses
import json
import pickle
import shlex
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import run, write_csv
from helpers import FIVE, W, paper_run, sentences_of

import sysid_trib as st
from sysid_trib.commands import next_step as steps
from sysid_trib.commands.app import command_after
from sysid_trib.commands.next_step import NEXT_COMMANDS, keep_next, next_step
from sysid_trib.commands.options import (
    COMMANDS,
    DiscoverOptions,
    LawsOptions,
    ModelOptions,
    RecordOptions,
    SearchOptions,
)
from sysid_trib.printing.identification import identification_blocks
from sysid_trib.printing.verdict import verdict_sentence
from sysid_trib.results.judged import follows
from sysid_trib.validation.identify import usual_methods

FORCES = st.load_library()
RUN = paper_run(FIVE, sampling_rate=50.0)


def checked(record, library=FORCES, **options):
    methods = (st.methods.Averaging(**options), st.methods.Direct(**options))
    return st.cross_check(record, *(st.identify(record, library, method) for method in methods))


@cache
def explained():
    return checked(RUN.decay(7))


@cache
def unexplained():
    return checked(RUN.decay(7), FORCES.select(["lambda", "zeta"]), random_force="off")


def test_a_residual_as_small_as_the_noise_is_said_not_to_be_white():
    small = unexplained()
    judged = small["judged"].to_dataset()
    small["judged"] = judged.assign(residual_over_noise=1.0 + 0.0 * judged.residual_over_noise)
    assert "not white noise (p = " in verdict_sentence(small)
    large = unexplained()
    large["judged"] = judged.assign(residual_over_noise=2.0 + 0.0 * judged.residual_over_noise)
    assert "not white noise" not in verdict_sentence(large)


# The next step.


def test_an_explained_record_leads_to_every_method():
    assert follows(explained())
    assert next_step(explained())[0] == "compare"


def test_a_record_that_is_not_explained_leads_to_its_laws():
    assert not follows(unexplained())
    assert next_step(unexplained())[0] == "laws"


def test_the_motion_of_a_pendulum_that_is_not_explained_leads_to_its_forces():
    gravity = st.load_library("candidate_effects").select(["gravity"])
    forces = dataclasses.replace(FORCES, forces=(*FORCES.select(["delta"]), *gravity))
    model = st.Model(forces, {"delta": 0.02, "gravity": 1.0}, W)
    swing = st.simulate(model, np.arange(0.0, 40.0, 0.02), 1.0, 0.0)
    swing["angle"] += 1e-3 * np.random.default_rng(1).standard_normal(swing.sizes["time"])
    tree = checked(st.free_decay(swing), FORCES.select(["lambda", "zeta"]), random_force="off")
    keep_next(tree, DiscoverOptions())
    assert "identify --system pendulum #" in tree.attrs["next"]
    # The user states the kind of oscillator.
    keep_next(tree, DiscoverOptions(system="ship"))
    assert "laws --system ship" in tree.attrs["next"]


def test_passive_laws_stay_passive_and_no_other_command_has_the_option():
    given = LawsOptions(passive=True)
    assert "--passive" in command_after("laws", {"test": "b.csv"}, given)
    assert "--passive" not in command_after("identify", {}, given)


def test_the_next_command_takes_over_the_given_options(tmp_path):
    record = tmp_path / "a swing.csv"
    read = {"records": [record], "angle": "theta", "units": "deg", "window": "2:60"}
    model = {"forces": "zeta", "omega0": "8.87±0.02", "fix": ["zeta=0.01", "lambda=0"]}
    given = ModelOptions(**read, **model)
    compare = shlex.split(command_after("compare", {}, given))
    assert compare[:3] == ["sysid-trib", "compare", str(record)]
    for pair in (["--angle", "theta"], ["--window", "2:60"], ["--fix", "zeta=0.01"], ["--fix", "lambda=0"]):
        assert " ".join(pair) in " ".join(compare)
    assert "8.87±0.02" in compare
    discover = shlex.split(command_after("discover", {"units": None}, given))
    assert discover[-2:] == ["--forces", "zeta"]
    # These are no options of discover, or not wanted.
    assert not {"--units", "--omega0", "--fix"} & set(discover)
    other = command_after("identify", {"window": "3:", "records": "b.csv"}, given)
    assert "2:60" not in other
    assert other.endswith("--window 3:")
    assert f"{shlex.quote(str(record))} b.csv" in other


@pytest.mark.slow
def test_the_last_line_is_the_next_command_and_runs(tmp_path):
    path = write_csv(tmp_path / "swing.csv", time=np.arange(0.0, 12.0, 0.02))
    ending = run("identify", path, "--forces", "zeta", "--quiet", "-o", tmp_path / "result.nc")
    last = [line for line in ending.out.splitlines() if line.startswith("Next: ")]
    assert len(last) == 1
    command = shlex.split(last[0].removeprefix("Next: "), comments=True)
    assert command[:3] == ["sysid-trib", "compare", str(path)]
    assert command[3:] == ["--forces", "zeta"]
    told = json.loads(run("identify", path, "--forces", "zeta", "--json").out)
    assert told["next"] == last[0].removeprefix("Next: ")
    st.report(st.load(tmp_path / "result.nc"), tmp_path / "report.html")
    assert "Next: sysid-trib compare" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("symbol", ["delta", "maxwell", "resonator", "structural_damping", "even_spring"])
def test_effects_named_by_discover_are_identified_by_suitable_methods(symbol):
    offered = {force.symbol: force for force in (*FORCES, *st.load_library("candidate_effects"))}
    library = dataclasses.replace(FORCES, forces=(offered["zeta"], offered[symbol]))
    time = np.arange(0.0, 12.0, 0.02)
    decay = st.simulate(st.Model(library, {"zeta": 0.01, symbol: 0.05}, W), time, 0.3, 0.0)
    averaging = isinstance(usual_methods(decay, library)[0], st.methods.Averaging)
    assert averaging == (symbol == "delta")


def test_methods_that_agree_as_a_whole_are_not_said_to_agree_within_their_errors():
    tree = explained().copy(deep=True)
    tree["agreement"].z[:] = [0.1, -2.8, 0.5, 0.0, 1.0, -1.0]
    text = " ".join(sentences_of(identification_blocks(tree)))
    assert "Averaging and direct agree as a whole; zeta differs by 2.8 standard errors." in text
    tree["agreement"].z[:] = 1.9
    assert "agree within their errors" in " ".join(sentences_of(identification_blocks(tree)))


def test_every_state_leads_to_a_command_of_the_program_and_the_graph_ends():
    assert {command for command, _ in NEXT_COMMANDS.values()} <= {"", *COMMANDS}
    for state, (command, reason) in NEXT_COMMANDS.items():
        assert bool(command) == bool(reason), state


def test_a_placeholder_is_marked_and_never_the_only_step(monkeypatch):
    monkeypatch.setattr(steps, "_tied", lambda tree: ["quintic", "epsilon"])
    tree = searched_in_vain().copy()
    keep_next(tree, DiscoverOptions(records=[Path("a.csv")]))
    (with_record,) = [line for line in tree.attrs["alternatives"].splitlines() if "CSV" in line.upper()]
    assert with_record.startswith("With the record that separates quintic and epsilon")
    assert with_record.endswith("discover a.csv '<SECOND_RECORD.csv>'")
    assert "<" not in tree.attrs["next"]


def test_an_effect_that_no_candidate_names_does_not_lead_to_the_same_search():
    tree = searched_in_vain().copy()
    given = DiscoverOptions(forces="zeta", plot=Path("figures"))
    keep_next(tree, given)
    assert tree.attrs["search_outcome"] == "unknown effect"
    assert not tree.attrs["next"].startswith("sysid-trib discover")


@cache
def searched_in_vain():
    """A search with candidates none of which is in the record."""
    truth = {"zeta": 0.01, "nu": -0.4}
    decay = paper_run(truth, sampling_rate=50.0, duration=12.0).decay(3)
    return st.discover(decay, FORCES.select(["zeta"]), FORCES.select(["lambda"]), max_effects=1)


def test_paths_and_numbers_are_written_as_they_were_given(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["sysid-trib", "look", "./data//swing.csv"])
    given = RecordOptions(records=[Path("data/swing.csv")], sampling_rate=10000.0)
    assert command_after("identify", {}, given) == (
        "sysid-trib identify ./data//swing.csv --sampling-rate 10000"
    )


def test_a_refusal_names_a_command_that_takes_the_record(tmp_path):
    path = write_csv(tmp_path / "short.csv", time=np.arange(0.0, 1.3, 0.01))
    for command in ("look", "backbone"):
        ending = run(command, path)
        assert ending.status != 0
        assert ending.err.rstrip().endswith(f"use it uncut with sysid-trib identify {path} --forces zeta.")
    assert "such as --forces zeta" in run("identify", path).err
    assert run("identify", path, "--forces", "zeta").status == 0
    # No command is suggested for a record that no command accepts.
    shorter = write_csv(tmp_path / "shorter.csv", time=np.arange(0.0, 0.9, 0.01))
    assert run("look", shorter).err.rstrip().endswith("record longer or widen the window.")


def test_a_short_record_is_refused_with_the_forces_that_it_decides(tmp_path):
    path = write_csv(tmp_path / "short.csv", time=np.arange(0.0, 1.95, 0.01))
    ending = run("identify", path)
    assert ending.err.rstrip().endswith("give a longer record or fewer, such as --forces zeta.")


# Methods that break down.


def test_options_of_a_command_reach_a_worker():
    given = ModelOptions(forces="zeta")
    sent = pickle.loads(pickle.dumps(given))
    # Including the text by which a store identifies its campaign.
    assert (vars(sent), repr(sent)) == (vars(given), repr(given))
    assert "forces" in repr(sent)


def test_a_file_that_begins_with_a_dash_is_no_option():
    given = RecordOptions(records=[Path("-a.csv"), Path("b.csv")])
    assert command_after("identify", {}, given) == "sysid-trib identify ./-a.csv b.csv"


def test_forces_of_one_s_own_that_were_candidates_are_known_to_the_next_command():
    given = SearchOptions(candidates="own.toml")
    step = "identify", {"forces": "zeta,slip"}
    assert command_after(*step, given) == "sysid-trib identify --library own.toml --forces zeta,slip"
    assert "--candidates own.toml" in command_after("discover", {}, given)
    assert "--library other.toml" in command_after(*step, given.but(library="other.toml"))
