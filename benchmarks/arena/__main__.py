"""Every method on the same records, failures too: python -m benchmarks.arena [--seeds N] [--only WORDS].

Simulated runs (w = 9.91 rad/s, 25 s at 100 Hz, white noise of 1e-4 rad): RMS error over the Cramér-Rao bound,
the worst coefficient's in brackets, how often 95 % intervals cover, time over Direct's. Measured ones: RMS of
what was held out, the start fitted anew; those in ../shared/data or the folder in SYSID_TRIB_DATA.
"""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]
from helpers import NOISE, SIX, Run, W, decay, paper_run, rms  # noqa: E402

import sysid_trib as st  # noqa: E402
from benchmarks import driven, measured, peers  # noqa: E402
from benchmarks.arena.adapters import DECAY_PEERS, Answer, narmax, sysidentpy_is_there  # noqa: E402
from benchmarks.stopwatch import timed  # noqa: E402
from sysid_trib.forces import ForceLibrary  # noqa: E402
from sysid_trib.likelihood.pysindy_features import ForceFeatures  # noqa: E402
from sysid_trib.motion_fit.cramer_rao import cramer_rao_bound  # noqa: E402

# A plain shooting takes minutes a record.
FEW_SEEDS, IS_SLOW = 2, "scipy shooting, from SINDy"
RUNS = {
    "the paper's run": paper_run(),
    "strong friction, lambda = 1e-3, 14 s": paper_run(SIX | {"lambda": 1e-3}, duration=14.0),
}
OURS = {"Direct": st.methods.Direct(W), "Trajectory": st.methods.Trajectory(W)}


def ours(method, library: ForceLibrary, w: float, time: np.ndarray, angle: np.ndarray) -> Answer:
    """A method of the package, with the noise that it decides for."""
    result = st.identify(decay(time, angle), library, method)
    return result.coefficient.values, result.standard_error.values


def simulated(title: str, run: Run, seeds: int) -> Table:
    """Each method on the same noisy records of one run."""
    truth, w = run.model.coefficients, run.model.reference_frequency
    library = run.model.library.select(truth)
    bound = cramer_rao_bound(run.model, run.time, run.start, 0.0, NOISE, free=False).standard_error.values
    table = Table("method", "seeds", "RMSE / bound (worst)", "95 % cover", "time / Direct", title=title)
    methods = {name: partial(ours, method) for name, method in OURS.items()} | DECAY_PEERS
    reference = np.nan
    for name, method in methods.items():
        count = min(seeds, FEW_SEEDS) if name == IS_SLOW else seeds
        errors, stated, spent, failed = [], [], [], ""
        for seed in range(count):
            angle = decay(run.time, run.angle, seed).angle.values
            try:
                call = partial(method, library, w, run.time, angle)
                (values, error), seconds = timed(call)
            except Exception as problem:
                failed = f"{type(problem).__name__}: {problem}"[:60]
                break
            errors.append(values - list(truth.values()))
            stated.append(error)
            spent.append(seconds)
        if failed:
            table.add_row(name, str(count), failed, "", "")
            continue
        reference = float(np.median(spent)) if name == "Direct" else reference
        ratio = rms(np.array(errors)) / bound
        symbol = list(truth)[int(np.argmax(ratio))]
        covered = np.mean(np.abs(errors) < 1.96 * np.array(stated))
        cover = f"{100 * covered:.0f} %" if np.isfinite(stated).all() else "none stated"
        cells = [f"{np.sqrt(np.mean(ratio**2)):.3g} ({symbol} {ratio.max():.3g})", cover]
        table.add_row(name, str(count), *cells, f"{np.median(spent) / reference:.2g}")
    return table


