"""Every method on the same records, failures too: python -m benchmarks arena [--seeds N] [--only WORDS].

Simulated runs (w = 9.91 rad/s, 25 s at 100 Hz, white noise of 1e-4 rad): RMS error over the Cramér-Rao bound,
the worst coefficient's in brackets, how often 95 % intervals cover, time over Direct's. Measured ones: RMS of
what was held out, the start fitted anew; those in ../shared/data or the folder in SYSID_TRIB_DATA.
"""

from argparse import Namespace
from collections.abc import Callable
from functools import partial

import numpy as np
from helpers import NOISE, Run, W, rms

import sysid_trib as st
from benchmarks import DATA, measured
from benchmarks.peers import DECAY_PEERS
from benchmarks.study.coefficients import DRY, PAPER, bound_of, identified
from benchmarks.study.common import columns, covered, over_seeds, shown

# A plain shooting takes minutes a record.
FEW_SEEDS, IS_SLOW = 2, "scipy shooting, from SINDy"
RUNS = {"the paper's run": PAPER, "strong friction, lambda = 1e-3, 14 s": DRY}
OURS = {"Direct": st.methods.Direct(W), "Trajectory": st.methods.Trajectory(W)}


def failed(problem: Exception) -> str:
    """Return the error of another method as text."""
    return f"{type(problem).__name__}: {problem}"[:60]


def simulated(asked: Namespace, title: str, runs: tuple[Run]) -> None:
    """Each method on the same noisy records of one run."""
    symbols, bound = list(runs[0].model.coefficients), bound_of(runs, (NOISE,))
    rows, reference = [], np.nan
    for name, method in (OURS | DECAY_PEERS).items():
        most = FEW_SEEDS if name == IS_SLOW else asked.seeds
        found = over_seeds(
            asked, partial(identified, method, runs, True), seeds=most, case=f"{title}, {name}"
        )
        if refused := [row["failed"] for row in found if "failed" in row]:
            rows.append([name, str(len(found)), refused[0], "", ""])
            continue
        errors, stated, spent = columns(found, "errors", "standard_errors", "seconds")
        reference = float(np.median(spent)) if name == "Direct" else reference
        ratio, inside = rms(errors) / bound, np.mean(covered(errors, stated))
        cover = f"{inside:.0f} %" if np.isfinite(stated).all() else "none stated"
        cells = [f"{rms(ratio):.3g} ({symbols[int(np.argmax(ratio))]} {ratio.max():.3g})", cover]
        rows.append([name, str(len(found)), *cells, f"{np.median(spent) / reference:.2g}"])
    heads = ("method", "seeds", "RMSE / bound (worst)", "95 % cover", "time / Direct")
    shown(title, heads, rows, 120)


def held_out_decay() -> None:
    """The ship's roll: two thirds fitted by delta, zeta and epsilon, the last predicted."""
    record = next(r for r in measured.RECORDS if "ship" in r.title)
    whole, forces, rows = record.decay(), "zeta delta epsilon", []
    train, _ = measured.two_thirds(whole)
    contestants: dict[str, Callable] = {
        name: partial(measured.ours, method, forces)
        for name, method in (("Direct", st.methods.Direct()), ("Trajectory", st.methods.Trajectory()))
    }
    for name, peer in DECAY_PEERS.items():
        if name != IS_SLOW:
            contestants[name] = partial(measured.pysindy, peer, forces, measured.frequency_of(train))
    for name, contestant in contestants.items():
        try:
            rows.append([name, *measured.residuals(contestant(train)[0], whole)])
        except Exception as problem:
            rows.append([name, failed(problem), ""])
    shown(f"{record.title}: {forces} and w", ("method", "trained, RMS (mrad)", "held out"), rows, 120)


def arena(asked: Namespace) -> None:
    for title, runs in RUNS.items():
        if asked.only.lower() in title.lower():
            simulated(asked, title, runs)
    if asked.only.lower() in "rolling ship" and DATA.is_dir():
        held_out_decay()
