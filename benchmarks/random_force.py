"""Coverage of 95 % intervals, and what is found of a random force, on simulated motions that are pushed.

python benchmarks/random_force.py [SEEDS]
"""

import sys
import time as clock

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import SysidTribError
from sysid_trib.noise.random_force import RandomForce, random_force_of

W, NOISE, PERIODS, ANGLE = 8.87, 2e-4, 20, 0.3
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
CASES = [(wander, friction, 20) for wander in (0, 1, 5, 20) for friction in (0.0, 1e-3)]
CASES += [(5, 0.0, 200), (5, 1e-3, 200)]


def study(wander: float, friction: float, per_period: int, seeds: int) -> str:
    """One line: coverage, RMS of error over standard error, density and p-value, time."""
    truth = ({"lambda": friction} if friction else {}) | TRUTH
    library = st.load_library("contact_forces").select(truth)
    time = np.arange(PERIODS * per_period) * 2.0 * np.pi / W / per_period
    # The wander at the end, RMS, is so many noise levels.
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * time[-1]), W)
    scores, densities, p_values, failed, taken = [], [], [], 0, 0.0
    for seed in range(seeds):
        angle = st.simulate(st.Model(library, truth, W), time, ANGLE, random_force=density, seed=seed).angle
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
        decay = xr.Dataset({"angle": angle + noise})
        start = clock.process_time()
        try:
            result = st.identify(decay, library, st.methods.Trajectory(random_force="auto"))
        except SysidTribError:
            failed += 1
            continue
        taken += clock.process_time() - start
        true = np.array([truth[s] for s in result.force.values])
        score = (result.coefficient.values - true) / result.standard_error.values
        frequency = (result.reference_frequency - W) / result.reference_frequency_standard_error
        scores.append([*score, frequency.item()])
        force = random_force_of(result)
        densities.append(force.density / density if density else force.density)
        p_values.append(force.p_value if force else 1.0)
    table = np.array(scores)
    covered = np.mean(np.abs(table) < 1.96)
    size = ", ".join(f"{value:.2f}" for value in np.sqrt(np.mean(table**2, axis=0)))
    told = 100.0 * np.mean(np.array(p_values) < 0.01)
    return (
        f"wander {wander:2} lambda {friction:g} {per_period:3} a period: coverage {100.0 * covered:.1f} %, "
        f"RMS of error over standard error {size}; density over the true one {np.mean(densities):.3g}; "
        f"random force at 1 %: {told:.1f} %; failed {failed} of {seeds}; {taken / len(table):.2f} s each"
    )


if __name__ == "__main__":
    for case in CASES:
        print(study(*case, int(sys.argv[1]) if len(sys.argv) > 1 else 100), flush=True)
