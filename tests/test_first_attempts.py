"""What users of lmfit, pysindy, arviz and xarray try first works, or fails with one true sentence."""

import re
import warnings
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import SysidTribError

TIME = np.arange(0.0, 8.0, 0.02)
NOISE = 1e-4 * np.random.default_rng(0).standard_normal(TIME.size)
ANGLE = 0.3 * np.exp(-0.09 * TIME) * np.cos(9.0 * TIME) + NOISE


class _Results(SimpleNamespace):
    """Results of one record, each computed on first use."""

    @property
    def tree(self):
        return _made("identify")

    @property
    def one(self):
        return _made("direct")

    @property
    def compared(self):
        return _made("compare")

    @property
    def found(self):
        return _made("discover")


@cache
def _made(name):
    few = st.library("zeta", "epsilon")
    makers = {
        "identify": lambda: st.identify((TIME, ANGLE), few),
        "direct": lambda: st.identify((TIME, ANGLE), few, "direct"),
        "compare": lambda: st.compare((TIME, ANGLE), few, ["direct", "averaging"]),
        "discover": lambda: st.discover((TIME, ANGLE), "zeta", ["epsilon", "delta"]),
    }
    return makers[name]()


FRAME = pd.DataFrame({"time": TIME, "angle": ANGLE})
NAMES = {
    "st": st,
    "np": np,
    "pd": pd,
    "xr": xr,
    "t": TIME,
    "angle": ANGLE,
    "df": FRAME,
    "decay": st.free_decay(FRAME),
    "lib": st.load_library(),
    "r": _Results(),
}
WORK = """
st.identify((t, angle), "paper", "direct")
st.identify([t, angle], "zeta", "direct")
st.identify((t.tolist(), angle.tolist()), "zeta", "direct")
st.identify(np.c_[t, angle], "zeta", "direct")
st.identify(np.array([t, angle]), "zeta", "direct")
st.identify(df, ["zeta", "lambda"], st.methods.Direct())
st.identify({"t": t, "angle": angle}, "zeta,lambda", "Direct")
st.identify(df.set_index("time").angle, "zeta", "direct")
st.identify((df.time, df.angle), "zeta", "direct")
st.identify(decay.angle, "zeta", "direct")
st.identify([(t, angle), df], "zeta", "direct")
st.identify(decay, st.library(zeta="2*v", mine="x**5"), "direct")
st.identify(decay, {"zeta": "2*v", "lambda": "sign(v)"}, "direct")
st.identify(decay, lib[["zeta", "epsilon"]] + st.library(mine="x**5"), "direct")
st.identify(decay, lib["zeta"], "direct")
st.identify(decay, "zeta", ["direct", "trajectory"])
st.methods.Direct().identify((t, angle), "zeta")
st.free_decay((1e3 * pd.Series(t, name="time (ms)"), pd.Series(np.rad2deg(angle), name="angle (deg)")))
"zeta" in lib and lib["zeta"] in lib and "mine" not in lib
st.summary(r.tree).loc["direct", "zeta"].value == r.tree["direct"].coefficient.sel(force="zeta")
st.summary(r.tree).unit.xs("zeta", level="quantity")
st.summary(r.one)
st.summary(r.compared)
st.summary(r.found)
r.tree.sel(model="direct")["record"].residual
r.compared.sel(model="direct")["comparison"].coefficient
r.found["record"].residual.sel(model="after")
st.best(r.tree).identical(r.tree["direct"].to_dataset())
st.best(r.compared).coefficient
st.best(r.found).coefficient
str(st.show(r.tree)) == repr(st.show(r.tree)) and "<table>" in st.show(r.tree)._repr_html_()
st.show(r.one)
st.show(r.compared)
st.show(r.found)
st.show(st.backbone(df))
st.show(st.library(mine="x**5"))
st.predict(r.tree, df).residual
st.predict(r.one, (t, angle)).predicted_angle
st.simulate(st.Model("paper", {"zeta": 0.01}, 9.0), t, angle=0.3)
st.plots.overview(r.tree)
st.plots.comparison(r.compared)
st.plots.story(r.found)
st.plots.backbone((t, angle))
st.plots.backbone(r.tree)
st.plots.look(df)
st.plots.motions((t, angle))
st.look(df)
st.envelope((t, angle))
st.difference((t, angle), df, "zeta")
st.difference(r.tree, r.one)
st.forced_response(r.tree, 0.01, np.linspace(8.0, 10.0, 5))
st.plan(r.tree)
st.cross_check(df, r.one, r.one)
st.campaigns.Task("identify", "zeta,lambda").library
st.errors.SysidTribError
""".strip().splitlines()
# A request, and the text of the error.
FAIL = {
    "st.identify(t, angle)": "one dimension has no times: give (t, angle)",
    "st.identify(angle)": "t = np.arange(len(angle)) / sampling_rate",
    "st.identify(df.angle)": "its index counts the rows",
    'st.identify("swing.csv")': "st.free_decay(st.read_record('swing.csv'))",
    'st.free_decay("swing.csv")': "st.free_decay(st.read_record('swing.csv'))",
    "st.identify(r.tree)": "not a result",
    "st.identify(r.one)": "takes a record, not a result",
    "st.identify((t, angle[1:]))": "400 times and 399 angles",
    'st.free_decay(xr.Dataset({"phi": ("time", angle)}, {"time": t}))': "record.rename(phi='angle')",
    'st.identify(df, "zetta")': "Did you mean 'zeta'?",
    "st.identify(df, 3)": "needs a force library",
    'st.identify(df, st.system("pendulum"))': "library, constraints = st.system(...)",
    "st.library(mine=lambda x, v: x**5)": "write its formula as a text",
    'st.library(mine="x**")': "is not a formula",
    'st.library(mine="y*x")': "unknown name 'y'",
    'st.library(zeta="v") + lib': "Two different forces have the symbol 'zeta'",
    "st.library()": "at least one force",
    'st.forces.Force("mine", "mine", "x**5")': "st.library(mine='x**5')",
    'lib["zetta"]': "Did you mean 'zeta'?",
    'st.identify(df, lib, "Drect")': "Did you mean 'direct'?",
    "st.identify(df, lib, st.methods.Direct)": "methods.Direct(), not its class",
    'st.identify(df, lib, constraints={"zetta": 0})': "there are lambda, zeta",
    "st.simulate(r.tree, t)": "st.physics.model_of(st.best(result))",
    "st.predict(r.tree, t)": "give (t, angle)",
    "st.summary(decay)": "summary needs a result",
    "st.show(decay)": "show takes a result",
    "st.best(decay)": "no preferred identification",
    "st.plots.laws(r.tree)": "shows results of laws; this is a result of identify",
    "st.plots.overview(r.one)": "this is an identification by one method",
    "st.plots.overview(df)": "not an object of type DataFrame",
    "st.plots.frequency_shift(r.tree, {})": "st.envelope(decay)",
    'st.plots.weights(r.one, "decay")': "physics.weights(result, amplitudes)",
    "st.physics.weights(r.tree, 0.1)": "st.best(result)",
    'st.validation.profile(decay, r.tree, ["zeta"])': "st.best(result)",
    "st.control.damp(r.tree)": "st.best(result)",
    "st.difference(r.tree, df)": "not one of each",
    "st.read_record(df)": "data in memory are used directly",
    'st.campaign([df], "plan", output="a.zarr")': "task 'plan' is unknown",
    'st.load("nothing.nc")': "There is no file",
}
# Names that there are not.
MISSING = {"st.identfy": "'identify'", "st.plot": "'plots'", "st.methods.Drect": "'Direct'"}


@pytest.mark.parametrize("attempt", WORK)
def test_usual_first_attempts_work(attempt):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = eval(attempt, NAMES)
    assert found is not False
    assert not isinstance(found, np.ndarray | xr.DataArray) or np.all(np.isfinite(found) | (found != 0))


@pytest.mark.parametrize("attempt", FAIL)
def test_or_fails_in_one_true_sentence(attempt):
    with pytest.raises(SysidTribError, match=re.escape(FAIL[attempt])) as caught:
        eval(attempt, NAMES)
    assert "\n" not in str(caught.value)
    assert str(caught.value).rstrip("?")[-1] in ".'"


@pytest.mark.parametrize("name", MISSING)
def test_a_misspelt_name_is_answered_by_the_nearest(name):
    with pytest.raises(AttributeError, match=f"Did you mean {MISSING[name]}"):
        eval(name, NAMES)
