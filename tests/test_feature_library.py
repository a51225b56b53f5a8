import subprocess
import sys
from dataclasses import replace

import numpy as np
import pysindy
import pytest
from candidates import CANDIDATES, candidate

from sysid_trib import load_library
from sysid_trib.errors import DecayError, LibraryError
from sysid_trib.forces.library import parse_library
from sysid_trib.likelihood.pysindy_features import ForceFeatures, readable
from sysid_trib.simulation.internal_states import states_along

# The paper's PDMS sphere on glass, with a linear elastic force besides.
PAPER = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "alpha": 0.05, "nu": -0.40, "epsilon": 0.30}


def states(cycles=30.0, phase=0.0):
    tau = np.arange(0.0, cycles * 2 * np.pi, 0.1)
    a = 0.3 * np.exp(-0.01 * tau)
    return np.column_stack((a * np.cos(tau + phase), -a * np.sin(tau + phase)))


def target(x, coefficients=PAPER):
    """Theta'' + theta, exact: minus the force."""
    return -sum(c * load_library()[k].value(x[:, 0], x[:, 1]) for k, c in coefficients.items())[:, None]


def sindy(features=None):
    library = ForceFeatures(load_library()) if features is None else features
    return pysindy.SINDy(feature_library=library, optimizer=pysindy.STLSQ(threshold=0, alpha=0))


def remembering(*symbols):
    return parse_library({"force": [{"symbol": k, **CANDIDATES[k]} for k in symbols]}, "test")


def test_sindy_identifies_equation_1_from_exact_derivatives():
    x = states()
    model = sindy().fit(x, t=0.01, x_dot=target(x))
    np.testing.assert_allclose(model.coefficients()[0], [-c for c in PAPER.values()], rtol=0, atol=1e-10)


def test_sindy_prints_a_readable_equation(capsys):
    x = states()
    model = sindy().fit(x, t=0.01, x_dot=target(x))
    model.print(lhs=["theta'' + theta"], precision=6)
    assert capsys.readouterr().out.strip() == (
        "theta'' + theta =  0.000023 sgn(theta') + -0.009700 2 theta' + -0.037000 theta' |theta'|"
        " + -0.050000 theta +  0.400000 theta |theta| + -0.300000 theta^3"
    )
    assert model.equations()[0].endswith("-0.300 theta^3")


def test_inputs_may_have_names_of_their_own():
    features = ForceFeatures(load_library())
    assert features.get_feature_names() == [
        "sgn(theta')",
        "2 theta'",
        "theta' |theta'|",
        "theta",
        "theta |theta|",
        "theta^3",
    ]
    assert features.get_feature_names(["q", "p"])[:3] == ["sgn(p)", "2 p", "p |p|"]


@pytest.mark.parametrize(
    ("symbol", "text"),
    [
        ("stribeck", "exp(-(theta'/0.05)^2) sgn(theta')"),
        ("magnet", "(sin(2 theta)/2 - theta)"),
        ("freeplay", "max(0, |theta| - 0.1) sgn(theta)"),
        ("dahl", "dahl.z"),
        ("jenkins", "max(-0.02, min(0.02, jenkins.zr + theta - jenkins.xr))"),
        ("masing", "(masing.hr - (theta - masing.xr) |theta - masing.xr|/2)"),
        ("power", "|theta'|^0.5 sgn(theta')"),
    ],
)
def test_readable_names(symbol, text):
    assert readable(candidate(symbol)) == text


