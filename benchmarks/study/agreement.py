"""How often pairs of runs of one motion that is pushed at random are said to disagree: 0.3 to 3 % at 1 %.

Two runs of 20 periods from 0.3 and 0.25 rad, 60 samples a period, sensor noise of 2e-4 rad, a random force
that lets the angle wander by five noise levels. --unlike multiplies the density of the second run: what the
test of the size of the random force then finds.
"""

from argparse import Namespace

import numpy as np
from scipy.stats import binomtest

from benchmarks.study.common import METHODS, Pushed, gone_on, uniform
from sysid_trib import identify
from sysid_trib.errors import SysidTribError
from sysid_trib.validation import run_agreement

RUNS = (Pushed(5.0), Pushed(5.0, start=0.25))
LEVEL = 0.01


def tested(decays, method) -> dict[str, object]:
    """What the agreement of a pair says."""
    try:
        runs = run_agreement(decays, identify(decays, RUNS[0].model.library, method))
    except SysidTribError as error:
        return {"failed": str(error)}
    return {
        "verdict": runs.attrs["verdict"],
        "p_value": runs.total_p_value.item(),
        "density_verdict": runs.attrs.get("density_verdict", "none"),
        "density_p_value": runs.density_p_value.item() if "density_p_value" in runs else None,
    }


def main(asked: Namespace) -> None:
    name = asked.method or "direct"

    def make(pairs: list[int]):
        of_runs = [
            run.records([2 * pair + at for pair in pairs], stream=(3,), times=asked.unlike if at else 1.0)
            for at, run in enumerate(RUNS)
        ]
        return (tested(list(decays), METHODS[name]) for decays in zip(*of_runs, strict=True))

    rows = gone_on(asked.out, asked.seeds, make, method=name, unlike=f"{asked.unlike:g}")
    print(f"{len(rows)} pairs, {sum('failed' in row for row in rows)} failed")
    for key, title in (("p_value", "forces"), ("density_p_value", "size of the random force")):
        values = np.array([row[key] for row in rows if row.get(key) is not None], dtype=float)
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        rejected = int(np.sum(known < LEVEL))
        low, high = (100.0 * end for end in binomtest(rejected, len(known)).proportion_ci())
        print(
            f"{title}: {rejected} of {len(known)} disagree at 1 %: {100.0 * rejected / len(known):.2f} % "
            f"({low:.2f} to {high:.2f}); at 5 %: {100.0 * np.mean(known < 0.05):.1f} %; p-values uniform by "
            f"Kolmogorov and Smirnov: {uniform(known):.2g}"
        )
