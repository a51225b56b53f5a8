import control
import numpy as np
import pytest
from candidates import CANDIDATES
from known_results import PAPER, W, correlated, known

from sysid_trib import Model, load_library
from sysid_trib.control import damp, linearise, to_nonlinear_system
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.physics.force_weights import crossovers
from sysid_trib.simulation.simulate import simulate

A = 0.3
TIGHT = {"solve_ivp_method": "LSODA", "solve_ivp_kwargs": {"rtol": 1e-11, "atol": 1e-13}}


def library():
    entries = [{"symbol": k, **v} for k, v in CANDIDATES.items()]
    six = [{"symbol": f.symbol, "formula": f.formula.text} for f in load_library()]
    return parse_library({"force": six + entries}, "test")


ODD = [f for f in library() if f.kind == "force" and f.memoryless and f.parity == "odd"]
OF_ONE_VARIABLE = [
    pytest.param(f, variable, id=f.symbol)
    for f in ODD
    for variable in "xv"
    if f.formula.names & set("xvt") == {variable}
]


@pytest.mark.parametrize(("force", "variable"), OF_ONE_VARIABLE)
def test_describing_function_reproduces_the_signature(force, variable):
    # The first harmonic of h(A sin p) is A Re N sin p: <h sin phi> = -A N/2 in v, <h cos phi> = A N/2 in x.
    def h(u):
        return float(force.value(u, 0.0) if variable == "x" else force.value(0.0, u))

    found = A * control.describing_function(h, A, num_points=1001, try_method=False).real / 2
    sine, cosine = averages(force, np.array([A]))
    assert found == pytest.approx(-sine[0] if variable == "v" else cosine[0], rel=2e-3, abs=1e-9)


def test_a_smooth_model_moves_as_in_our_simulation():
    coefficients = {"zeta": 0.0097, "nu": -0.40, "epsilon": 0.30, "van_der_pol": 0.2}
    model = Model(library(), coefficients, W)
    time = np.linspace(0.0, 10.0, 501)
    found = control.input_output_response(to_nonlinear_system(model), time, 0, [0.3, 1.0], **TIGHT)
    exact = simulate(model, time, 0.3, 1.0)
    np.testing.assert_allclose(found.states[0], exact.angle, atol=1e-7)
    np.testing.assert_allclose(found.states[1], exact.rate, atol=1e-6)


def test_internal_states_become_states():
    model = Model(library(), {"zeta": 0.01, "dahl": 0.05}, W, {"dahl.s": 0.05})
    time = np.linspace(0.0, 4.0, 201)
    system = to_nonlinear_system(model)
    assert system.state_labels == ["theta", "theta_dot", "dahl_z"]
    found = control.input_output_response(system, time, 0, [0.3, 0.0, 0.0], **TIGHT)
    exact = simulate(model, time, 0.3)
    np.testing.assert_allclose(found.states[0], exact.angle, atol=1e-6)
    np.testing.assert_allclose(found.states[2], exact["dahl.z"], atol=1e-5)


@pytest.mark.parametrize("inertia", [None, 1.33e-6])
def test_a_constant_torque_shifts_the_rest_by_torque_over_stiffness(inertia):
    torque = 0.02 * W**2 * (inertia or 1.0)
    system = to_nonlinear_system(Model(load_library(), {"zeta": 0.3}, W), inertia)
    response = control.input_output_response(system, [0.0, 10.0, 20.0], torque * np.ones(3), [0, 0], **TIGHT)
    assert response.states[0, -1] == pytest.approx(0.02, rel=1e-8)
    assert control.dcgain(linearise(Model(load_library(), {"zeta": 0.3}, W), None, inertia))[0, 0] == (
        pytest.approx(0.02 / torque, rel=1e-12)
    )


def test_memory_is_refused():
    with pytest.raises(UsageError, match="jenkins"):
        to_nonlinear_system(Model(library(), {"jenkins": 0.1}, W))


