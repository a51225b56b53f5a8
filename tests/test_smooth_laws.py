"""Laws as curves: recovered within their bands, formulas within the band, and what a curve cannot be."""

from functools import cache

import numpy as np
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.likelihood.smoothness import smooth_least_squares

W, NOISE = 9.0, 3e-4
# Friction and restoring force beyond the straight line, over w^2.
LAWS = {
    "stribeck": ("1.2e-3*(0.5 + exp(-(v/0.04)**2))*sign(v) + 0.008*v", "-0.15*x**3"),
    "paper": ("3e-4*sign(v) + 0.0097*v + 0.037*v*abs(v)", "-0.4*x*abs(x) + 0.3*x**3"),
    "asymmetric": ("3e-4*sign(v) + 0.01*v + 0.01*abs(v)", "-0.1*x**3"),
}


def made(name):
    """The library of a law: its two forces, of coefficient 1."""
    rows = [{"symbol": s, "formula": f} for s, f in zip(("friction", "restoring"), LAWS[name], strict=True)]
    return parse_library({"force": rows}, name)


@cache
def record(name, seed=0, duration=30.0):
    model = st.Model(made(name), {"friction": 1.0, "restoring": 1.0}, W)
    motion = st.simulate(model, np.arange(0.0, duration, 0.01), angle=0.3)[["angle"]]
    motion["angle"] += NOISE * np.random.default_rng(seed).standard_normal(motion.sizes["time"])
    return st.free_decay(motion)


@cache
def identified(name):
    return st.laws(record(name))


def truth(name, law, places):
    library = made(name)
    if law == "friction":
        return W**2 * library["friction"].value(0.0 * places, places / W)
    return W**2 * (places + library["restoring"].value(places, 0.0 * places))


@pytest.mark.parametrize("name", ["stribeck", "paper"])
@pytest.mark.parametrize(("law", "variable"), [("friction", "speed"), ("restoring", "displacement")])
def test_bands_hold_the_law(name, law, variable):
    tree = identified(name)
    for method in ("averaging", "direct"):
        part = tree[method].to_dataset()
        part = part.isel({variable: np.flatnonzero(part[f"{variable}_visited"].values)})
        wanted = truth(name, law, part[variable].values)
        assert np.all((part[f"{law}_low"] <= wanted) & (wanted <= part[f"{law}_high"]))
        assert np.median(np.abs(part[law].values / wanted - 1.0)) < 5e-3


def test_the_law_of_the_papers_forces_predicts_as_they_do():
    decay, library = record("paper"), st.load_library().select(["lambda", "zeta", "delta", "nu", "epsilon"])
    named = st.identify(decay, library, st.methods.Direct(random_force="off"))
    other = record("paper", seed=1)
    rms = [st.predict(of, other).residual_rms.item() for of in (named, st.best(identified("paper")))]
    assert rms[1] < 1.1 * rms[0]


def test_formulas_within_the_band_hold_the_true_one():
    listed = st.physics.law_formulas(st.best(identified("stribeck")))
    found = [listed.isel(alternative=at).dropna("force") for at in range(listed.sizes["alternative"])]
    names = [set(of.force.values.tolist()) for of in found]
    assert {"lambda", "zeta", "stribeck"} in names
    right = found[names.index({"lambda", "zeta", "stribeck"})]
    assert right.coefficient.sel(force="lambda").item() == pytest.approx(6e-4, rel=0.02)
    assert right.coefficient.sel(force="stribeck").item() == pytest.approx(1.2e-3, rel=0.02)


def test_formulas_of_a_library_of_ones_own():
    own = parse_library({"force": [{"symbol": "mine", "formula": "v**3"}]}, "own")
    assert not st.physics.law_formulas(st.best(identified("paper")), candidates=own).sizes["alternative"]
    with pytest.raises(UsageError, match="no force of x alone"):
        st.physics.law_formulas(st.best(identified("paper")), "restoring", own)


@pytest.mark.slow
def test_friction_that_differs_between_directions_is_found():
    tree = identified("asymmetric")
    assert "friction_even" in tree["judged"].attrs["even"]
    part = tree["direct"].to_dataset()
    part = part.isel(speed=np.flatnonzero(part.speed_visited.values))
    wanted = truth("asymmetric", "friction", part.speed.values)
    assert np.mean((part.friction_low <= wanted) & (wanted <= part.friction_high)) > 0.95


def test_few_half_periods_give_the_named_forces():
    tree = st.laws(record("paper", duration=2.5))
    assert "too few for a curve" in tree["judged"].attrs["reason"]
    assert not any(force.startswith("friction_") for force in st.best(tree).force.values)


def test_a_law_is_the_same_in_every_unit_of_length():
    angle = record("paper")
    metres = xr.Dataset({"angle": ("time", angle.angle.values * 1e-3, {"units": "m"})}, {"time": angle.time})
    laws = [st.best(st.laws(of)) for of in (angle.copy(), st.free_decay(metres))]
    assert laws[1].friction.attrs["units"] == "m/s^2"
    same = np.interp(laws[0].speed * 1e-3, laws[1].speed, laws[1].friction)
    np.testing.assert_allclose(same, laws[0].friction * 1e-3, rtol=2e-3)


def test_a_result_without_laws_is_refused():
    result = st.identify(record("paper"), st.load_library().select(["zeta"]), st.methods.Direct())
    with pytest.raises(DecayError, match="holds no laws"):
        st.physics.law_formulas(result)


def test_the_smoothness_of_a_curve_follows_from_the_rows():
    draw = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 300)
    hinges = np.maximum(x[:, None] - np.linspace(0.05, 0.95, 15), 0.0)
    columns, curve = np.column_stack([np.ones_like(x), x, hinges]), [np.arange(2, 17)]
    bent = np.sin(6.0 * x)
    for shape in (1.0 + 2.0 * x, bent):
        fit = smooth_least_squares(columns, shape + 0.05 * draw.standard_normal(len(x)), curve)
        error = np.sqrt(np.einsum("ij,jk,ik->i", columns, fit.covariance, columns))
        z = (columns @ fit.coefficients - shape) / error
        assert np.mean(np.abs(z) < 2.0) > 0.85
        assert fit.noise == pytest.approx(0.05, rel=0.15)
