"""How often pairs of runs of one motion that is pushed at random are said to disagree: 0.3 to 3 % at 1 %.

python benchmarks/agreement_of_runs.py [--pairs N] [--out FILE] [--method direct|trajectory] [--unlike RATIO]

Two runs of 20 periods from 0.3 and 0.25 rad, 60 samples a period, sensor noise of 2e-4 rad, a random force
that lets the angle wander by five noise levels. The motions are those of tests/kicked_motion.py, which shares
nothing with the package. With --out each pair is a JSON line, and what the file has already is not repeated.
--unlike multiplies the density of the second run: what the test of the size of the random force then finds.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import binomtest, kstest

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from kicked_motion import kicked_motion, smooth_forces  # noqa: E402

from sysid_trib import identify, load_library, run_agreement  # noqa: E402
from sysid_trib.errors import SysidTribError  # noqa: E402
from sysid_trib.likelihood.random_force import RandomForce  # noqa: E402
from sysid_trib.methods import Direct, Trajectory  # noqa: E402

W, NOISE, WANDER, PERIODS, PER_PERIOD = 8.87, 2e-4, 5.0, 20, 60
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
STARTS = (0.3, 0.25)
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
DENSITY = RandomForce.density_of(2.0 * (WANDER * NOISE) ** 2 / (W * TIME[-1]), W)
METHODS = {"direct": Direct(random_force="estimated"), "trajectory": Trajectory(random_force="estimated")}
LEVEL = 0.01
AT_ONCE = 50


def records(pairs: Sequence[int], unlike: float) -> list[list[xr.Dataset]]:
    """Both runs of each pair."""
    force, of_runs = smooth_forces(TRUTH), []
    for run, start in enumerate(STARTS):
        seeds = [2 * pair + run for pair in pairs]
        density = DENSITY * (unlike if run else 1.0)
        angle, _ = kicked_motion(TIME, W, force, 0.0, density, seeds, start=(start, 0.0))
        noise = [NOISE * np.random.default_rng([seed, 3]).standard_normal(len(TIME)) for seed in seeds]
        of_runs.append([xr.Dataset({"angle": ("time", a)}, {"time": TIME}) for a in angle + np.array(noise)])
    return [list(pair) for pair in zip(*of_runs, strict=True)]


def tested(pair: int, decays: list[xr.Dataset], method: Any) -> dict[str, Any]:
    """What the agreement of a pair says."""
    library = load_library("contact_forces").select(TRUTH)
    try:
        runs = run_agreement(decays, identify(decays, library, method))
    except SysidTribError as error:
        return {"pair": pair, "failed": str(error)}
    return {
        "pair": pair,
        "verdict": runs.attrs["verdict"],
        "p_value": runs.total_p_value.item(),
        "density_verdict": runs.attrs.get("density_verdict", "none"),
        "density_p_value": runs.density_p_value.item() if "density_p_value" in runs else None,
    }


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Part of the pairs in which each test rejects, with its 95 % interval."""
    failed = sum("failed" in row for row in rows)
    lines = [f"{len(rows)} pairs, {failed} failed"]
    for name, title in (("p_value", "forces"), ("density_p_value", "size of the random force")):
        values = np.array([row[name] for row in rows if row.get(name) is not None], dtype=float)
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        rejected = int(np.sum(known < LEVEL))
        low, high = binomtest(rejected, len(known)).proportion_ci()
        five = 100.0 * np.mean(known < 0.05)
        lines.append(
            f"{title}: {rejected} of {len(known)} disagree at 1 %: {100.0 * rejected / len(known):.2f} % "
            f"({100.0 * low:.2f} to {100.0 * high:.2f}); at 5 %: {five:.1f} %; "
            f"p-values uniform by Kolmogorov and Smirnov: {kstest(known, 'uniform').pvalue:.2g}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--method", choices=tuple(METHODS), default="direct")
    parser.add_argument("--unlike", type=float, default=1.0)
    asked = parser.parse_args()
    rows = []
    if asked.out and asked.out.exists():
        rows = [json.loads(line) for line in asked.out.read_text(encoding="utf-8").splitlines()]
    done = {row["pair"] for row in rows}
    left = [pair for pair in range(asked.pairs) if pair not in done]
    for first in range(0, len(left), AT_ONCE):
        batch = left[first : first + AT_ONCE]
        for pair, decays in zip(batch, records(batch, asked.unlike), strict=True):
            rows.append(tested(pair, decays, METHODS[asked.method]))
            if asked.out:
                with asked.out.open("a", encoding="utf-8") as lines:
                    lines.write(json.dumps(rows[-1]) + "\n")
    print(summary(rows))


if __name__ == "__main__":
    main()
