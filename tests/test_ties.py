import numpy as np
import pytest

from sysid_trib.cycles.identifiability import (
    dependent_columns,
    exactly_dependent,
    indistinguishable,
    without_signature,
)
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library


def library(**formulas):
    return parse_library({"force": [{"symbol": k, "formula": f} for k, f in formulas.items()]}, "test")


def test_forces_of_one_signature():
    forces = library(
        lam="sign(v)",
        zeta="2*v",
        delta="v*abs(v)",
        nu="x*abs(x)",
        epsilon="x**3",
        structural="abs(x)*sign(v)",
        positional="x**2*sign(v)",
        product="abs(x)*v",
        cubic="v**3",
        van_der_pol="x**2*v",
        inertia="x*v**2",
        inverse="v**2*sign(x)",
        quintic="x**5",
        gravity="sin(x) - x",
        magnet="sin(2*x)/2 - x",
        root="abs(v)**0.5*sign(v)",
        stribeck="exp(-(v/0.05)**2)*sign(v)",
        drift="t*v",
    )
    assert indistinguishable(forces, 0.02, 0.3) == [
        ("zeta", "structural"),
        ("delta", "positional", "product"),
        ("nu", "inverse"),
        ("epsilon", "inertia"),
        ("cubic", "van_der_pol"),
    ]


def test_a_tie_of_several_and_forces_unseen():
    forces = library(
        zeta="2*v", alpha="x", epsilon="x**3", mixture="v - x + 5*x**3", bias="1", even="x**2", bent="x*v"
    )
    assert indistinguishable(forces, 0.02, 0.3) == [("zeta", "alpha", "epsilon", "mixture")]
    assert without_signature(forces, 0.02, 0.3) == ("bias", "even", "bent")


def test_a_tie_may_hold_in_a_range_only():
    # Below its clearance a freeplay has no signature; above its slip length a Jenkins element loses energy.
    forces = library(epsilon="x**3", freeplay="max(0, abs(x) - 0.2)*sign(x)")
    assert without_signature(forces, 0.01, 0.15) == ("freeplay",)
    assert without_signature(forces, 0.01, 0.3) == ()


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


def test_sensors_are_not_forces():
    parsed = parse_library(
        {"force": [{"symbol": "e", "formula": "x**3"}, {"symbol": "s", "formula": "x**3", "kind": "sensor"}]},
        "test",
    )
    assert indistinguishable(parsed, 0.01, 0.3) == []
    assert exactly_dependent(parsed, 0.3) == []


def test_dependent_columns():
    random = np.random.default_rng(1)
    first, second, third = random.normal(size=(3, 50))
    zero = np.zeros(50)
    columns = [first, zero, second, -3 * first, third, first + second, 1e-200 * first, third + 1e-6 * first]
    assert dependent_columns(np.column_stack(columns)) == [(0, 3), (0, 2, 5), (0, 4, 7)]
    assert dependent_columns(np.zeros((5, 3))) == []
    assert dependent_columns(np.zeros((5, 0))) == []


def test_empty_range_is_refused():
    with pytest.raises(UsageError, match="empty"):
        indistinguishable(library(zeta="2*v"), 0.3, 0.3)
