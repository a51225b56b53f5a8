"""Every function of results accepts every kind of result, or states in one sentence what it accepts."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_line import run
from helpers import paper_run

import sysid_trib as st
from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.forces.library import library_of_text
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation.simulate import trajectory

RUN = paper_run({"lambda": 1e-3, "zeta": 5e-3}, duration=15.0, sampling_rate=50.0)
CANDIDATES = st.library(friction="sign(v)", drag="v*abs(v)")
# The formula of one force holds the coefficient of another.
LOADED = library_of_text(
    """
inputs = ["u"]
force = [
    {symbol = "zeta", formula = "2*v"},
    {symbol = "drive", formula = "-u"},
    {symbol = "loaded", formula = "sign(v)*abs(drive*u)"},
]
""",
    "loaded",
)


def friction():
    """Return the library of both forces of the run."""
    return st.library(friction="sign(v)", zeta="2*v")


def driven_record():
    """Return a damped oscillator that a sine drives."""
    time = np.arange(0.0, 20.0, 0.02)
    push = 3.0 * np.sin(8.0 * time)
    inputs = {"u": KnownInput(time, push)}
    model = st.Model(st.library(zeta="2*v", gain="-u"), {"zeta": 0.02, "gain": 0.01}, 9.0, inputs=inputs)
    angle = trajectory(model, time, 0.1, 0.0).angle
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(time))
    signal = ("time", angle + noise, {"units": "rad"})
    drive = ("time", push, {"role": "input"})
    return xr.Dataset({"angle": signal, "u": drive}, {"time": time}, {"source": "a driven record"})


@cache
def identified():
    return st.identify(RUN.decay(1), friction())


def store(folder):
    """Return a campaign of two records."""
    files = [folder / f"{seed}.csv" for seed in (1, 2)]
    for seed, file in enumerate(files, 1):
        RUN.decay(seed).angle.to_pandas().rename("angle").to_csv(file)
    return st.campaign(files, output=folder / "store.zarr", workers=0)


MADE = {
    "method": lambda _: st.methods.Direct().identify(RUN.decay(1), friction()),
    "identify": lambda _: identified(),
    "compare": lambda _: st.compare(RUN.decay(1), friction(), ["direct", "averaging"]),
    "discover": lambda _: st.discover(RUN.decay(1), st.library(zeta="2*v"), CANDIDATES),
    "laws": lambda _: st.laws(RUN.decay(1)),
    "driven": lambda _: st.identify(driven_record(), st.library(zeta="2*v", gain="-u")),
    "discover by motions": lambda _: st.discover(driven_record(), LOADED.select(["zeta", "drive"]), LOADED),
    "difference": lambda _: st.difference(RUN.decay(1), RUN.decay(2), friction()),
    "difference of results": lambda _: st.difference(identified(), identified()),
    "campaign": store,
    "look": lambda _: st.look(RUN.decay(1)),
    "plan": lambda _: st.plan(identified()),
    "response": lambda _: st.forced_response(identified(), 0.001, 9.9 * np.linspace(0.9, 1.1, 3)),
    "backbone": lambda _: st.backbone(RUN.decay(1)),
}
NO_IDENTIFICATION = {"campaign", "look", "plan", "response", "backbone"}
# Kinds that a function does not accept; for all others it returns its result.
REFUSED = {
    "show": set[str](),
    "summary": NO_IDENTIFICATION - {"campaign"},
    "best": NO_IDENTIFICATION | {"difference", "difference of results"},
    "report": NO_IDENTIFICATION | {"difference of results"},
    "save": set[str](),
}
FUNCTIONS = {
    "show": lambda result, _: str(st.show(result)) and st.show(result)._repr_html_(),
    "summary": lambda result, _: st.summary(result),
    "best": lambda result, _: st.best(result),
    "report": lambda result, file: st.report(result, file) or file.read_text(encoding="utf-8"),
    "save": lambda result, file: st.save(result, file) or st.load(file),
}
# Those that take longer than two seconds.
SLOW = {"discover", "compare", "laws", "driven", "campaign", "response", "plan"}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return a function that makes a result of a kind once."""
    made = {}

    def of_kind(kind):
        if kind not in made:
            made[kind] = MADE[kind](tmp_path_factory.mktemp("made"))
        return made[kind]

    return of_kind


def kinds():
    return [pytest.param(kind, marks=[pytest.mark.slow] * (kind in SLOW)) for kind in MADE]


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("kind", kinds())
def test_each_function_gives_its_result_or_one_sentence(kind, function, results, tmp_path):
    result, file = results(kind), tmp_path / ("a.html" if function == "report" else "a.nc")
    if kind in REFUSED[function]:
        with pytest.raises(SysidTribError) as refused:
            FUNCTIONS[function](result, file)
        text = str(refused.value)
        assert "not whole" not in text
        assert text.endswith(".")
        assert text.count(". ") == 0
        return
    given = FUNCTIONS[function](result, file)
    if function == "best":
        assert "coefficient" in given
    elif function == "summary":
        assert np.isfinite(given.value).any()
    else:
        assert given is not None
        assert len(given)


@pytest.mark.parametrize("kind", kinds())
def test_the_group_judged_has_one_form(kind, results):
    result = results(kind)
    if not isinstance(result, xr.DataTree) or "judged" not in result.children:
        assert kind in NO_IDENTIFICATION | {"method", "difference of results"}
        return
    judged = result["judged"].to_dataset()
    one_a_model = {name for name, of in judged.data_vars.items() if of.dims == ("model",)}
    assert one_a_model >= {
        *("tested_rms", "tested_over_noise", "p_value", "departure_time", "spectral_line"),
        *("residual_rms", "residual_over_noise", "residual_over_motion", "held_out_rms"),
        *("random_force_p", "failure", "verdict"),
    }
    assert all(name in result.children for name in judged.model.values)
    assert np.all(judged.residual_over_noise.values > 0.0)


def test_the_text_of_a_result_is_plain_in_a_notebook(monkeypatch):
    outside = str(st.show(st.load_library()))
    # As in a kernel of Jupyter.
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert str(st.show(st.load_library())) == outside
    assert "viscous friction" in outside
    assert "\x1b" not in outside


def test_objects_other_than_results_are_named():
    for function in (st.show, st.summary, st.best, lambda result: st.report(result, Path("never.html"))):
        with pytest.raises(UsageError, match="an object of type int"):
            function(3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "judged"),
    [
        ("identify RECORD", True),
        ("compare RECORD", True),
        ("discover RECORD --candidates contact_forces", True),
        ("laws RECORD", True),
        ("difference RECORD OTHER", True),
        ("look RECORD", False),
        ("backbone RECORD", False),
        ("plan RECORD", False),
    ],
)
def test_json_of_each_command(command, judged, tmp_path):
    for seed, name in enumerate(("RECORD", "OTHER"), 1):
        RUN.decay(seed).angle.to_pandas().rename("angle").to_csv(tmp_path / f"{name}.csv")
        command = command.replace(name, str(tmp_path / f"{name}.csv"))
    ended = run(*command.split(), "--json")
    assert (ended.status, ended.err) == (0, "")
    found = json.loads(ended.out)
    assert ("judged" in found) is judged
    for of_model in found.get("judged", {}).values():
        assert {"residual_over_noise", "verdict", "p_value"} <= set(of_model)
