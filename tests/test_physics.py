import numpy as np
import pytest
import xarray as xr
from candidates import CANDIDATES
from helpers import rms_range
from known_results import PAPER, W, correlated, known
from scipy.integrate import quad

from sysid_trib import Model, load_library
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.methods import Direct
from sysid_trib.physics import inertia_with_mass
from sysid_trib.physics.contact import SLIP_RATIO, contact_stiffness, slip_fingerprint, sphere_stiffness
from sysid_trib.physics.force_weights import crossovers, dissipated_energy, weights
from sysid_trib.physics.model_estimate import arrest_time
from sysid_trib.physics.si_units import physical_units
from sysid_trib.simulation.simulate import simulate
from sysid_trib.simulation.trajectory import trajectory

INERTIA = 1.33e-6
# Dry friction, so that the motion stops, and every pair of forces far from its limits.
DRY = {"lambda": 1e-3, "zeta": 0.01, "delta": 0.04, "nu": -0.4, "epsilon": 0.3}


def every_force():
    entries = [{"symbol": k, **v} for k, v in CANDIDATES.items()]
    six = [{"symbol": f.symbol, "formula": f.formula.text} for f in load_library()]
    return parse_library({"force": six + entries}, "test")


def with_errors(coefficients, part=0.01, w=W):
    values = np.array([*coefficients.values(), w])
    return known(coefficients, correlated(values, part), w=w)


# Energy balance.

BALANCES = [
    {"lambda": 1e-3},
    {"zeta": 0.01},
    {"delta": 0.05},
    {"lambda": 2e-4, "zeta": 0.005, "delta": 0.04, "nu": -0.05, "epsilon": 0.05},
    {"zeta": 0.005, "alpha": 0.02, "van_der_pol": 0.1},
    {"zeta": -0.002, "cubic_damping": 0.2},
    {"jenkins": 0.05},
    {"masing": 0.05},
    {"stribeck": 1e-3, "power": 2e-3},
]


def exact_loss(model, start):
    """Energy lost in the second cycle (rad^2), its amplitude; two extrema apart the memory has settled."""
    time = np.arange(0.0, 3.2 * 2 * np.pi / W, 1e-3)
    run = simulate(model, time, start)
    rate = run.rate.values
    tops = np.flatnonzero((rate[:-1] > 0) & (rate[1:] <= 0))[:2]
    heights = []
    for i in tops:
        at = np.linspace(time[i], time[i + 1], 3)[1]
        fine = np.concatenate(([0.0], np.linspace(at - 2e-3, at + 2e-3, 401)))
        heights.append(trajectory(model, fine, start).position[1:].max())
    conservative = [f for f in model.forces if f.character == "conservative"]

    def potential(a):
        terms = (
            model.coefficients[f.symbol] * quad(lambda x, f=f: float(f.value(x, 0.0)), 0, a)[0]
            for f in conservative
        )
        return 0.5 * a**2 + sum(terms)

    return potential(heights[0]) - potential(heights[1]), 0.5 * sum(heights)


@pytest.mark.parametrize("coefficients", BALANCES, ids=lambda c: "+".join(c))
def test_dissipated_energies_add_up_to_the_energy_lost_in_a_simulated_cycle(coefficients):
    gaps = []
    for part in (1.0, 0.5):
        scaled = {k: part * c for k, c in coefficients.items()}
        lost, amplitude = exact_loss(Model(every_force(), scaled, W), 0.3)
        total = dissipated_energy(known(scaled, library=every_force()), amplitude).total_energy.item()
        gaps.append(abs(total / lost - 1.0))
    size = sum(abs(c) for c in coefficients.values())
    assert gaps[0] < 2.0 * size
    # Of first order in the forces: the remainder of the energy balance is of second order.
    assert gaps[1] < 0.7 * gaps[0] + 1e-6


def test_energy_in_joule_and_its_shares():
    result = with_errors(PAPER)
    plain, joule = dissipated_energy(result, [0.3, 0.05]), dissipated_energy(result, [0.3, 0.05], INERTIA)
    np.testing.assert_allclose(joule.energy, plain.energy * INERTIA * W**2, rtol=1e-12)
    assert joule.energy.attrs["units"] == "J"
    np.testing.assert_allclose(plain.energy.sum("force"), plain.total_energy, rtol=1e-12)
    np.testing.assert_allclose(np.abs(plain.energy_share).sum("force"), 1.0, rtol=1e-12)
    np.testing.assert_allclose(plain.energy_share, weights(result, [0.3, 0.05]).decay_share, atol=1e-14)
    assert plain.energy.sel(force="lambda", amplitude=0.3).item() < 0
    expected = 2 * np.pi * 0.0097 * 0.3**2
    assert plain.energy.sel(force="zeta", amplitude=0.3).item() == pytest.approx(expected, rel=1e-12)


