"""How well a random force is identified: coverage and errors on pushed motions, false ones on others.

Twenty periods at w = 8.87 rad/s in noise of 0.2 mrad, pushed until they have wandered at the end by so many
noise levels. Methods are direct, trajectory, averaging (of motions at 60 samples a period, where it is used),
and each without a random force (-off): with these in the file too, a second table has the errors where
nothing pushes over those without.
"""

from argparse import Namespace
from time import process_time

import numpy as np
from helpers import rms

import sysid_trib as st
from benchmarks.stopwatch import timed
from benchmarks.study.common import METHODS, NOISE, Pushed, W, gone_on, read, scores, shown
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.random_force import random_force_of

CASES = [
    Pushed(wander, friction, per_period, start)
    for per_period in (20, 200)
    for wander in (1, 5, 20)
    for friction, start in ((0.0, 0.3), (1e-3, 0.3), (1e-3, 0.06))
]
FREE = [Pushed(0, noise=noise) for noise in ("white", "AR(0.8)", "rounded")]
FOR_AVERAGING = [Pushed(0), Pushed(5), Pushed(20)]
AVERAGING = {
    f"averaging{given}{off}": st.methods.Averaging(reference_frequency=w, random_force=option)
    for given, w in (("", None), (", w given", W))
    for off, option in (("", "estimated"), ("-off", "off"))
}
# Cases with the same kicks and noise would err alike, and a pooled figure rest on few of them.
SEEDS_OF_A_CASE = 10_000
HEADS = (
    *("wander, friction, samples a period, noise", "records", "failed", "covered (%)"),
    *("worst (binomial errors off)", "RMS error / stated", "/ bound", "worst / bound"),
    *("density / true", "told at 1 % (%)", "noise / true", "time (s)"),
)


def identified(case: Pushed, decay, method) -> dict[str, object]:
    """What the file says of one record."""
    truth = case.model.coefficients
    try:
        result, seconds = timed(lambda: st.identify(decay, case.model.library, method), process_time)
    except SysidTribError as error:
        return {"failed": str(error)}
    force = random_force_of(result)
    (errors,), (stated,) = scores([result], truth, W)
    known = stated > 0.0
    return {
        "names": [name for name, yes in zip([*truth, "w"], known, strict=True) if yes],
        "errors": errors[known].tolist(),
        "standard_errors": stated[known].tolist(),
        "density": force.density,
        "p_value": force.p_value if force else 1.0,
        "noise": float(result.noise),
        "seconds": seconds,
    }


def row_of(case: Pushed, rows: list[dict]) -> list[str]:
    """A case in the table."""
    found = [row for row in rows if "failed" not in row]
    counts = [case.title, str(len(rows)), str(len(rows) - len(found))]
    if not found:
        return counts
    told = 100.0 * np.mean([row["p_value"] < 0.01 for row in found])
    ends = [
        f"{told:.1f}",
        f"{np.mean([row['noise'] for row in found]) / NOISE:.3f}",
        f"{np.mean([row['seconds'] for row in found]):.2f}",
    ]
    if not case.wander:
        return [*counts, *[""] * 6, *ends]
    errors, stated = (np.array([row[key] for row in found]) for key in ("errors", "standard_errors"))
    inside, names = np.abs(errors) < 1.96 * stated, np.array(found[0]["names"])
    deviation = (inside.mean(axis=0) - 0.95) / np.sqrt(0.95 * 0.05 / len(found))
    worst = int(np.argmax(np.abs(deviation)))
    ratio = rms(errors) / case.bound()[: errors.shape[1]]
    most = int(np.argmax(ratio))
    return [
        *counts,
        f"{100.0 * np.mean(inside):.1f}",
        f"{100.0 * inside.mean(axis=0)[worst]:.1f} {names[worst]} ({deviation[worst]:+.1f})",
        f"{rms(errors / stated, None):.2f}",
        f"{rms(ratio):.2f}",
        f"{ratio[most]:.2f} {names[most]}",
        f"{np.mean([row['density'] for row in found]) / case.density:.2f}",
        *ends,
    ]


def pooled(rows: list[dict]) -> str:
    """Coverage of all pushed records, and of those that go on and those that stop."""
    parts = []
    for title, stops in (("all", (True, False)), ("to its stop", (True,)), ("going on", (False,))):
        inside = [
            np.mean(np.abs(np.array(row["errors"])) < 1.96 * np.array(row["standard_errors"]))
            for row in rows
            if "errors" in row and not row["case"].startswith("wander 0") and ("stop" in row["case"]) in stops
        ]
        if inside:
            error = np.std(inside) / np.sqrt(len(inside))
            parts.append(f"{title} {100.0 * np.mean(inside):.1f} ± {100.0 * error:.1f} % of {len(inside)}")
    return "covered: " + "; ".join(parts) if parts else ""


def over_off(method: str, rows: list[dict], free: list[Pushed]) -> list[list[str]]:
    """RMS errors over those of the same method without a random force, of records that nothing pushes."""
    table = []
    for case in free:
        auto, off = (
            {
                row["seed"]: row["errors"]
                for row in rows
                if (row["case"], row["method"]) == (case.title, name) and "errors" in row
            }
            for name in (method, f"{method}-off")
        )
        if both := sorted(auto.keys() & off.keys()):
            ratio = rms([auto[seed] for seed in both]) / rms([off[seed] for seed in both])
            table.append([case.noise, str(len(both)), f"{rms(ratio):.3f}", f"{ratio.max():.3f}"])
    return table


def main(asked: Namespace) -> None:
    name = asked.method or "trajectory"
    method = {**METHODS, **AVERAGING}[name]
    cases = FOR_AVERAGING if name.startswith("averaging") else [*CASES, *FREE]
    rows, table = [], []
    for at, case in enumerate(cases):
        if asked.only not in case.title:
            continue
        first = SEEDS_OF_A_CASE * (1 + at) if case.wander else 0

        def make(seeds: list[int], case=case, first=first):
            for decay in case.records([first + seed for seed in seeds]):
                yield identified(case, decay, method)

        of_case = gone_on(asked.out, asked.seeds, make, case=case.title, method=name)
        table.append(row_of(case, of_case))
        rows += of_case
    shown(f"{name}: coverage of 95 % intervals, errors over the Cramér-Rao bound", HEADS, table, 200)
    print(pooled(rows))
    heads = ("noise", "records", "RMS error / off", "worst")
    free = [case for case in cases if not case.wander]
    shown(f"{name}: where nothing pushes", heads, over_off(name, read(asked.out), free))