def held_out_decay() -> Table:
    """The ship's roll: two thirds fitted by delta, zeta and epsilon, the last predicted."""
    record = next(r for r in measured.RECORDS if "ship" in r.title)
    whole = record.decay()
    t, angle = whole.time.values, whole.angle.values
    split = int(np.searchsorted(t, t[0] + (t[-1] - t[0]) * 2 / 3, side="right"))
    train = whole.isel(time=slice(split))
    forces = "zeta delta epsilon"
    w = st.methods.Direct().identify(train, measured.SIX.select(["zeta"])).reference_frequency.item()
    contestants: dict[str, Callable] = {
        name: partial(measured.ours, method, forces)
        for name, method in (("Direct", st.methods.Direct()), ("Trajectory", st.methods.Trajectory()))
    }
    for name, peer in DECAY_PEERS.items():

        def call(library, w, time, values, peer=peer):
            return peer(library, w, time, values)[0]

        if name != IS_SLOW:
            contestants[name] = partial(measured.pysindy, call, forces, w)
    table = Table("method", "trained, RMS (mrad)", "held out", title=f"{record.title}: {forces} and w")
    for name, contestant in contestants.items():
        try:
            model, _ = contestant(train)
            parts = (slice(split), slice(split, None))
            cells = [f"{measured.residual_rms(model, t[p], angle[p], t[p][0] - t[0]):.2f}" for p in parts]
        except Exception as problem:
            cells = [f"{type(problem).__name__}: {problem}"[:60], ""]
        table.add_row(name, *cells)
    return table


def pysindy_driven(library: ForceLibrary, record, w: float) -> np.ndarray:
    """Coefficients by `pysindy.SINDy` on local polynomials with u=; stiffness is among the unknowns."""
    import pysindy

    time, signal = record.time.values, record.angle.values
    # The shortest that its order allows: a period has nine samples.
    window = (peers.ORDER + 2) * (time[1] - time[0])
    x, rate, acceleration = peers.savitzky_golay(time, signal, window)
    features = ForceFeatures(library, reference_frequency=w)
    model = pysindy.SINDy(feature_library=features, optimizer=peers.plain_optimizer())
    target = (acceleration / w**2 + x)[:, None]
    model.fit(
        np.column_stack([x, rate / w]), t=time[1] - time[0], x_dot=target, u=record["u"].values[:, None]
    )
    return -model.coefficients()[0]


def silverbox() -> Table:
    """Five realisations trained, the free run of the sixth."""
    record = st.read_record(driven.DATA / "silverbox" / "multisine_1_to_6.csv", input="V1")
    split = driven.TRAINING
    train, test = record.isel(time=slice(split)), record.isel(time=slice(split, None))
    table = Table("method", "last realisation, RMS (mV)", "processor (s)", title="Silverbox: 5 parameters")
    forces = driven.offered(*driven.FIVE)
    direct, seconds = driven.cpu(lambda: st.methods.Direct(random_force="off").identify(train, forces))
    table.add_row("Direct", f"{1e3 * st.predict(direct, test).residual_rms.item():.3f}", f"{seconds:.0f}")
    w = direct.reference_frequency.item()
    try:
        library = driven.offered("alpha", *driven.FIVE)
        values, seconds = driven.cpu(lambda: pysindy_driven(library, train, w))
        # A result with these coefficients in the place of ours: predicted alike.
        its = st.methods.Direct(w, random_force="off").identify(train, library)
        left = 1e3 * st.predict(its.assign(coefficient=("force", values)), test).residual_rms.item()
        table.add_row("pysindy.SINDy, Savitzky-Golay", f"{left:.3f}", f"{seconds:.0f}")
    except Exception as problem:
        table.add_row("pysindy.SINDy, Savitzky-Golay", f"{type(problem).__name__}: {problem}"[:60], "")
    if sysidentpy_is_there():
        values = [record[name].values for name in ("u", "angle")]
        left, seconds = driven.cpu(lambda: narmax(*values, split))
        table.add_row("SysIdentPy, NARMAX by FROLS", f"{1e3 * left:.3f}", f"{seconds:.0f}")
    else:
        table.add_row("SysIdentPy, NARMAX by FROLS", "not installed", "")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="", metavar="WORDS", help="records whose title holds these words")
    options = parser.parse_args()
    records: dict[str, Callable[[], Table]] = {
        title: partial(simulated, title, run, options.seeds) for title, run in RUNS.items()
    }
    if driven.DATA.is_dir():
        records |= {"rolling ship": held_out_decay, "Silverbox": silverbox, "EMPS": driven.emps}
    for title, table in records.items():
        if options.only.lower() in title.lower():
            Console(width=120).print(table())


if __name__ == "__main__":
    main()
