"""Coverage of 95 % intervals by averaging, on simulated motions that are pushed at random.

python benchmarks/averaging_random_force.py [SEEDS]
"""

import sys
import time as clock
from functools import partial

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.noise.random_force import RandomForce, random_force_of

W, NOISE, PERIODS, PER_PERIOD, ANGLE = 8.87, 2e-4, 20, 60, 0.3
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
WANDERS = (0, 5, 20)
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
LIBRARY = st.load_library("contact_forces").select(TRUTH)
METHODS = {
    "off": st.methods.Averaging(),
    "auto": st.methods.Averaging(random_force="auto"),
    "auto, analytic signal": st.methods.Averaging(random_force="auto", curve="analytic-signal"),
}


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
    true = np.append(list(TRUTH.values()), W)
    of_off, lines = None, []
    for name, method in METHODS.items():
        start = clock.process_time()
        results = [st.identify(record, LIBRARY, method) for record in decays]
        taken = (clock.process_time() - start) / seeds
        errors = np.array([np.append(r.coefficient, r.reference_frequency) for r in results]) - true
        stated = [np.append(r.standard_error, r.reference_frequency_standard_error) for r in results]
        scores = errors / np.array(stated)
        rms = np.sqrt(np.mean(errors**2, axis=0))
        of_off = rms if of_off is None else of_off
        found = np.array([random_force_of(r).density for r in results]) / (density or 1.0)
        p_values = np.array([random_force_of(r).p_value for r in results])
        numbers = partial(np.array2string, precision=2, separator=", ")
        lines.append(
            f"wander {wander:2} {name}: coverage {100.0 * np.mean(np.abs(scores) < 1.96):.1f} %, "
            f"each {numbers(np.mean(np.abs(scores) < 1.96, axis=0))}, "
            f"RMS of error over standard error {numbers(np.sqrt(np.mean(scores**2, axis=0)))}, "
            f"RMS error over that of off {numbers(rms / of_off)}; "
            f"density over the true one {np.mean(found):.3g} (median {np.median(found):.3g}); "
            f"random force at 1 %: {100.0 * np.mean(p_values < 0.01):.1f} %; {taken:.2f} s each"
        )
    return lines


if __name__ == "__main__":
    for wander in WANDERS:
        print(*study(wander, int(sys.argv[1]) if len(sys.argv) > 1 else 40), sep="\n", flush=True)