@pytest.mark.parametrize(("alpha", "zeta"), [(0.25, 0.05), (0.0, 0.0097), (-0.1, 0.4)])
def test_poles_of_the_linear_model_are_exact(alpha, zeta):
    poles = np.linalg.eigvals(linearise(known({"alpha": alpha, "zeta": zeta})).A)
    np.testing.assert_allclose(np.abs(poles.imag), W * np.sqrt(1 + alpha - zeta**2), rtol=1e-12)
    np.testing.assert_allclose(poles.real, -zeta * W, rtol=1e-12)
    found = damp(known({"alpha": alpha, "zeta": zeta}))
    np.testing.assert_allclose(found.natural_frequency, W * np.sqrt(1 + alpha), rtol=1e-12)
    np.testing.assert_allclose(found.damping_ratio, zeta / np.sqrt(1 + alpha), rtol=1e-12)


def test_forces_without_slopes_at_rest_are_left_out():
    smooth = {"zeta": 0.01, "nu": -0.4, "delta": 0.3}
    rough = {"lambda": 1e-3, "detent": 1e-3, "stribeck": 1e-3, "power": 0.1, "even_friction": 0.02}
    bare = linearise(Model(library(), smooth, W))
    full = linearise(Model(library(), smooth | rough, W))
    np.testing.assert_array_equal(full.A, bare.A)
    np.testing.assert_allclose(bare.A, [[0, 1], [-(W**2), -2 * 0.01 * W]], rtol=1e-12)


def test_presliding_is_a_spring_at_rest():
    # Dahl: z' = v/s at rest, and a force c z: stiffness c/s; its own state has a pole at zero beside.
    found = damp(Model(library(), {"dahl": 0.002}, W, {"dahl.s": 0.01}))
    np.testing.assert_allclose(found.natural_frequency, [0, W * np.sqrt(1.2), W * np.sqrt(1.2)], atol=1e-6)


def test_at_an_amplitude_frequency_and_decay_are_those_of_averaging():
    small = {k: 1e-3 * c for k, c in PAPER.items()}
    found = damp(known(small), A)
    shift = 4 * small["nu"] * A / (3 * np.pi) + 3 * small["epsilon"] * A**2 / 8
    assert found.natural_frequency[0].item() == pytest.approx(W * (1 + shift), rel=1e-8)
    rate = small["zeta"] + 2 * small["lambda"] / (np.pi * A) + 4 * small["delta"] * A / (3 * np.pi)
    np.testing.assert_allclose(found.growth_rate, -W * rate, rtol=1e-12)


def test_errors_of_frequency_and_damping_are_those_of_the_covariance():
    values = np.array([0.2, 0.05, W])
    spread = correlated(values, 0.003)
    found = damp(known({"alpha": 0.2, "zeta": 0.05}, spread))
    natural = np.array([W / (2 * np.sqrt(1.2)), 0.0, np.sqrt(1.2)])
    ratio = np.array([-0.05 / (2 * 1.2**1.5), 1 / np.sqrt(1.2), 0.0])
    for name, slope in (("natural_frequency", natural), ("damping_ratio", ratio)):
        error = np.sqrt(slope @ spread @ slope)
        np.testing.assert_allclose(found[f"{name}_standard_error"], error, rtol=1e-5)


def test_limit_cycle_of_negative_friction():
    solid, viscous = -2.3e-5, 0.0097
    expected = -2 * solid / (np.pi * viscous)
    assert expected == pytest.approx(1.5095e-3, abs=1e-7)
    found = crossovers(known({"lambda": solid, "zeta": viscous})).isel(pair=0)
    assert found.opposed.item()
    assert found.amplitude.sel(rule="averaged").item() == pytest.approx(expected, rel=1e-9)
    time = np.arange(0.0, 120.0, 0.005)
    run = simulate(Model(load_library(), {"lambda": solid, "zeta": viscous}, W), time, 1e-3)
    assert np.abs(run.angle[time > 110].values).max() == pytest.approx(expected, rel=5e-3)
    # The describing function at the limit cycle neither dissipates energy nor adds it.
    assert damp(known({"lambda": solid, "zeta": viscous}), expected).damping_ratio[0].item() == pytest.approx(
        0.0, abs=1e-12
    )


def test_wrong_requests_are_usage_errors():
    timed = parse_library({"force": [{"symbol": "drift", "formula": "t*v"}]}, "test")
    with pytest.raises(UsageError, match="changes in time"):
        linearise(Model(timed, {"drift": 0.1}, W))
    with pytest.raises(UsageError, match="amplitude"):
        linearise(known(PAPER), -0.1)
    with pytest.raises(UsageError, match="inertia"):
        to_nonlinear_system(known(PAPER), 0.0)
