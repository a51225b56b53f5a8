import numpy as np
import pytest
from candidates import CANDIDATES, candidate
from hypothesis import given, strategies as st
from scipy.special import beta

from sysid_trib import Model, load_library
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import SimulationError
from sysid_trib.forces.library import parse_library
from sysid_trib.questions.averaged_motion import predict_envelope
from sysid_trib.simulation.simulate import simulate

W = 9.91
PAPER = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
TIME = np.linspace(0.0, 25.0, 501)


def predicted(coefficients, amplitude=0.3, t=TIME, shapes=None):
    six = [{"symbol": f.symbol, "formula": f.formula.text} for f in load_library()]
    library = parse_library({"force": [*six, *({"symbol": k, **v} for k, v in CANDIDATES.items())]}, "test")
    return predict_envelope(Model(library, coefficients, W, shapes or {}), t, amplitude)


def dry_and_viscous(t, start, solid, viscous):
    level = 2 * solid / (np.pi * viscous)
    return np.maximum(0.0, (start + level) * np.exp(-viscous * W * t) - level)


def viscous_and_quadratic(t, start, viscous, quadratic):
    fall = np.exp(-viscous * W * t)
    return start * fall / (1 + 4 * quadratic * start / (3 * np.pi * viscous) * (1 - fall))


def solid_and_quadratic(t, start, solid, quadratic):
    level = np.sqrt(1.5 * solid / quadratic)
    rate = W * np.sqrt(8 * solid * quadratic / (3 * np.pi**2))
    return level * np.maximum(0.0, np.tan(np.maximum(0.0, np.arctan(start / level) - rate * t)))


ROOT = beta(0.5, 1.25) / np.pi
# Coefficients (those of Fig. 2 among them), first amplitude, closed envelope, arrest (s).
CLOSED = [
    ({"lambda": 0.03}, 1.0, lambda t: np.maximum(0, 1 - 2 * 0.03 / np.pi * W * t), np.pi / (2 * 0.03 * W)),
    ({"lambda": 1e-4}, 0.3, lambda t: 0.3 - 2e-4 / np.pi * W * t, 0.3 * np.pi / (2e-4 * W)),
    ({"zeta": 0.05}, 1.0, lambda t: np.exp(-0.05 * W * t), np.nan),
    ({"zeta": 0.9}, 1.0, lambda t: np.exp(-0.9 * W * t), np.nan),
    ({"delta": 0.9}, 1.0, lambda t: 1 / (1 + 4 * 0.9 / (3 * np.pi) * W * t), np.nan),
    (
        {"lambda": 1e-3, "zeta": 0.01},
        0.3,
        lambda t: dry_and_viscous(t, 0.3, 1e-3, 0.01),
        np.log(1 + 0.3 * np.pi * 0.01 / 2e-3) / (0.01 * W),
    ),
    ({"zeta": 0.01, "delta": 0.5}, 0.3, lambda t: viscous_and_quadratic(t, 0.3, 0.01, 0.5), np.nan),
    (
        {"lambda": 2e-3, "delta": 0.1},
        0.3,
        lambda t: solid_and_quadratic(t, 0.3, 2e-3, 0.1),
        np.arctan(0.3 / np.sqrt(0.03)) / (W * np.sqrt(8 * 2e-4 / (3 * np.pi**2))),
    ),
    (
        {"power": 0.01},
        0.3,
        lambda t: np.maximum(0, 0.3**0.5 - 0.5 * 0.01 * W * ROOT * t) ** 2,
        2 * 0.3**0.5 / (0.01 * W * ROOT),
    ),
    ({"nu": 0.5, "epsilon": -0.3, "alpha": 0.1}, 0.3, lambda t: np.full_like(t, 0.3), np.nan),
    ({}, 0.3, lambda t: np.full_like(t, 0.3), np.nan),
]


@pytest.mark.parametrize(
    ("coefficients", "start", "closed", "arrest"), CLOSED, ids=[str(case[0]) for case in CLOSED]
)
def test_envelope_and_arrest_are_the_closed_solutions(coefficients, start, closed, arrest):
    found = predicted(coefficients, start)
    np.testing.assert_allclose(found.amplitude, closed(TIME), atol=1e-10)
    # A square-root friction ends with a vanishing slope, which makes the end itself less sharp.
    assert found.arrest_time.item() == pytest.approx(
        arrest, rel=1e-7 if "power" in coefficients else 1e-9, nan_ok=True
    )