def test_inputs_are_those_of_pysindy():
    """`u=` has a column for each input; the derivative of one is its spline's, by tau."""
    truth = {"gain": 0.05, "base_spring": 0.3, "base_damping": 0.01, "zeta": 0.02, "epsilon": 0.3}
    forces = [*load_library("inputs").select(list(truth)[:3]), *load_library().select(list(truth)[3:])]
    library = replace(load_library("inputs"), forces=tuple(forces))
    x, w, step = states(), 9.9, 0.01
    angle, rate, time = x[:, 0], x[:, 1], step * np.arange(len(x))
    given = np.column_stack([np.sin(3.0 * time), 0.1 * np.cos(7.3 * time)])
    shaken = -0.73 * np.sin(7.3 * time) / w
    exact = np.column_stack([*-given.T, 2.0 * (rate - shaken), 2.0 * rate, angle**3])
    features = ForceFeatures(library, sampling_time=step, reference_frequency=w)
    model = pysindy.SINDy(feature_library=features, optimizer=pysindy.STLSQ(threshold=0, alpha=0))
    model.fit(x, t=step, x_dot=exact @ np.array(list(truth.values()))[:, None], u=given)
    np.testing.assert_allclose(features.transform(np.column_stack([x, given])), exact, rtol=0, atol=1e-6)
    np.testing.assert_allclose(model.coefficients()[0], list(truth.values()), rtol=1e-5)
    assert model.get_feature_names()[:2] == ["(-u)", "(-base)"]
    with pytest.raises(DecayError, match="a column each of the inputs u, base"):
        features.fit(x)
    with pytest.raises(LibraryError, match="give ForceFeatures a positive sampling_time"):
        ForceFeatures(library).fit(np.column_stack([x, given]))


def test_several_trajectories():
    runs = [states(), states(cycles=20.0, phase=1.0)]
    model = sindy().fit(runs, t=0.01, x_dot=[target(x) for x in runs])
    np.testing.assert_allclose(model.coefficients()[0], [-c for c in PAPER.values()], rtol=0, atol=1e-10)
    found = ForceFeatures(load_library()).fit_transform(runs)
    assert [f.shape for f in found] == [(len(x), 6) for x in runs]


@pytest.mark.parametrize(
    "x", [np.zeros((10, 3)), np.zeros((10, 1)), np.zeros((2, 10, 2)), np.zeros((10, 2, 2))]
)
def test_two_columns_are_needed(x):
    with pytest.raises(DecayError, match="two columns theta and theta'"):
        ForceFeatures(load_library()).fit(x)
    with pytest.raises(DecayError, match="two columns"):
        ForceFeatures(load_library()).fit(states()).transform(x)


def test_features_of_forces_with_a_past_are_carried_along_each_trajectory():
    library = remembering("dahl", "jenkins", "drift", "scale")
    features = ForceFeatures(library, sampling_time=0.01, reference_frequency=10.0, shapes={"dahl.s": 0.05})
    x = states()
    first, second = features.fit_transform([x, x])
    np.testing.assert_array_equal(first, second)
    assert first.shape == (len(x), 3)
    tau = 0.1 * np.arange(len(x))
    z = states_along(library["dahl"], tau, x[:, 0], x[:, 1], {"dahl.s": 0.05})["z"]
    np.testing.assert_allclose(first[:, 0], z, rtol=1e-8)
    np.testing.assert_allclose(first[:, 2], 0.01 * np.arange(len(x)) * x[:, 1], rtol=1e-12)


@pytest.mark.parametrize(
    ("symbol", "given", "missing"),
    [
        ("drift", {}, "sampling_time"),
        ("dahl", {}, "sampling_time"),
        ("dahl", {"sampling_time": 0.01}, "reference_frequency"),
        ("jenkins", {"sampling_time": -1.0, "reference_frequency": 9.0}, "sampling_time"),
    ],
)
def test_what_is_missing_is_said(symbol, given, missing):
    with pytest.raises(LibraryError, match=f"Force '{symbol}' depends on time.*{missing}"):
        ForceFeatures(remembering(symbol), **given).fit(states())


def test_sensors_are_no_features():
    with pytest.raises(LibraryError, match="no forces"):
        ForceFeatures(remembering("scale")).fit(states())


@pytest.mark.slow
def test_the_package_does_not_import_pysindy():
    modules = "sysid_trib, sysid_trib.simulation.internal_states, sysid_trib.cycles.envelope_prediction"
    code = f"import sys, {modules}; sys.exit('pysindy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
