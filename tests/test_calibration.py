"""Stated errors equal the scatter over seeds for every method and kind of record; best reach the bound."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import test_own_quantity
import test_sensor_terms
import xarray as xr
from helpers import (
    FIVE,
    NOISE,
    OWN_MODELS,
    SIX,
    Run,
    W,
    correlated_noise,
    decay,
    paper_run,
    rms,
    rms_range,
    scores,
    share_range,
)  # fmt: skip
from test_direct import run_with

import sysid_trib as st
from sysid_trib.motion_fit.least_squares import cramer_rao_bound

Direct, Trajectory, Averaging = st.methods.Direct, st.methods.Trajectory, st.methods.Averaging
STRONG = SIX | {"lambda": 1e-3}
PAPER, FITTED, STOP = paper_run(), paper_run(FIVE), paper_run(STRONG)
DRY, SHORT = paper_run(STRONG, duration=14.0), paper_run(FIVE, duration=15.0, sampling_rate=50.0)


@dataclass(frozen=True)
class Case:
    """Records of a run or another maker, a method, and how large its errors may be."""

    method: object
    run: Run | None = None
    seeds: int = 20
    over_bound: float = np.inf
    most: float = 1.0
    records: Callable[[int], object] | None = None
    truth: dict[str, float] | None = None

    def result(self, seed: int) -> xr.Dataset:
        """The identification of a seed, with the forces of the truth."""
        record = self.records(seed) if self.records else decay(self.run.time, self.run.angle, seed)
        library = test_sensor_terms.LIBRARY.select(self.truth) if self.truth else self.run.model.library
        return self.method.identify(record, library)


def coloured(seed: int) -> xr.Dataset:
    return decay(PAPER.time, PAPER.angle + correlated_noise(len(PAPER.time), seed, 0.9))


def pair(seed: int) -> list[xr.Dataset]:
    return [FITTED.decay(seed), replace(SHORT, start=0.6).decay(1000 + seed, 3e-4)]


TERMS = test_sensor_terms.TRUTH | test_sensor_terms.TERMS
CASES = {
    "direct": Case(Direct(W), PAPER, 25, 1.2),
    "direct, strong dry friction": Case(Direct(W), DRY, 25, 1.5),
    "direct, frequency fitted": Case(Direct(), FITTED, 25, 1.2),
    # The estimate of Newey and West contains most of the error; with white noise of this size it would be a
    # third.
    "direct, coloured": Case(Direct(W), PAPER, most=1.25, records=coloured),
    **{f"direct, {s}": Case(*reversed(run_with(s)), seeds=12) for s in ("stribeck", "jenkins", "masing")},
    "direct, sensor": Case(Direct(), seeds=8, records=test_sensor_terms.record, truth=TERMS),
    "trajectory": Case(Trajectory(W), PAPER, 20, 1.0),
    "trajectory, stop inside": Case(Trajectory(W), STOP, 20, 1.0),
    "trajectory, coloured": Case(Trajectory(W, noise="coloured"), PAPER, records=coloured),
    "averaging": Case(Averaging(), FITTED, 20, 1.25),
    "averaging, w given": Case(Averaging(reference_frequency=W), PAPER, 20, 1.25),
    "averaging, analytic signal": Case(Averaging(curve="analytic-signal"), FITTED, 30),
    "two runs, direct": Case(Direct(), FITTED, 15, records=pair),
    "two runs, averaging": Case(Averaging(), FITTED, 15, records=pair),
    "two runs, trajectory": Case(Trajectory(), FITTED, 12, records=pair),
    **{kind.__name__: Case(kind(), paper_run(own, duration=6.0)) for kind, own in OWN_MODELS.items()},
}
FAST = ("direct", "direct, sensor")


@pytest.mark.parametrize(
    "case", [pytest.param(c, id=n, marks=[pytest.mark.in_full] * (n not in FAST)) for n, c in CASES.items()]
)
def test_stated_errors_tell_the_scatter(case):
    truth = case.truth or case.run.model.coefficients
    results = [case.result(seed) for seed in range(case.seeds)]
    z = np.array([scores(result, truth) for result in results])
    low, high = rms_range(case.seeds)
    assert np.all((rms(z) > low) & (rms(z) < case.most * high))
    assert np.all(np.mean(np.abs(z) < 1.96 * case.most, axis=0) >= share_range(case.seeds, 0.95)[0])
    if np.isfinite(case.over_bound):
        run = case.run
        free = "alpha" not in truth
        bound = cramer_rao_bound(run.model, run.time, run.start, 0.0, NOISE, free=free).standard_error
        errors = [result.coefficient.sel(force=list(truth)) - list(truth.values()) for result in results]
        ratio = rms(errors) / bound.values
        # An unbiased method at the bound exceeds `high` once in 10^4.
        assert np.all((ratio > low) & (ratio < case.over_bound * high))


@pytest.mark.in_full
@pytest.mark.parametrize("quantity", test_own_quantity.KINDS)
def test_errors_for_each_measured_quantity_cover_the_truth(tmp_path, quantity):
    records = [test_own_quantity.decay_of(tmp_path / "a.csv", quantity, seed) for seed in range(20)]
    found = [Trajectory().identify(record, test_own_quantity.FORCES) for record in records]
    z = [test_own_quantity.excess(result) for result in found]
    assert np.mean(np.abs(z) < 1.96) > 0.88
    assert np.sqrt(np.mean(np.square(z), axis=0)) == pytest.approx(1.0, abs=0.35)
