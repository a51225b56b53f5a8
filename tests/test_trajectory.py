"""The trajectory fit: exact, at the Cramér-Rao bound, from far starts, through a stop, in coloured noise."""

import numpy as np
import pytest
from candidates import CANDIDATES
from helpers import (
    FIVE,
    NOISE,
    SIX,
    W,
    correlated_noise,
    decay,
    over_seeds,
    paper_run,
    rms,
    rms_range,
    share_range,
    values,
)

from sysid_trib import Model, load_library
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.likelihood.sensor_noise import autoregression
from sysid_trib.methods import Trajectory
from sysid_trib.motion_fit.cramer_rao import cramer_rao_bound
from sysid_trib.motion_fit.problem import OUT_OF_PROPORTION, WhitenedRecord
from sysid_trib.simulation.simulate import trajectory

FORCES = load_library()
STOPPING = SIX | {"lambda": 1e-3}
SEEDS = 20


@pytest.mark.parametrize("truth", [SIX, STOPPING], ids=["paper", "stop inside the record"])
@pytest.mark.in_full
def test_errors_reach_the_bound_and_intervals_cover(truth):
    run = paper_run(truth)
    errors, reported = over_seeds(run, lambda d: Trajectory(W).identify(d, FORCES), SEEDS)
    bound = cramer_rao_bound(run.model, run.time, run.start, 0.0, NOISE).standard_error.values
    low, high = rms_range(SEEDS)
    assert np.all((low < rms(errors) / bound) & (rms(errors) / bound < high))
    assert np.all(np.mean(np.abs(errors) < 1.96 * reported, axis=0) >= share_range(SEEDS, 0.95)[0])


@pytest.mark.parametrize("frequency", [W, 9.6, 10.3])
def test_converges_from_zeros(frequency):
    record = paper_run(FIVE).decay(0)
    start = Model(FORCES, dict.fromkeys(FIVE, 0.0), frequency)
    found = Trajectory(start=start).identify(record, FORCES)
    assert found.reference_frequency.item() == pytest.approx(W, abs=3e-4)
    assert found.noise.item() == pytest.approx(NOISE, rel=0.05)


@pytest.mark.slow
def test_converges_from_a_factor_of_three_in_every_coefficient():
    record, random = paper_run().decay(0), np.random.default_rng(3)
    for _ in range(12):
        factors = 3.0 ** random.choice([-1.0, 1.0], len(SIX))
        guess = {symbol: value * f for (symbol, value), f in zip(SIX.items(), factors, strict=True)}
        found = Trajectory(W, start=Model(FORCES, guess, W)).identify(record, FORCES)
        assert found.noise.item() == pytest.approx(NOISE, rel=0.05)


def test_exact_without_noise_and_with_an_offset():
    run = paper_run(FIVE)
    found = Trajectory().identify(decay(run.time, run.angle + 5e-3), FORCES)
    assert values(found, FIVE) == pytest.approx(list(FIVE.values()), rel=1e-7)
    assert found.offset.item() == pytest.approx(5e-3, abs=1e-9)


@pytest.mark.in_full
def test_coloured_noise_is_whitened():
    run, errors, reported = paper_run(), [], []
    exact = run.angle
    for seed in range(SEEDS):
        record = decay(run.time, exact + correlated_noise(len(run.time), seed, 0.9))
        found = Trajectory(W, noise="coloured").identify(record, FORCES)
        errors.append(values(found, SIX) - list(SIX.values()))
        reported.append(found.standard_error.values)
    ratio = rms(np.array(errors) / np.array(reported))
    low, high = rms_range(SEEDS)
    assert np.all((low < ratio) & (ratio < high))
    assert found.attrs["noise_model"] == "autoregression of order 1"


def test_order_of_the_noise_is_found():
    assert len(autoregression(np.random.default_rng(0).standard_normal(4000))) == 1
    assert autoregression(correlated_noise(4000, 0, 0.9)) == pytest.approx([1.0, -0.9], abs=0.03)


def test_a_shape_parameter_is_fitted():
    library = parse_library(
        {"force": [{"symbol": "dahl", **CANDIDATES["dahl"]}, *_entries("zeta", "nu")]}, "test"
    )
    truth = Model(library, {"dahl": 3e-3, "zeta": 0.005, "nu": -0.3}, W, {"dahl.s": 0.03})
    time = np.arange(1500) / 100.0
    record = decay(time, trajectory(truth, time, 0.3, 0.0).angle, 1)
    found = Trajectory(W, fit_shapes=("dahl.s",), shapes={"dahl.s": 0.02}).identify(record, library)
    for value, error, true in (
        (found.shape.item(), found.shape_standard_error.item(), 0.03),
        *zip(
            values(found, truth.coefficients),
            found.standard_error.sel(force=list(truth.coefficients)).values,
            truth.coefficients.values(),
            strict=True,
        ),
    ):
        assert abs(value - true) < 4.5 * error
    assert 0.0 < found.shape_standard_error.item() < 0.01


def test_bounds_are_kept():
    record = paper_run(FIVE).decay(0)
    found = Trajectory(constraints={"lambda": (0.0, np.inf)}).identify(record, FORCES)
    assert 0.0 <= found.coefficient.sel(force="lambda").item() < 1e-6


def test_what_cannot_be_asked_is_refused():
    record = paper_run(FIVE, duration=10.0).decay(0)
    with pytest.raises(UsageError, match="coloured"):
        Trajectory(noise="pink")
    with pytest.raises(UsageError, match="shape"):
        Trajectory(fit_shapes=("lambda.s",)).identify(record, FORCES)
    with pytest.raises(UsageError, match="gamma"):
        Trajectory(constraints={"gamma": (0.0, 1.0)}).identify(record, FORCES)
    with pytest.raises(DecayError, match="follows"):
        Trajectory(reference_frequency=5.0).identify(record, FORCES.select(["zeta"]))


def _entries(*symbols):
    return [{"symbol": s, "formula": FORCES[s].formula.text} for s in symbols]


@pytest.mark.parametrize(("w", "own"), [(6e4, (0.3, 0.0)), (W, (118.0, 0.0)), (W, (0.3, -1e5))])
def test_motions_out_of_all_proportion_are_far_off_without_being_followed(monkeypatch, w, own):
    """An optimiser astray once asked for 10^5 swings at a time: hours."""
    time = np.arange(0.0, 10.0, 0.02)
    angle = 0.3 * np.cos(W * time)
    model = Model(load_library().select(["zeta"]), {"zeta": 0.0}, W)
    record = WhitenedRecord(time, angle)
    np.testing.assert_allclose(record.residual(model, np.array([0.3, 0.0, 0.0])), 0.0, atol=1e-6)
    monkeypatch.setattr(
        "sysid_trib.motion_fit.problem.trajectory", lambda *_, **__: pytest.fail("was followed")
    )
    far, nearer = (
        record.residual(Model(model.library, {"zeta": 0.0}, part * w), np.array([*own, 0.0]) * part)
        for part in (1.0, 0.99)
    )
    assert rms(nearer) > OUT_OF_PROPORTION * 0.3
    # There is a slope that leads back.
    assert rms(nearer) < rms(far)
