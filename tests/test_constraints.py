"""Constraints: fixed, bounded and tied parameters, read, checked and resolved."""

import json

import numpy as np
import pytest
import xarray as xr

from sysid_trib import Model, compare, free_decay, identify, load_library, simulate
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.ties import parse_tie
from sysid_trib.methods import Direct, method_of

FORCES = load_library()
EFFECTS = load_library("candidate_effects")
NAMES = ("lambda", "zeta", "nu", "delta", "dahl.s")


def test_texts_of_the_command_line_are_read():
    read = Constraints.from_texts(
        ["lambda=0", "alpha = 1e-3"], ["zeta=0:", "epsilon=:1"], ["nu=-2.356*delta"]
    )
    assert read.fixed == {"lambda": 0.0, "alpha": 1e-3}
    assert read.bounds == {"zeta": (0.0, np.inf), "epsilon": (-np.inf, 1.0)}
    assert read.ties == {"nu": "-2.356*delta"}
    assert read
    assert not Constraints()
    read.check(FORCES)


@pytest.mark.parametrize(
    ("fix", "bound", "tie", "said"),
    [
        (["lambda"], [], [], "must be of the form lambda=0"),
        (["lambda=x"], [], [], "'x' is not a number"),
        (["lambda=nan"], [], [], "finite"),
        (["lambda=0", "lambda=1"], [], [], "twice"),
        ([], ["zeta=1"], [], "LOW:HIGH"),
        ([], ["zeta=:"], [], "LOW:HIGH"),
        ([], ["zeta=2:1"], [], "must rise"),
        (["zeta=2"], ["zeta=:1"], [], "outside of its bounds"),
        (["nu=1"], [], ["nu=delta"], "both tied and fixed"),
        ([], ["nu=0:"], ["nu=delta"], "both tied and bounded"),
        (["gamma=1"], [], [], "No parameter 'gamma'"),
        ([], [], ["nu=gamma"], "holds 'gamma'"),
        ([], [], ["nu=2*nu"], "to itself"),
        ([], [], ["nu=2*delta", "delta=zeta", "zeta=nu"], "in a circle"),
        ([], [], ["nu=delta^2"], "not a formula"),
        ([], [], ["nu=__import__('os')"], "holds '__import__'"),
        ([], [], ["nu=delta.real"], "holds 'delta.real'"),
        ([], [], ["nu=(lambda: 1)()"], "not a formula"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_sentence(fix, bound, tie, said):
    with pytest.raises(UsageError, match=said.replace("(", r"\(")) as refused:
        Constraints.from_texts(fix, bound, tie).check(FORCES)
    assert str(refused.value).endswith(".")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "linear"),
    [
        ("-2.356*delta", (0.0, {"delta": -2.356})),
        ("(lambda - 3*zeta)/2 + 1e-3", (1e-3, {"lambda": 0.5, "zeta": -1.5})),
        ("2*pi*0.1", (0.2 * np.pi, {})),
        ("dahl.s*delta", None),
        ("delta**2", None),
        ("sqrt(2)*delta", (0.0, {"delta": np.sqrt(2.0)})),
        ("1/delta", None),
        ("delta/0", None),
        ("abs(delta)", None),
        ("(delta + 1)**2 - delta**2 - 1", (0.0, {"delta": 2.0})),
    ],
)
def test_linear_ties_are_known_by_their_form(text, linear):
    found = parse_tie("nu", text, [n for n in NAMES if n != "nu"]).linear()
    assert (found is None) == (linear is None)
    if linear is not None:
        assert found[0] == pytest.approx(linear[0])
        assert found[1] == pytest.approx(linear[1])


def test_a_held_shape_is_a_constant():
    tie = parse_tie("zeta", "dahl.s*lambda", ("lambda", "dahl.s"))
    assert tie.linear({"dahl.s": 0.5}) == (0.0, {"lambda": 0.5})


@pytest.mark.parametrize(
    "text", ["lambda*zeta**2/delta", "abs(lambda)*sign(zeta)", "min(lambda, zeta)*exp(delta)", "delta**1.5"]
)
def test_derivatives_are_those_of_differences(text):
    tie = parse_tie("nu", text, NAMES)
    at = {"lambda": -0.3, "zeta": 0.7, "delta": 1.3}
    found = tie.derivatives(at)
    for name in tie.names:
        step = 1e-6
        ends = [tie.value(at | {name: at[name] + s * step}) for s in (1.0, -1.0)]
        assert found[name] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-8)


