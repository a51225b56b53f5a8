"""Candidate effects of the package, compared with the literature on each."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy import pi
from scipy.special import beta, dawsn, j1

from sysid_trib import Model, load_library
from sysid_trib.cycles.signatures import averages
from sysid_trib.forces import indistinguishable
from sysid_trib.forces.notation import reference_powers
from sysid_trib.methods import Averaging
from sysid_trib.simulation.internal_states import states_along
from sysid_trib.simulation.simulate import simulate
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation.separability import exactly_dependent

SIX = load_library()
CANDIDATES = load_library("candidate_effects")
BOTH = replace(SIX, forces=(*SIX.forces, *CANDIDATES.forces))
A = np.array([0.005, 0.03, 0.1, 0.2, 0.7, 1.5])
TIME = 3.0
W = 9.91


def nothing(a):
    return np.zeros_like(a)


def lossy(p, q, factor=1.0):
    """Averages of |x|^p |v|^q sgn v."""
    return lambda a: -factor * a ** (p + q) * beta((p + 1) / 2, (q + 2) / 2) / pi, nothing


def elastic(p, q, factor=1.0):
    """Averages of |x|^p |v|^q sgn x."""
    return nothing, lambda a: factor * a ** (p + q) * beta((p + 2) / 2, (q + 1) / 2) / pi


def clearance(a, g=0.1):
    c = np.arccos(np.minimum(1.0, g / a))
    return a / (2 * pi) * (2 * c - np.sin(2 * c))


def masing(m, kappa=1.0):
    return (
        lambda a: -2 / pi * kappa * (m - 1) / (m + 1) * a**m,
        lambda a: -2 / pi * kappa * m / (m + 1) * beta(m + 0.5, 0.5) * a**m,
    )


def jenkins(a, s=0.02):
    slip = np.arccos(np.maximum(-1.0, 1 - 2 * s / a))
    return a / (2 * pi) * (slip - np.sin(2 * slip) / 2)


@cache
def at(symbol, shapes=(), amplitudes=None):
    return averages(CANDIDATES[symbol], A if amplitudes is None else np.array(amplitudes), dict(shapes), TIME)


EVEN = (nothing, nothing)
# Per candidate: parity, type by time reversal, <h sin phi> and <h cos phi> with default shapes at t = 3 s;
# None if there is no closed form: these are in the tests of limits below.
TABLE: dict[str, tuple[str, str, tuple[Callable, Callable] | None]] = {
    "cubic_damping": ("odd", "dissipative", (lambda a: -3 * a**3 / 8, nothing)),
    "van_der_pol": ("odd", "dissipative", (lambda a: -(a**3) / 8, nothing)),
    "angle_damping": ("odd", "dissipative", (lambda a: -2 * a**2 / (3 * pi), nothing)),
    "angle_drag": ("odd", "dissipative", lossy(1, 2)),
    "three_halves_damping": ("odd", "dissipative", lossy(0, 1.5)),
    "power_damping": ("odd", "dissipative", lossy(0, 0.5)),
    "angle_friction": ("odd", "dissipative", (lambda a: -2 * a**2 / (3 * pi), nothing)),
    "structural_damping": ("odd", "dissipative", (lambda a: -a / pi, nothing)),
    "stribeck": ("odd", "dissipative", (lambda a: -2 / pi * dawsn(a / 0.05) / (a / 0.05), nothing)),
    "stribeck_exponential": ("odd", "dissipative", None),
    "log_friction": ("odd", "dissipative", None),
    "maxwell": ("odd", "mixed", (lambda a: -a / 4, lambda a: a / 4)),
    "resonator": ("odd", "mixed", None),
    "jenkins": ("odd", "mixed", (lambda a: -0.04 / pi * np.maximum(0.0, 1 - 0.02 / a), jenkins)),
    "iwan": ("odd", "mixed", None),
    "dahl": ("odd", "mixed", None),
    "lugre": ("odd", "mixed", None),
    "bouc_wen": ("odd", "mixed", None),
    "bouc_wen_2": ("odd", "mixed", None),
    "partial_slip": ("odd", "mixed", masing(2)),
    "masing": ("odd", "mixed", masing(1.5)),
    "detent": ("odd", "conservative", (nothing, lambda a: np.full_like(a, 2 / pi))),
    "quintic": ("odd", "conservative", (nothing, lambda a: 5 * a**5 / 16)),
    "gravity": ("odd", "conservative", (nothing, lambda a: j1(a) - a / 2)),
    "magnet": ("odd", "conservative", (nothing, lambda a: j1(2 * a) / 2 - a / 2)),
    "inertia": ("odd", "conservative", (nothing, lambda a: a**3 / 8)),
    "speed_detent": ("odd", "conservative", (nothing, lambda a: 2 * a**2 / (3 * pi))),
    "speed_stiffness": ("odd", "conservative", elastic(1, 1)),
    "freeplay": ("odd", "conservative", (nothing, clearance)),
    "wall": ("mixed", "conservative", (nothing, lambda a: clearance(a) / 2)),
    "bias": ("even", "conservative", EVEN),
    "even_spring": ("even", "conservative", EVEN),
    "bilinear": ("even", "conservative", EVEN),
    "even_drag": ("even", "conservative", EVEN),
    "even_speed": ("even", "conservative", EVEN),
    "tilted_damping": ("even", "dissipative", EVEN),
    "tilted_friction": ("even", "dissipative", EVEN),
    "stiffness_drift": ("odd", "conservative", (nothing, lambda a: TIME * a / 2)),
    "damping_drift": ("odd", "dissipative", (lambda a: -TIME * a / 2, nothing)),
    "friction_drift": ("odd", "dissipative", lossy(0, 0, TIME)),
    "ageing": ("odd", "dissipative", lossy(0, 0, np.log(1 + TIME))),
    "equilibrium_drift": ("even", "conservative", EVEN),
    "ambient": ("even", "conservative", EVEN),
    "sensor_offset": ("even", "sensor", EVEN),
    "sensor_drift": ("even", "sensor", EVEN),
    "sensor_curve": ("even", "sensor", EVEN),
    "sensor_cubic": ("odd", "sensor", (nothing, lambda a: 3 * a**3 / 8)),
    "sensor_delay": ("odd", "sensor", (lambda a: a / 2, nothing)),
    "shutter": ("even", "sensor", EVEN),
    "clock": ("odd", "sensor", (lambda a: -TIME * a / 2, nothing)),
    "clock_drift": ("odd", "sensor", (lambda a: -(TIME**2) * a / 2, nothing)),
}


def test_table_is_the_library():
    assert tuple(TABLE) == CANDIDATES.symbols
    assert not set(TABLE) & set(SIX.symbols)
    for force in CANDIDATES:
        assert all((force.name, force.meaning, force.source, force.family))
        assert any(char.isdigit() for char in force.source)
        assert all(shape.meaning for shape in force.shape.values())


@pytest.mark.parametrize("symbol", TABLE)
def test_parity_and_type(symbol):
    parity, character, _ = TABLE[symbol]
    assert (CANDIDATES[symbol].parity, CANDIDATES[symbol].character) == (parity, character)


@pytest.mark.parametrize("symbol", [k for k, row in TABLE.items() if row[2] is not None])
def test_signature_is_the_tables(symbol):
    found = at(symbol)
    for value, closed in zip(found, TABLE[symbol][2], strict=True):
        np.testing.assert_allclose(value, closed(A), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("symbol", [k for k, row in TABLE.items() if row[1] != "sensor"])
def test_a_positive_coefficient_takes_energy_out_if_a_force_can(symbol):
    sine = at(symbol)[0]
    dissipates = TABLE[symbol][:2] in (("odd", "dissipative"), ("odd", "mixed"))
    assert np.all(sine[-2:] < 0) if dissipates else np.all(sine == 0)
    assert np.all(sine <= 1e-15)


def test_dahl_between_its_limits():
    small, large = at("dahl", (("dahl.s", 100.0),)), at("dahl", (("dahl.s", 1e-7),))
    np.testing.assert_allclose(small[0], -2 / (3 * pi) * (A / 100) ** 2, rtol=2e-3)
    np.testing.assert_allclose(small[1], A / 200, rtol=0.02)
    np.testing.assert_allclose(large[0], -2 / pi, rtol=1e-4)
    # A length s of sliding is a phase sqrt(s/a) at a reversal: the frequency shift falls as slowly as that.
    np.testing.assert_allclose(large[1], np.sqrt(2e-7 / (pi * A)), rtol=1e-4)


def test_lugre_without_its_peak_is_dahl():
    for value, expected in zip(at("lugre", (("lugre.r", 0.0),)), at("dahl"), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-12)
    # With short bristles it is dry friction with a Stribeck peak.
    shapes = (("lugre.s", 2e-5), ("lugre.r", 0.5), ("lugre.u", 0.05))
    peak = 2 / pi * (1 + 0.5 * dawsn(A / 0.05) / (A / 0.05))
    np.testing.assert_allclose(at("lugre", shapes)[0][2:], -peak[2:], rtol=1e-3)


def test_bouc_wen_of_order_one_mimics_delta_but_not_nu():
    # On a cycle z = x + (b/2) v|v| to first order in b: the table of the literature's forms adds a part like
    # nu, which is there to the second order only.
    b = 1e-3
    sine, cosine = at("bouc_wen", (("bouc_wen.b", b),))
    np.testing.assert_allclose(sine, b / 2 * averages(SIX["delta"], A)[0], rtol=1e-5)
    assert np.all(np.abs(cosine - A / 2) < 0.2 * b**2 * A**3)


@pytest.mark.parametrize("k", [0.5, 0.99, 1.02, 3.0])
def test_resonator_answers_at_the_frequency_of_the_motion(k):
    d = 0.02
    sine, cosine = at("resonator", (("resonator.k", k), ("resonator.d", d)))
    weight = (k**2 - 1) ** 2 + 4 * d**2
    np.testing.assert_allclose(sine, -A * d / weight, rtol=1e-9)
    np.testing.assert_allclose(cosine, -A * (k**2 - 1) / (2 * weight), rtol=1e-9)


def test_iwan_is_partial_slip_up_to_its_longest_slip_length_and_slides_beyond():
    s = 0.1
    sine, cosine = at("iwan")
    parts = masing(2, 1 / (2 * s))
    area = np.where(s < A, 2 * A * s - 4 * s**2 / 3, 2 * A**3 / (3 * s))
    np.testing.assert_allclose(sine, -area / (2 * pi * A), rtol=1e-10)
    np.testing.assert_allclose(cosine[:3], (A / 2 + parts[1](A))[:3], rtol=1e-10)


def test_partial_slip_has_the_fingerprint():
    sine, cosine = at("partial_slip")
    delta = sine / averages(SIX["delta"], A)[0]
    nu = cosine / averages(SIX["nu"], A)[1]
    np.testing.assert_allclose(delta, 0.5, rtol=1e-12)
    np.testing.assert_allclose(nu / delta, -3 * pi / 4, rtol=1e-12)


def tied(*symbols, shapes=None):
    return indistinguishable(BOTH.select(symbols), 0.01, 1.0, shapes=shapes)


@pytest.mark.parametrize(
    "group",
    [
        ("cubic_damping", "van_der_pol", "angle_drag"),
        ("delta", "angle_friction", "angle_damping"),
        ("zeta", "structural_damping"),
        ("epsilon", "inertia"),
        ("nu", "speed_detent", "speed_stiffness"),
        ("alpha", "zeta", "maxwell"),
        ("delta", "nu", "partial_slip"),
    ],
    ids="-".join,
)
def test_forces_with_equal_averages_are_separated_by_the_motion(group):
    assert tied(*group) == [group]
    library = BOTH.select(group)
    assert exactly_dependent(library, 1.0) == []


@pytest.mark.parametrize(
    ("pair", "shapes"),
    [
        (("lambda", "power_damping"), {"power_damping.p": 0.0}),
        (("zeta", "power_damping"), {"power_damping.p": 1.0}),
        (("delta", "power_damping"), {"power_damping.p": 2.0}),
        (("three_halves_damping", "power_damping"), {"power_damping.p": 1.5}),
        (("cubic_damping", "power_damping"), {"power_damping.p": 3.0}),
        (("partial_slip", "masing"), {"masing.m": 2.0}),
        (("dahl", "lugre"), {"lugre.r": 0.0}),
    ],
    ids=lambda part: "-".join(part) if isinstance(part, tuple) else "",
)
def test_one_force_written_twice_is_never_separated(pair, shapes):
    assert exactly_dependent(BOTH.select(pair), 1.0, shapes=shapes) == [pair]


def test_no_two_candidates_are_the_same_force():
    assert exactly_dependent(BOTH, 1.0) == []


def test_even_spring_fakes_a_cubic_force_of_minus_ten_ninths_of_its_square():
    time, b = np.linspace(0.0, 120.0, 4801), 0.05
    record = simulate(Model(BOTH, {"zeta": 0.01, "even_spring": b}, 1.0), time, 0.4)
    fitted = Averaging().identify(record, BOTH.select(["zeta", "epsilon"]))
    assert fitted.coefficient.sel(force="epsilon").item() == pytest.approx(-10 / 9 * b**2, rel=0.05)


# The power of the speed, and with it that of the reference frequency, is the shape parameter.
NO_POWER = {"power_damping"}


@pytest.mark.parametrize("symbol", [s for s in BOTH.symbols if s not in {"alpha", *NO_POWER}])
def test_a_force_is_the_same_with_another_reference_frequency(symbol):
    factor, force = 1.3, BOTH[symbol]
    library, powers = replace(BOTH, forces=(BOTH["alpha"], force)), reference_powers(force)
    defaults = {f"{symbol}.{name}": shape.default for name, shape in force.shape.items()}
    scaled = {
        f"{symbol}.{name}": shape.default * factor ** powers[name] for name, shape in force.shape.items()
    }
    c, time = 2e-3, np.linspace(0.0, 6.0, 400)
    here = Model(library, {"alpha": 0.0, symbol: c}, W, defaults)
    there = Model(library, {"alpha": factor**-2 - 1.0, symbol: c * factor ** powers[""]}, factor * W, scaled)
    one, other = (trajectory(model, time, 0.3, 0.0).angle for model in (here, there))
    np.testing.assert_allclose(one, other, rtol=0.0, atol=2e-8)


def test_a_power_that_is_a_shape_parameter_has_no_power_of_the_reference_frequency():
    assert {s for s in BOTH.symbols if reference_powers(BOTH[s]) is None} == NO_POWER


@pytest.mark.parametrize("frequency", [0.25, 1.0, 4.0])
def test_history_drag_is_half_a_derivative_of_the_rate(frequency):
    force = load_library("water")["history_drag"]
    tau = np.linspace(0.0, 40.0 * np.pi / frequency + 80.0, 6001)
    x, v = np.sin(frequency * tau) / frequency, np.cos(frequency * tau)
    value = force.value(x, v, tau, hidden=states_along(force, tau, x, v, time=tau))
    exact = np.sqrt(frequency) * np.cos(frequency * tau + np.pi / 4.0)
    settled = tau > 80.0
    assert np.abs(value - exact)[settled].max() < 0.04 * np.sqrt(frequency)