# Errors.


def scattered(coefficients, spread, function, draws):
    """Values of `function` over identifications drawn from their covariance."""
    random = np.random.default_rng(11)
    at = np.array([*coefficients.values(), W])
    found = []
    for z in random.multivariate_normal(at, spread, draws, method="cholesky"):
        found.append(function(known(dict(zip(coefficients, z[:-1], strict=True)), w=z[-1])))
    return np.std(np.array(found), axis=0, ddof=1)


def flat(dataset, names, suffix=""):
    return np.concatenate([np.ravel(dataset[f"{name}{suffix}"].values) for name in names])


QUANTITIES = {
    "weights": (
        lambda r: weights(r, [0.3, 0.05]),
        ["peak_force", "decay", "frequency_shift", "decay_share", "frequency_share"],
    ),
    "crossovers": (crossovers, ["amplitude"]),
    "arrest": (lambda r: arrest_time(r, 0.3), ["arrest_time"]),
    "energy": (
        lambda r: dissipated_energy(r, 0.3, INERTIA),
        ["energy", "energy_share", "total_energy", "lost_fraction"],
    ),
    "fingerprint": (slip_fingerprint, ["ratio"]),
    "stiffness": (lambda r: physical_units(r, INERTIA), ["linear_stiffness"]),
}


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.in_full
def test_propagated_errors_are_the_scatter_of_drawn_identifications(quantity):
    function, names = QUANTITIES[quantity]
    draws = 120
    spread = correlated(np.array([*DRY.values(), W]), 0.004)
    stated = flat(function(known(DRY, spread)), names, "_standard_error")
    found = scattered(DRY, spread, lambda r: flat(function(r), names), draws)
    low, high = rms_range(draws - 1)
    used = stated > 0
    assert used.any()
    np.testing.assert_array_less(low, found[used] / stated[used])
    np.testing.assert_array_less(found[used] / stated[used], high)
    assert np.all(found[~used] < 1e-15)


# Units, reference, symbols.


def test_units_follow_from_the_formulas():
    library = every_force()
    expected = {
        "lambda": ("N m", "1"),
        "zeta": ("N m s rad-1", "|theta'|"),
        "delta": ("N m s2 rad-2", "|theta'|^2"),
        "alpha": ("N m rad-1", "|theta|"),
        "nu": ("N m rad-2", "|theta|^2"),
        "epsilon": ("N m rad-3", "|theta|^3"),
        "van_der_pol": ("N m s rad-3", "|theta|^2 |theta'|"),
        "drift": ("N m", "t*v, x = theta, v = theta'"),
        "stribeck": ("N m", "exp(-(v/s)**2)*sign(v), x = theta, v = theta'/w"),
        "dahl": ("N m", "z, x = theta, v = theta'/w"),
    }
    found = physical_units(known(dict.fromkeys(expected, 0.1), library=library), INERTIA)
    for symbol, (unit, term) in expected.items():
        assert found["unit"].sel(force=symbol).item() == unit
        assert found["multiplies"].sel(force=symbol).item() == term


def test_no_force_is_known_by_its_symbol():
    renamed = {"lambda": "a", "zeta": "lambda", "delta": "nu", "nu": "delta", "epsilon": "e", "alpha": "zeta"}
    entries = [{"symbol": renamed[f.symbol], "formula": f.formula.text} for f in load_library()]
    library = parse_library({"force": entries}, "test")
    values = {**DRY, "alpha": 0.1}
    spread = correlated(np.array([*values.values(), W]), 0.01)
    one, other = (
        known(values, spread),
        known({renamed[k]: c for k, c in values.items()}, spread, library=library),
    )
    np.testing.assert_array_equal(weights(one, 0.3).decay, weights(other, 0.3).decay)
    np.testing.assert_array_equal(crossovers(one).amplitude, crossovers(other).amplitude)
    np.testing.assert_array_equal(
        physical_units(one, 1.0).coefficient, physical_units(other, 1.0).coefficient
    )
    assert slip_fingerprint(one).ratio.item() == slip_fingerprint(other).ratio.item()
    assert slip_fingerprint(other).attrs["numerator"] == "delta"


