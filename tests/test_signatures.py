"""Averages over a cycle: exact loops, scaling, integrators; and forces that they cannot distinguish."""

from itertools import pairwise

import numpy as np
import pytest
from candidates import CANDIDATES, candidate, force
from hypothesis import given, strategies as st
from numpy import pi
from scipy.integrate import quad, solve_ivp
from scipy.special import beta

from sysid_trib import load_library
from sysid_trib.cycles.signatures import averages, signature, tabulated_averages
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.validation.separability import (
    exactly_dependent,
    indistinguishable,
    inseparable,
    without_signature,
)

A = np.array([0.005, 0.03, 0.1, 0.2, 0.7, 1.5])


@given(st.floats(0.0, 6.0), st.floats(0.0, 6.0), st.floats(0.01, 1.5))
def test_powers_follow_the_beta_formula(p, q, a):
    shape = {"p": {"default": p, "low": -1, "high": 9}, "q": {"default": q, "low": -1, "high": 9}}
    lossy = signature(force("abs(x)**p*abs(v)**q*sign(v)", shape=shape), a)
    elastic = signature(force("abs(x)**p*abs(v)**q*sign(x)", shape=shape), a)
    size = a ** (p + q)
    assert lossy.sine.item() == pytest.approx(-size * beta((p + 1) / 2, (q + 2) / 2) / pi, abs=1e-12 * size)
    assert elastic.cosine.item() == pytest.approx(
        size * beta((p + 2) / 2, (q + 1) / 2) / pi, abs=1e-12 * size
    )
    assert lossy.cosine.item() == elastic.sine.item() == 0.0


@pytest.mark.parametrize("s", [1e-4, 0.01, 0.3])
def test_dahl_is_the_exact_loop(s):
    # Between reversals dz/dx = (1 - sgn(v) z)/s is linear; on the steady cycle |z| = tanh(a/s) at the ends.
    a = 0.3

    def z(phi):
        return -1 + (1 + np.tanh(a / s)) * np.exp(a * (np.cos(phi) - 1) / s)

    cuts = [0.0, *(min(3.0, k * np.sqrt(s / a)) for k in (1, 2, 4, 6, 9)), pi]
    exact = [
        sum(quad(lambda p, f=f: z(p) * f(p), lo, hi, epsabs=1e-14)[0] for lo, hi in pairwise(cuts)) / pi
        for f in (np.sin, np.cos)
    ]
    found = signature(candidate("dahl"), a, {"dahl.s": s})
    assert [found.sine.item(), found.cosine.item()] == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("symbol", ["bouc_wen", "bouc_wen_2"])
def test_bouc_wen_agrees_with_the_steady_state_of_an_integrator(symbol):
    a, b = 0.3, 30.0
    found = candidate(symbol)

    def slopes(phi, y):
        names = {"x": a * np.cos(phi), "v": -a * np.sin(phi), "z": y[0], "b": b}
        return [found.state["z"].evaluate(names), y[0] * np.sin(phi), y[0] * np.cos(phi)]

    y = np.zeros(3)
    for half in range(24):
        y[1:] = 0.0 if half == 22 else y[1:]
        # A short step: the kink at z = 0 costs accuracy in proportion to its cube.
        span = (half % 2 * pi, (half % 2 + 1) * pi)
        y = solve_ivp(slopes, span, y, method="DOP853", rtol=1e-12, atol=1e-14, max_step=0.05).y[:, -1]
    expected = y[1:] / (2 * pi)
    assert np.ravel(averages(found, np.array([a]), {f"{symbol}.b": b})) == pytest.approx(expected, abs=1e-10)


def test_state_and_memory_together_repeat_themselves():
    # z' = v and m kept from the last reversal: z = x and m = x at that reversal, h = x + m.
    both = force("z + m", state={"z": "v - (z - x)"}, memory={"m": "z"})
    plain = force("x + m", memory={"m": "x"})
    np.testing.assert_allclose(averages(both, A), averages(plain, A), rtol=1e-9, atol=1e-11)


@given(
    st.sampled_from(sorted(set(CANDIDATES) - {"regularised"})),
    st.floats(-3.0, 3.0).filter(lambda c: abs(c) > 1e-3),
    st.floats(0.02, 1.2),
)
def test_signature_is_linear(symbol, factor, a):
    parts = dict(CANDIDATES[symbol])
    whole = force(**(parts | {"formula": f"{factor!r}*({parts['formula']}) + 2*v"}), symbol=symbol)
    sine, cosine = averages(candidate(symbol), np.array([a]), time=3.0)
    found = averages(whole, np.array([a]), time=3.0)
    assert found[0][0] == pytest.approx(factor * sine[0] - a, rel=1e-11, abs=1e-12)
    assert found[1][0] == pytest.approx(factor * cosine[0], rel=1e-11, abs=1e-12)


@given(
    st.sampled_from(["zeta", "delta", "alpha", "nu", "epsilon"]), st.floats(1e-3, 1.5), st.floats(0.1, 5.0)
)
def test_homogeneous_forces_scale_with_their_degree(symbol, a, factor):
    found = load_library()[symbol]
    here, there = (signature(found, value) for value in (a, factor * a))
    assert there.sine.item() == pytest.approx(factor**found.degree * here.sine.item(), rel=1e-12, abs=1e-15)
    assert there.cosine.item() == pytest.approx(
        factor**found.degree * here.cosine.item(), rel=1e-12, abs=1e-15
    )


