"""Classical methods: how well calibrated on decays of their own model, how wrong where they neglect forces.

Runs start from 0.3 rad at rest, w = 9.91 rad/s, 100 Hz, white noise of 1e-4 rad; the seeds are 0, 1, 2, ...
Own model: 12 s of the forces that the method looks for. Paper's run: 25 s of all six forces.
"""

from argparse import Namespace
from functools import partial

import numpy as np
from helpers import FIVE, OWN_MODELS, SIX, Run, decay, paper_run, rms

from benchmarks.stopwatch import timed
from benchmarks.study.common import shown
from sysid_trib import methods

METHODS = [
    *((kind(), own) for kind, own in OWN_MODELS.items()),
    (methods.FrequencyShift(), FIVE),
    (methods.Averaging(), FIVE),
    (methods.Averaging(curve="analytic-signal"), FIVE),
    (methods.Direct(), FIVE),
]
HEADS = (
    *("method", "ms", "force", "own model: RMS error / its standard error", "paper's run: truth"),
    *("mean found", "bias", "bias / its standard error"),
)


def identified(method, run: Run, seeds: int):
    """Forces, their coefficients and standard errors, (seed, force), and the median time (ms)."""
    exact, library = run.angle, run.model.library
    records = [decay(run.time, exact, seed) for seed in range(seeds)]
    each = [timed(partial(method.identify, record, library)) for record in records]
    values, errors = (np.array([r[k].values for r, _ in each]) for k in ("coefficient", "standard_error"))
    return each[0][0].force.values.tolist(), values, errors, 1e3 * np.median([spent for _, spent in each])


def rows(method, own: dict[str, float], seeds: int) -> list[list[str]]:
    """One row a force."""
    forces, values, errors, spent = identified(method, paper_run(own, duration=12.0), seeds)
    pulls = rms((values - [own[symbol] for symbol in forces]) / errors)
    _, values, errors, _ = identified(method, paper_run(SIX), seeds)
    title = type(method).__name__ + (", analytic signal" if getattr(method, "curve", "")[:1] == "a" else "")
    table = []
    for at, symbol in enumerate(forces):
        true, mean, error = SIX[symbol], np.mean(values[:, at]), rms(errors[:, at])
        start = [title, f"{spent:.0f}"] if at == 0 else ["", ""]
        bias = [f"{100.0 * (mean - true) / abs(true):+.3g} %", f"{(mean - true) / error:+.2g}"]
        table.append([*start, symbol, f"{pulls[at]:.2f}", f"{true:.3g}", f"{mean:.4g}", *bias])
    return table


def main(asked: Namespace) -> None:
    chosen = ((method, own) for method, own in METHODS if asked.only in type(method).__name__)
    every = (row for method, own in chosen for row in rows(method, own, asked.seeds))
    shown(f"Classical methods, {asked.seeds} seeds", HEADS, every)