# Weights, crossovers, arrest.


def test_weights_of_any_force_are_its_signature():
    library = every_force()
    symbols = [f.symbol for f in library if f.kind == "force" and not f.holds_time]
    found = weights(known(dict.fromkeys(symbols, 0.5), library=library), [0.02, 0.3])
    assert np.all(found.peak_force.sel(amplitude=0.3) > 0)
    # No average is larger than the peak.
    assert np.all(np.abs(found.decay) <= found.peak_force * (1 + 1e-6))
    assert found.peak_force.sel(force="jenkins", amplitude=0.3).item() == pytest.approx(0.5 * 0.02, rel=1e-6)


# Fingerprint.


@pytest.mark.parametrize(("kappa", "noise"), [(0.02, 1e-5), (0.2, 1e-3)])
def test_a_slipping_contact_has_the_fingerprint(kappa, noise):
    # Records of Masing's hysteresis (m = 2), identified with the six forces. Of one the ratio has an error of
    # up to a tenth.
    model = Model(every_force(), {"zeta": 0.01, "masing": kappa}, W)
    time, ratios = np.arange(0.0, 25.0, 0.01), []
    motion = trajectory(model, time, 0.3).position
    for seed in range(4):
        angle = motion + noise * np.random.default_rng(seed).standard_normal(time.size)
        result = Direct().identify(xr.Dataset({"angle": ("time", angle)}, {"time": time}), load_library())
        found = slip_fingerprint(result)
        ratios.append(found.ratio.item())
        assert found.attrs["verdict"] == "compatible"
    assert np.mean(ratios) == pytest.approx(SLIP_RATIO, rel=0.16)


@pytest.mark.parametrize(
    ("nu", "delta", "errors", "verdict"),
    [
        (-0.0942, 0.04, (0.002, 0.001), "compatible"),
        (-0.40, 0.037, (0.003, 0.001), "not compatible"),
        (-0.06, 0.04, (1e-5, 1e-5), "not compatible"),
        (0.01, 0.0, (0.2, 0.001), "undecided"),
    ],
)
def test_verdict_of_the_fingerprint(nu, delta, errors, verdict):
    spread = np.diag([errors[1] ** 2, errors[0] ** 2, 0.0])
    assert slip_fingerprint(known({"delta": delta, "nu": nu}, spread)).attrs["verdict"] == verdict


# Stiffness and inertia.


def test_errors_of_stiffness_and_inertia():
    found = contact_stiffness(
        9.91,
        8.87,
        INERTIA,
        frequency_standard_error=0.01,
        omega0_standard_error=0.02,
        inertia_standard_error=2e-8,
    )
    parts = np.array([2 * 9.91 * INERTIA * 0.01, 2 * 8.87 * INERTIA * 0.02, (9.91**2 - 8.87**2) * 2e-8])
    assert found.contact_stiffness_standard_error.item() == pytest.approx(np.linalg.norm(parts), rel=1e-6)
    sphere = sphere_stiffness(0.53e6, 2e-4, contact_radius_standard_error=1e-5)
    relative = sphere.contact_stiffness_standard_error.item() / sphere.contact_stiffness.item()
    assert relative == pytest.approx(0.15, rel=1e-5)
    whole = inertia_with_mass(1.24e-6, 9e-4, 0.01, inertia_standard_error=1e-8, radius_standard_error=1e-4)
    expected = np.hypot(1e-8, 2 * 9e-4 * 0.01 * 1e-4)
    assert whole.inertia_standard_error.item() == pytest.approx(expected, rel=1e-6)


# Printing and wrong requests.


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: weights(xr.Dataset(), 0.3), "identification"),
        (lambda: weights(known(DRY), -0.3), "positive angles"),
        (lambda: physical_units(known(DRY), 0.0), "inertia"),
        (lambda: physical_units(known(DRY), 1.0, inertia_standard_error=-1.0), "standard error"),
    ],
)
def test_wrong_requests_are_usage_errors(call, message):
    with pytest.raises(UsageError, match=message):
        call()
