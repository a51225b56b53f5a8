"""Every method on the same records, failures too: python -m benchmarks arena [--seeds N] [--only WORDS].

Simulated runs (w = 9.91 rad/s, 25 s at 100 Hz, white noise of 1e-4 rad): RMS error over the Cramér-Rao bound,
the worst coefficient's in brackets, how often 95 % intervals cover, time over Direct's. Measured ones: RMS of
what was held out, the start fitted anew; those in ../shared/data or the folder in SYSID_TRIB_DATA.
"""

from argparse import Namespace
from collections.abc import Callable
from functools import partial

import numpy as np
from helpers import NOISE, SIX, Run, W, decay, paper_run, rms

import sysid_trib as st
from benchmarks import driven, measured, peers
from benchmarks.arena_adapters import DECAY_PEERS, Answer, narmax
from benchmarks.stopwatch import timed
from benchmarks.study.common import shown
from sysid_trib.forces import ForceLibrary
from sysid_trib.likelihood.pysindy_features import ForceFeatures
from sysid_trib.motion_fit.least_squares import cramer_rao_bound

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


def failed(problem: Exception) -> str:
    """What a method of others broke with."""
    return f"{type(problem).__name__}: {problem}"[:60]


def simulated(title: str, run: Run, seeds: int) -> None:
    """Each method on the same noisy records of one run."""
    truth, w = run.model.coefficients, run.model.reference_frequency
    library, rows, reference = run.model.library.select(truth), [], np.nan
    bound = cramer_rao_bound(run.model, run.time, run.start, 0.0, NOISE, free=False).standard_error.values
    methods = {name: partial(ours, method) for name, method in OURS.items()} | DECAY_PEERS
    for name, method in methods.items():
        count = min(seeds, FEW_SEEDS) if name == IS_SLOW else seeds
        records = [decay(run.time, run.angle, seed).angle.values for seed in range(count)]
        try:
            found = [timed(partial(method, library, w, run.time, angle)) for angle in records]
        except Exception as problem:
            rows.append([name, str(count), failed(problem), "", ""])
            continue
        errors = np.array([values for (values, _), _ in found]) - list(truth.values())
        stated, spent = (np.array([of(pair) for pair in found]) for of in (lambda p: p[0][1], lambda p: p[1]))
        reference = float(np.median(spent)) if name == "Direct" else reference
        ratio = rms(errors) / bound
        symbol = list(truth)[int(np.argmax(ratio))]
        inside = np.mean(np.abs(errors) < 1.96 * stated)
        cover = f"{100 * inside:.0f} %" if np.isfinite(stated).all() else "none stated"
        cells = [f"{np.sqrt(np.mean(ratio**2)):.3g} ({symbol} {ratio.max():.3g})", cover]
        rows.append([name, str(count), *cells, f"{np.median(spent) / reference:.2g}"])
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

        def call(library, w, time, values, peer=peer):
            return peer(library, w, time, values)[0]

        if name != IS_SLOW:
            contestants[name] = partial(measured.pysindy, call, forces, measured.frequency_of(train))
    for name, contestant in contestants.items():
        try:
            rows.append([name, *measured.residuals(contestant(train)[0], whole)])
        except Exception as problem:
            rows.append([name, failed(problem), ""])
    shown(f"{record.title}: {forces} and w", ("method", "trained, RMS (mrad)", "held out"), rows, 120)


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


def silverbox() -> None:
    """Five realisations trained, the free run of the sixth."""
    train, test = driven.silverbox_parts()

    def direct():
        return st.methods.Direct(random_force="off").identify(train, driven.offered(*driven.FIVE))

    result, seconds = driven.cpu(direct)
    w = result.reference_frequency.item()
    rows = [["Direct", f"{1e3 * st.predict(result, test).residual_rms.item():.3f}", f"{seconds:.0f}"]]
    library = driven.offered("alpha", *driven.FIVE)

    def sindy() -> float:
        values = pysindy_driven(library, train, w)
        # A result with these coefficients in the place of ours: predicted alike.
        its = st.methods.Direct(w, random_force="off").identify(train, library)
        return st.predict(its.assign(coefficient=("force", values)), test).residual_rms.item()

    def frols() -> float:
        values = [np.concatenate([part[name].values for part in (train, test)]) for name in ("u", "angle")]
        return narmax(*values, driven.TRAINING)

    peers_of = {"pysindy.SINDy, Savitzky-Golay": sindy, "SysIdentPy, NARMAX by FROLS": frols}
    for name, peer in peers_of.items():
        try:
            left, seconds = driven.cpu(peer)
            rows.append([name, f"{1e3 * left:.3f}", f"{seconds:.0f}"])
        except Exception as problem:
            rows.append([name, failed(problem), ""])
    shown("Silverbox: 5 parameters", ("method", "last realisation, RMS (mV)", "processor (s)"), rows, 120)


def main(asked: Namespace) -> None:
    records: dict[str, Callable[[], None]] = {
        title: partial(simulated, title, run, asked.seeds) for title, run in RUNS.items()
    }
    if driven.DATA.is_dir():
        records |= {"rolling ship": held_out_decay, "Silverbox": silverbox, "EMPS": driven.emps}
    for title, table in records.items():
        if asked.only.lower() in title.lower():
            table()
