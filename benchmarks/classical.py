"""Classical methods: how well calibrated on decays of their own model, how wrong where they neglect forces.

python benchmarks/classical.py [--seeds N]

Runs start from 0.3 rad at rest, w = 9.91 rad/s, 100 Hz, white noise of 1e-4 rad; the seeds are 0, 1, 2, ...
Own model: 12 s of the forces that the method looks for. Paper's run: 25 s of all six forces.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from helpers import FIVE, SIX, Run, decay, paper_run, rms  # noqa: E402
from stopwatch import timed  # noqa: E402

from sysid_trib.methods import (  # noqa: E402
    Averaging,
    Direct,
    EnergyDecay,
    FeenyLiang,
    FrequencyShift,
    LinearDecrement,
    LogarithmicDecrement,
    QuadraticDecay,
    WindowedERA,
    WuDecrement,
)

BOTH = {"lambda": 5e-4, "zeta": 0.0097}
METHODS: list[tuple[Any, dict[str, float]]] = [
    (LogarithmicDecrement(), {"zeta": 0.0097}),
    (WindowedERA(), {"zeta": 0.0097}),
    (LinearDecrement(), {"lambda": 1e-3}),
    (QuadraticDecay(), {"delta": 0.037}),
    (FeenyLiang(), BOTH),
    (EnergyDecay(), BOTH),
    (WuDecrement(), BOTH | {"delta": 0.037}),
    (FrequencyShift(), FIVE),
    (Averaging(), FIVE),
    (Averaging(curve="analytic-signal"), FIVE),
    (Direct(), FIVE),
]


def study(method: Any, run: Run, seeds: int) -> tuple[list[str], np.ndarray, np.ndarray, float]:
    """Forces, their coefficients and standard errors, (seed, force), and the median time (s)."""
    exact, coefficients, errors, spent = run.angle, [], [], []
    for seed in range(seeds):
        record = decay(run.time, exact, seed)
        result, seconds = timed(lambda record=record: method.identify(record, run.model.library))
        spent.append(seconds)
        coefficients.append(result.coefficient.values)
        errors.append(result.standard_error.values)
    return result.force.values.tolist(), np.array(coefficients), np.array(errors), float(np.median(spent))


def rows(method: Any, own: dict[str, float], seeds: int) -> list[list[str]]:
    """One row a force."""
    forces, values, errors, spent = study(method, paper_run(own, duration=12.0), seeds)
    pulls = rms((values - [own[symbol] for symbol in forces]) / errors)
    _, values, errors, _ = study(method, paper_run(SIX), seeds)
    title = type(method).__name__ + (", analytic signal" if getattr(method, "curve", "")[:1] == "a" else "")
    cells = []
    for at, symbol in enumerate(forces):
        mean, error = np.mean(values[:, at]), np.sqrt(np.mean(errors[:, at] ** 2))
        bias = mean - SIX[symbol]
        cells.append(
            [
                *((title, f"{1e3 * spent:.0f}") if at == 0 else ("", "")),
                symbol,
                f"{pulls[at]:.2f}",
                f"{SIX[symbol]:.3g}",
                f"{mean:.4g}",
                f"{100.0 * bias / abs(SIX[symbol]):+.3g} %",
                f"{bias / error:+.2g}",
            ]
        )
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=60)
    options = parser.parse_args()
    table = Table(
        "method",
        "ms",
        "force",
        "own model: RMS error / its standard error",
        "paper's run: truth",
        "mean found",
        "bias",
        "bias / its standard error",
        title=f"Classical methods, {options.seeds} seeds",
    )
    for method, own in METHODS:
        for row in rows(method, own, options.seeds):
            table.add_row(*row)
        table.add_section()
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