@given(
    st.sampled_from(["stribeck", "rate", "freeplay", "maxwell", "dahl", "jenkins"]),
    st.floats(0.01, 1.0),
    st.floats(0.2, 5.0),
)
def test_a_length_in_the_formula_scales_with_the_amplitude(symbol, a, factor):
    # All but the Maxwell element, whose s is a time, are functions of a over their length.
    name = next(iter(candidate(symbol).shape))
    length = 0.05
    grown = length if symbol == "maxwell" else factor * length
    here = np.ravel(averages(candidate(symbol), np.array([a]), {f"{symbol}.{name}": length}))
    there = np.ravel(averages(candidate(symbol), np.array([factor * a]), {f"{symbol}.{name}": grown}))
    degree = 1 if symbol in ("freeplay", "maxwell", "jenkins") else 0
    np.testing.assert_allclose(there, factor**degree * here, rtol=1e-10, atol=1e-12)


def test_narrow_features_are_resolved():
    # tanh(v/s) is sgn v but for a layer of width s/a at the reversals, sharper than any fixed grid.
    found = signature(candidate("regularised"), 1.0).sine.item()
    assert found == pytest.approx(-2 / pi * (1 - (0.001 * pi) ** 2 / 24), rel=1e-9)
    # A needle at x = 0.1: <h cos phi> = (width sqrt(pi)) cos phi/(pi a |sin phi|) to leading order.
    needle = signature(force("exp(-((x - 0.1)/0.0003)**2)"), 0.2).cosine.item()
    assert needle == pytest.approx(0.0003 * np.sqrt(pi) * 0.5 / (pi * 0.2 * np.sqrt(0.75)), rel=1e-4)


@pytest.mark.parametrize(("symbol", "off"), [("dahl", 1e-12), ("stribeck", 1e-11), ("jenkins", 5e-6)])
def test_series_are_the_averages(symbol, off):
    a = np.geomspace(1e-3, 1.0, 60)
    pairs = zip(tabulated_averages(candidate(symbol), a), averages(candidate(symbol), a), strict=True)
    # At the beginning of slip, the signature of the last one has a kink.
    assert all(np.all(np.abs(series - exact) <= off * a) for series, exact in pairs)


def test_time_is_held_in_a_cycle_and_runs_with_the_amplitudes():
    t = np.array([0.0, 1.0, 4.0])
    a = np.array([0.3, 0.2, 0.1])
    found = signature(candidate("drift"), a, time=t)
    np.testing.assert_allclose(found.sine, -a * t / 2, rtol=1e-12)
    assert signature(candidate("ageing"), 0.3, time=np.e - 1).sine.item() == pytest.approx(-2 / pi)


@pytest.mark.parametrize("a", [-0.1, np.nan, np.inf, [[0.1]]])
def test_bad_amplitudes_are_refused(a):
    with pytest.raises(UsageError, match="amplitude"):
        signature(candidate("dahl"), a)


@pytest.mark.parametrize(
    "bad",
    [
        force("m", memory={"m": "m + 1"}),
        force("z", state={"z": "v + 1"}),
        force("exp(x**5)"),
        force("v/s", shape={"s": {"default": 1.0, "low": 0.0, "high": 1.0}}),
        force("z", state={"z": "exp(abs(z))*v/s"}, shape={"s": {"default": 1.0, "low": 0.0, "high": 1.0}}),
    ],
    ids=["counting memory", "drifting state", "overflow", "division by zero", "exploding state"],
)
def test_forces_without_a_cycle_are_refused_by_name(bad):
    with pytest.raises(LibraryError, match="Force 'g'"):
        averages(bad, np.array([20.0]), {"g.s": 0.0})


def library(**formulas):
    return parse_library({"force": [{"symbol": k, "formula": f} for k, f in formulas.items()]}, "test")


def test_a_tie_of_several_and_forces_unseen():
    forces = library(
        zeta="2*v", alpha="x", epsilon="x**3", mixture="v - x + 5*x**3", bias="1", even="x**2", bent="x*v"
    )
    assert indistinguishable(forces, 0.02, 0.3) == [("zeta", "alpha", "epsilon", "mixture")]
    assert without_signature(forces, 0.3, None) == ("bias", "even", "bent")


def test_forces_that_are_the_same_function():
    forces = library(
        delta="v*abs(v)",
        again="sign(v)*v**2",
        positional="x**2*sign(v)",
        radius="(x**2 + v**2)*sign(v)",
        other="x*v",
    )
    assert exactly_dependent(forces, 0.3) == [("delta", "again"), ("delta", "positional", "radius")]


def test_forces_with_a_past_are_compared_along_a_motion():
    slip = {"formula": "m", "memory": {"m": "x"}}
    dahl = {"formula": "z", "state": {"z": "(v - abs(v)*z)/0.05"}}
    entries = {"zeta": {"formula": "2*v"}, "slip": slip, "dahl": dahl, "twice": dahl | {"formula": "v - 2*z"}}
    forces = parse_library({"force": [{"symbol": k, **parts} for k, parts in entries.items()]}, "test")
    assert exactly_dependent(forces, 0.3) == [("zeta", "dahl", "twice")]


def test_forces_that_no_release_separates():
    offered = {force.symbol: force for force in (*load_library(), *load_library("candidate_effects"))}
    alike = {("cubic_damping", "van_der_pol"), ("maxwell", "resonator"), ("even_spring", "even_spring")}
    others = {("zeta", "delta"), ("nu", "epsilon"), ("even_spring", "even_drag"), ("lambda", "maxwell")}
    assert all(inseparable(offered[a], offered[b], 0.3) for a, b in alike)
    assert not any(inseparable(offered[a], offered[b], 0.3) for a, b in others)