def test_frequency_is_the_papers_equation_13():
    found = predicted(PAPER | {"alpha": 0.02})
    a = found.amplitude
    expected = W * (1 + 0.01 + 4 * a * -0.40 / (3 * np.pi) + 3 * a**2 * 0.30 / 8)
    np.testing.assert_allclose(found.frequency, expected, rtol=1e-12)


def test_phase_is_the_integral_of_the_frequency():
    found = predicted({"zeta": 0.02, "nu": -0.4})
    fall = 1 - np.exp(-0.02 * W * TIME)
    np.testing.assert_allclose(found.phase, W * TIME + 4 * -0.4 / (3 * np.pi) * 0.3 * fall / 0.02, rtol=1e-11)


@pytest.mark.parametrize(
    "coefficients",
    [
        {"freeplay": 0.1, "zeta": 0.02},
        {"stribeck": 5e-4, "zeta": 0.01},
        {"dahl": 2e-3, "zeta": 0.01},
        {"jenkins": 0.05, "zeta": 0.01},
        {"gravity": 0.2, "rate": 1e-4},
    ],
    ids="+".join,
)
def test_tabulated_signatures_keep_the_equation(coefficients):
    # Differentiate the integrated motion and compare with signatures computed without the table.
    t = np.linspace(0.0, 20.0, 2001)
    found = predicted(coefficients, t=t)
    a = found.amplitude.values
    here = slice(100, 1901, 100)
    steps = (a[99:1900:100] - a[101:1902:100]) / (t[101:1902:100] - t[99:1900:100])
    every = {k: load_library()[k] if k in load_library().symbols else candidate(k) for k in coefficients}
    pairs = {k: averages(force, a[here]) for k, force in every.items()}
    slope = W * sum(c * pairs[k][0] for k, c in coefficients.items())
    np.testing.assert_allclose(-steps, slope, rtol=2e-4, atol=1e-9)
    frequency = W * (1 + sum(c * pairs[k][1] for k, c in coefficients.items()) / a[here])
    np.testing.assert_allclose(found.frequency[here], frequency, rtol=1e-6)


def gaps_at_the_tenth_turn(strength):
    """Relative gap of the amplitude and gap of the phase (rad) between prediction and exact motion."""
    forces = {"lambda": 2e-4, "zeta": 0.01, "delta": 0.1, "nu": -0.3, "epsilon": 0.2}
    model = Model(load_library(), {k: strength * c for k, c in forces.items()}, W)
    step = 5e-4
    t = np.arange(0.0, 8.0, step)
    run = simulate(model, t, 0.3)
    x, v = run.angle.values, run.rate.values
    turn = np.flatnonzero((v[:-1] > 0) & (v[1:] <= 0))[9]
    part = v[turn] / (v[turn] - v[turn + 1])
    peak, when = x[turn] + 0.5 * part * step * v[turn], t[turn] + part * step
    found = predict_envelope(model, [0.0, when], 0.3).isel(time=-1)
    return abs(found.amplitude.item() / peak - 1), abs(found.phase.item() - 20 * np.pi)


def test_the_error_is_of_second_order_in_the_forces():
    gaps = np.array([gaps_at_the_tenth_turn(strength) for strength in (0.05, 0.025, 0.0125)])
    np.testing.assert_allclose(gaps[1:] / gaps[:-1], 0.25, atol=0.04)


@pytest.mark.slow
@given(
    st.fixed_dictionaries(
        {"lambda": st.floats(0, 0.01), "zeta": st.floats(0, 0.2), "delta": st.floats(0, 0.5)}
    ),
    st.floats(0.05, 1.5),
)
def test_amplitude_never_grows_under_friction(coefficients, start):
    a = predicted(coefficients, start, t=np.linspace(0, 20, 60)).amplitude.values
    assert np.all(np.diff(a) <= 1e-12)
    assert np.all(a >= 0)


@pytest.mark.parametrize("amplitude", [0.0, -0.3, np.nan, np.inf])
def test_bad_amplitude(amplitude):
    with pytest.raises(SimulationError, match="amplitude"):
        predicted({"zeta": 0.01}, amplitude)


def test_growth_without_bound_is_refused():
    with pytest.raises(SimulationError, match="grows without bound"):
        predicted({"delta": -0.9})
