"""Python's defaults are the command's: the same numbers where nothing is asked for."""

from inspect import signature

import numpy as np
import pytest
from command_line import run

import sysid_trib as st
from sysid_trib.commands.campaign import CampaignOptions
from sysid_trib.commands.checks import offered_candidates, offered_forces, start_forces
from sysid_trib.commands.options import DEFAULT_LIBRARY, SearchOptions
from sysid_trib.discovery import discover as discovery
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.validation import compare as comparison


@pytest.fixture(scope="module")
def example():
    return st.free_decay(st.records.paper_twin())


@pytest.mark.slow
def test_identify_gives_what_the_command_gives(example, tmp_path):
    assert run("identify", "-o", tmp_path / "command.nc").status == 0
    by_command, here = st.load(tmp_path / "command.nc"), st.identify(example)
    assert set(here.children) == set(by_command.children)
    for group in ("averaging", "direct", "comparison"):
        for name, variable in here[group].data_vars.items():
            if variable.dtype.kind == "f":
                np.testing.assert_allclose(variable, by_command[group][name], rtol=1e-12, err_msg=name)
        assert here[group].attrs.get("verdict_on_record") == by_command[group].attrs.get("verdict_on_record")


def test_discover_starts_from_and_offers_what_the_command_does(example, monkeypatch):
    given = []
    monkeypatch.setattr(discovery, "_discovery", lambda *them: given.append(them))
    discovery.discover(example)
    _, start, candidates, constraints, holdout, how = given[0]
    model = start_forces(DEFAULT_LIBRARY, None, None)
    assert start.symbols == model.symbols == ("zeta",)
    assert candidates.symbols == offered_candidates(DEFAULT_LIBRARY, None, model).symbols
    asked = SearchOptions()
    assert (how.settings.max_effects, how.settings.level) == (asked.max_effects, asked.level)
    assert (how.refit, how.time_limit) == (asked.refit, asked.time_limit or np.inf)
    assert how.settings == DEFAULTS
    assert not constraints
    assert not holdout


def test_compare_takes_the_methods_and_forces_of_the_command(example, monkeypatch):
    given = []
    monkeypatch.setattr(comparison, "_compared", lambda *them: given.append(them))
    comparison.compare(example)
    _, library, methods, contactless, constraints, _ = given[0]
    assert library.symbols == offered_forces(DEFAULT_LIBRARY, None, alpha=False).symbols
    assert methods == comparison.every_method(None, {})
    assert contactless is None
    assert not constraints


def test_a_campaign_has_as_many_workers_and_as_much_memory():
    asked, here = CampaignOptions(), signature(st.campaign).parameters
    assert (here["workers"].default, here["memory"].default) == (asked.workers, asked.memory)
