"""Coverage of 95 % intervals by averaging, on simulated motions that are pushed at random.

python benchmarks/averaging_random_force.py [SEEDS]
"""

import sys
import time as clock
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.random_force import RandomForce, random_force_of

W, NOISE, PERIODS, PER_PERIOD, ANGLE = 8.87, 2e-4, 20, 60, 0.3
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
WANDERS = (0, 5, 20)
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
LIBRARY = st.load_library("contact_forces").select(TRUTH)
METHODS = {"w fitted": st.methods.Averaging(), "w given": st.methods.Averaging(reference_frequency=W)}


def decay(density: float, seed: int) -> xr.Dataset:
    """A motion that is pushed at random, seen by a sensor with noise."""
    model = st.Model(LIBRARY, TRUTH, W)
    angle = st.simulate(model, TIME, ANGLE, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))})


def study(wander: float, seeds: int) -> list[str]:
    """A line for each method: coverage, errors over standard errors and over those of `off`, density."""
    # The wander at the end, RMS, is so many noise levels.
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * TIME[-1]), W)
    decays = [decay(density, seed) for seed in range(seeds)]
    lines = []
    for name, method in METHODS.items():
        of_off = None
        for option in ("off", "estimated"):
            start = clock.process_time()
            results = [identified(record, replace(method, random_force=option)) for record in decays]
            taken = (clock.process_time() - start) / seeds
            settled = [result for result in results if result is not None]
            rms, line = statistics(settled, of_off)
            of_off = rms if option == "off" else of_off
            forces = [random_force_of(result) for result in settled]
            over_true = np.array([force.density for force in forces]) / (density or 1.0)
            significant = np.mean([force.p_value < 0.01 for force in forces])
            lines.append(
                f"wander {wander:2} {name}, {option}: {line}; density over the true one "
                f"{np.mean(over_true):.3g} (median {np.median(over_true):.3g}); random force at 1 %: "
                f"{100.0 * significant:.1f} %; refused {seeds - len(settled)}; {taken:.2f} s each"
            )
    return lines


def identified(record: xr.Dataset, method: st.methods.Averaging) -> xr.Dataset | None:
    """The result, None where it is refused."""
    try:
        return st.identify(record, LIBRARY, method)
    except DecayError:
        return None


def statistics(results: Sequence[xr.Dataset], of_off: np.ndarray | None) -> tuple[np.ndarray, str]:
    """RMS errors of the coefficients and of w where it is fitted, and what they are beside those stated."""
    errors = np.array([np.append(r.coefficient, r.reference_frequency) for r in results])
    stated = np.array([np.append(r.standard_error, r.reference_frequency_standard_error) for r in results])
    fitted = stated[0] > 0.0
    errors = (errors - np.append(list(TRUTH.values()), W))[:, fitted]
    scores = errors / stated[:, fitted]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    covered = np.abs(scores) < 1.96
    return rms, (
        f"coverage {100.0 * np.mean(covered):.1f} %, each {numbers(np.mean(covered, axis=0))}, RMS of error "
        f"over standard error {numbers(np.sqrt(np.mean(scores**2, axis=0)))}, RMS error over that of off "
        f"{numbers(rms / (rms if of_off is None else of_off))}"
    )


def numbers(values: np.ndarray) -> str:
    """In two digits after the point."""
    return ", ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    for wander in WANDERS:
        print(*study(wander, int(sys.argv[1]) if len(sys.argv) > 1 else 40), sep="\n", flush=True)
