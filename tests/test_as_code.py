"""The exported equation: Python's function moves as the model does; sympy and Simulink have its rates."""

import re

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import library_of_text
from sysid_trib.printing.code import model_code

DAHL = """
[[force]]
symbol = "zeta"
formula = "2*v"
[[force]]
symbol = "nu"
formula = "x*abs(x)"
[[force]]
symbol = "dahl"
formula = "z"
state = { z = "(v - abs(v)*z)/s" }
start = { z = "s*x" }
shape = { s = { default = 0.05, low = 1e-3, high = 0.3 } }
"""
TIME = np.linspace(0.0, 5.0, 501)


@pytest.fixture(scope="module")
def identified():
    """A model with a state and its identification."""
    model = st.Model(library_of_text(DAHL, "dahl.toml"), {"zeta": 0.01, "nu": -0.3, "dahl": 0.02}, 6.0)
    noise = np.random.default_rng(1).normal(0.0, 1e-4, TIME.size)
    motion = st.simulate(model, TIME, 0.4)[["angle"]] + noise
    return st.identify(motion, model.library, st.methods.Direct())


def namespace(text):
    known = {}
    exec(text, known)
    return known


def test_python_moves_as_the_model_does(identified):
    known = namespace(model_code(identified, "python"))
    moved = solve_ivp(
        known["f"], TIME[[0, -1]], known["start"](0.4, 0.0), t_eval=TIME, rtol=1e-9, atol=1e-10, max_step=0.01
    )
    expected = st.simulate(st.physics.model_of(identified), TIME, 0.4)
    np.testing.assert_allclose(moved.y[0], expected.angle, atol=1e-6)
    np.testing.assert_allclose(moved.y[2], expected["dahl.z"], atol=1e-6)


def test_sympy_and_simulink_have_the_rates_of_python(identified):
    known, of_sympy = (namespace(model_code(identified, language)) for language in ("python", "sympy"))
    names = sympy.symbols("t x v dahl_z", real=True)
    rates = sympy.lambdify(names, list(of_sympy["rates"].values()))
    block = model_code(identified, "simulink")
    lines = [line.partition("%")[0].rstrip(" ;") for line in block.replace(" ...\n", "").splitlines()[1:-1]]
    for x, v, z in [(0.2, -0.1, 0.3), (-0.3, 0.2, -0.1)]:
        y = np.array([x, known["W"] * v, z])
        expected = known["f"](0.0, y)
        of_x, of_v, of_z = rates(0.0, x, v, z)
        np.testing.assert_allclose([of_x, known["W"] * of_v, of_z], expected, rtol=1e-12)
        # MATLAB counts from one, and writes a power and a column otherwise.
        here = {"y": lambda at, y=y: y[at - 1], "sign": np.sign}
        for line in filter(None, lines):
            exec(re.sub(r"\[(.*)\]$", lambda m: f"[{m[1].replace(';', ',')}]", line.replace("^", "**")), here)
        np.testing.assert_allclose(here["dy"], expected, rtol=1e-12)


def test_models_without_an_equation_are_refused(identified):
    with pytest.raises(UsageError, match="choose python, sympy, simulink"):
        model_code(identified, "fortran")
