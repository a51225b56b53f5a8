"""Do widened errors of a model that lacks a force cover the coefficients of the forces that it has?

python benchmarks/widened_errors.py [SEEDS]

Motions of zeta, delta and epsilon beside one effect of the library that the model has not, drawn by the seed,
as strong as a third to three times the damping (dissipative) or the cubic force (conservative) at the start.
For each method and option of the random force: how often 95 % intervals cover the truth, by the errors
as they are stated and as `identify` prints them, of records whose residual is beyond 1.5 noise levels.
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import xarray as xr

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
import sysid_trib as st  # noqa: E402
from sysid_trib.averaging.signatures import averages  # noqa: E402
from sysid_trib.errors import SysidTribError  # noqa: E402
from sysid_trib.forces.force import ForceLibrary  # noqa: E402
from sysid_trib.noise.level import sensor_noise  # noqa: E402
from sysid_trib.validation.breakdown import no_nearer_than_rest, widening  # noqa: E402
from sysid_trib.validation.residuals import fitted_motion  # noqa: E402

W, NOISE, ANGLE, INTERVAL = 9.0, 2e-4, 0.6, 1.96
TRUTH = {"zeta": 5e-3, "delta": 1e-2, "epsilon": 0.2}
TIME = np.arange(0.0, 25.0, 0.02)
OFFERED = st.load_library("contact_forces").select(TRUTH)
EFFECTS = [
    force
    for force in st.load_library("candidate_effects")
    if force.memoryless
    and force.kind == "force"
    and not force.shape
    and not force.holds_time
    and force.parity == "odd"
]
# Residuals below so many noise levels are no case: the record is explained.
LEAST = 1.5


def record_of(seed: int) -> xr.Dataset:
    """A record with a force that is left out."""
    rng = np.random.default_rng(seed)
    effect = EFFECTS[rng.integers(len(EFFECTS))]
    sine, cosine = (float(part[0]) for part in averages(effect, np.array([ANGLE]), None, 0.0))
    beside = TRUTH["zeta"] * ANGLE if abs(sine) > abs(cosine) else 0.375 * TRUTH["epsilon"] * ANGLE**3
    size = beside / max(abs(sine), abs(cosine)) * np.exp(rng.uniform(-np.log(3.0), np.log(3.0)))
    coefficients = TRUTH | {effect.symbol: size * (1.0 if sine < 0.0 else rng.choice([-1.0, 1.0]))}
    model = st.Model(ForceLibrary("with one more", (*OFFERED, effect)), coefficients, W)
    angle = st.simulate(model, TIME, ANGLE).angle.values + NOISE * rng.standard_normal(len(TIME))
    return xr.Dataset({"angle": ("time", angle)}, {"time": TIME})


def main(seeds: int) -> None:
    """Print the coverage, method by method."""
    inside: dict[str, list[tuple[bool, bool]]] = defaultdict(list)
    failed: dict[str, int] = defaultdict(int)
    for seed in range(seeds):
        decay = record_of(seed)
        for kind in (st.methods.Averaging, st.methods.Direct):
            for option in ("off", "estimated"):
                label = f"{kind.__name__.lower()}, random force {option}"
                try:
                    result = kind(random_force=option).identify(decay, OFFERED)
                except SysidTribError:
                    failed[label] += 1
                    continue
                motion = fitted_motion(decay, result)
                residual = np.inf if motion is None else decay.angle.values - motion.offset - motion.x
                if motion is None or no_nearer_than_rest(decay.angle.values, residual):
                    failed[label] += 1
                    continue
                ratio = float(np.sqrt(np.mean(residual**2)) / sensor_noise(decay))
                if ratio > LEAST:
                    away = np.abs(result.coefficient.values - list(TRUTH.values()))
                    error = INTERVAL * result.standard_error.values
                    factor = widening(result, ratio)
                    inside[label] += zip(away <= error, away <= factor * error, strict=True)
    print(f"{'method':30}{'coefficients':>14}{'stated':>9}{'widened':>9}{'failed':>8}")
    for label, pairs in inside.items():
        stated, widened = 100.0 * np.mean(pairs, axis=0)
        print(f"{label:30}{len(pairs):14}{stated:8.1f}%{widened:8.1f}%{failed[label]:8}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