def test_a_formula_without_a_value_is_nan():
    assert np.isnan(parse_tie("nu", "1/delta", NAMES).value({"delta": 0.0}))


def test_linear_map_follows_chains_of_ties():
    asked = Constraints({"lambda": 0.5, "nu": "2*delta + lambda", "delta": "3*zeta - 1"})
    library = FORCES.select(["lambda", "zeta", "nu", "delta"])
    free, matrix, constant = asked.linear_map(library)
    assert free == ("zeta",)
    np.testing.assert_allclose(matrix[:, 0], [0.0, 1.0, 6.0, 3.0])
    np.testing.assert_allclose(constant, [0.5, 0.0, -1.5, -1.0])


def test_linear_map_holds_shapes_and_refuses_what_is_not_linear():
    library = EFFECTS.select(["dahl", "cubic_damping"])
    free, matrix, _ = Constraints({"cubic_damping": "dahl.s*dahl"}).linear_map(library, {"dahl.s": 0.25})
    assert free == ("dahl",)
    np.testing.assert_allclose(matrix[:, 0], [1.0, 0.25])
    with pytest.raises(UsageError, match="not linear"):
        Constraints({"dahl": "cubic_damping**2"}).linear_map(library)
    with pytest.raises(UsageError, match=r"dahl\.s is tied"):
        Constraints({"dahl.s": "cubic_damping"}).linear_map(library)


def test_a_result_says_how_each_coefficient_is_constrained():
    asked = Constraints({"lambda": 0.0, "zeta": (0, None), "nu": "2*delta"})
    assert asked.kinds(("lambda", "zeta", "delta", "nu"), ["zeta"]) == [
        "fixed",
        "at its bound",
        "",
        "nu=2*delta",
    ]


def test_old_arguments_are_parts_of_the_one_with_a_warning():
    old = {"fix": {"lambda": 0.0}, "bounds": {"zeta": (0.0, None)}, "tie": {"nu": "2*delta"}}
    with pytest.warns(DeprecationWarning, match="one argument now") as caught:
        method = Direct(**old)
    assert caught[0].filename == __file__
    assert method == Direct(constraints={"lambda": 0.0, "zeta": (0.0, None), "nu": "2*delta"})
    with pytest.raises(UsageError, match="both tied and fixed"):
        Direct(fix={"nu": 1.0}, tie={"nu": "delta"})


def test_results_of_before_have_their_method():
    options = {"fix": {"lambda": 0.0}, "bounds": {"zeta": [0.0, None]}, "tie": {}}
    result = xr.Dataset(attrs={"method": "direct", "options": json.dumps(options)})
    assert method_of(result) == Direct(constraints={"lambda": 0.0, "zeta": [0.0, None]})


def test_constraints_on_a_displacement_are_in_its_unit():
    library = FORCES.select(["lambda", "zeta"])
    motion = simulate(Model(library, {"lambda": 1e-3, "zeta": 0.01}, 9.0), np.arange(0.0, 15.0, 0.02), 0.3)
    shown = 50.0 * motion.angle.values + 5e-3 * np.random.default_rng(0).standard_normal(motion.time.size)
    record = xr.Dataset({"angle": ("time", shown, {"units": "mm"})}, {"time": motion.time.values})
    decay, asked = free_decay(record), {"lambda": 0.04, "zeta": (0, None)}
    method = Direct(random_force="off")
    alone = identify(decay, library, method, constraints=asked)
    assert alone.coefficient.sel(force="lambda").item() == pytest.approx(0.04, rel=1e-12)
    assert json.loads(alone.attrs["options"])["constraints"]["zeta"] == [0.0, None]
    compared = compare(decay, library, [method], constraints=asked)["direct"]
    np.testing.assert_allclose(compared.coefficient, alone.coefficient, rtol=1e-9)
