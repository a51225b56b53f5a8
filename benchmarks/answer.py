"""The answer of `identify` on measured records: what it predicts of what it has not seen, beside all others.

python -m benchmarks answer [--only WORD] [--time]

Trained on the first two thirds of a record, or on another run; of the rest only the start and the sensor's
zero are fitted. Each method with the sensor's noise alone and with a random force, with the same forces and
the same signs; the answer is the one that the program stands by. Then its coefficients on the whole record,
with total errors: no dissipative force may be negative by more than two of them. Records are read from
../shared/data, or SYSID_TRIB_DATA.

With --time: processor time of identify, which holds two methods against each other, and of discover from
viscous friction and what the system holds, on whole records of 2 * 10^4 samples at most; and as it would be
where Direct of the paper's run takes 45 ms, by what it takes here before and after each.
"""

import warnings
from argparse import Namespace
from collections.abc import Iterator
from time import process_time

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks.measured import BOTH, records_folder, two_thirds
from benchmarks.stopwatch import median_ms, timed
from benchmarks.study.common import shown
from sysid_trib import load_library
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.selection import load_system
from sysid_trib.methods.scope import with_random_force
from sysid_trib.simulation.simulate import paper_twin
from sysid_trib.validation.answer import better_of, identifications
from sysid_trib.validation.residuals import fitted_motion

TANK = "lambda zeta delta nu epsilon"
# Title, file, columns, window, system, forces, file of another run that is predicted.
HIGH, ALL = "string_pendulum/run_high.txt", (None, None)
RECORDS = (
    ("steel pendulum", "single_pendulum/free_swing.csv", {}, (15.0, 75.0), "pendulum", "", ""),
    ("string, low", "string_pendulum/run_1.txt", {}, ALL, "pendulum", "", HIGH),
    ("string, high", HIGH, {}, ALL, "pendulum", "", ""),
    ("ship", "roll_decay/model_test_21337.csv", {"angle": "phi"}, (25.0, None), "ship", "", ""),
    ("tank, 0.953", "sloshing/decay_0p953.csv", {}, ALL, "", TANK, "sloshing/decay_0p967.csv"),
    ("tank, 0.967", "sloshing/decay_0p967.csv", {}, ALL, "", TANK, ""),
)


def methods_of(system: str, forces: str) -> tuple[st.forces.ForceLibrary, dict[str, st.methods.MethodScope]]:
    """The forces, and the methods with what the system holds and the signs that it fixes."""
    moving = load_system(system or None)
    library = BOTH.select(forces.split() or moving.symbols)
    constraints = {**moving.bounds(library.symbols), **moving.held}
    kinds = (st.methods.Averaging, st.methods.Direct, st.methods.Trajectory)
    return library, {kind.__name__.lower(): kind(constraints=constraints) for kind in kinds}


def rest_of(result: xr.Dataset, decay: xr.Dataset) -> float:
    """RMS of record minus model, start and zero fitted."""
    motion = fitted_motion(decay, result.drop_vars(["start_angle", "start_rate"], errors="ignore"))
    if motion is None:
        return np.inf
    return float(np.sqrt(np.mean((decay.angle.values - motion.offset - motion.x) ** 2)))


def tried(method, decay: xr.Dataset, library: st.forces.ForceLibrary) -> xr.Dataset | None:
    """An identification, or none where it fails."""
    try:
        return method.identify(decay, library)
    except (SysidTribError, np.linalg.LinAlgError):
        return None


def row(train: xr.Dataset, unseen: xr.Dataset, library: st.forces.ForceLibrary, methods: dict) -> list[str]:
    """The answer's prediction, that of each method and noise, and what the answer takes."""
    began = process_time()
    pair = identifications(train, library, [methods["averaging"], methods["direct"]])
    at, seconds = better_of(*pair), process_time() - began
    answer, others = rest_of(pair[at], unseen), []
    for method in methods.values():
        for option in ("off", "estimated"):
            result = tried(with_random_force(method, option), train, library)
            others.append(np.inf if result is None else rest_of(result, unseen))
    ratio = answer / min(answer, *others)
    cells = [f"{value:.4g}" for value in others]
    return [("averaging", "direct")[at], f"{answer:.4g}", f"{ratio:.2f}", *cells, f"{seconds:.1f}"]


def signs(result: xr.Dataset) -> str:
    """The least coefficient of a dissipative force over its error."""
    each = zip(result.force.values, result.coefficient.values, result.standard_error.values, strict=True)
    return ", ".join(f"{s} {c:.3g} ± {e:.1g}" for s, c, e in each)


def direct_ms() -> float:
    """Processor time of Direct on the paper's run, ms: how fast the machine is just now."""
    record, library = paper_twin(seed=0), load_library().select(TANK.split())
    return median_ms(lambda: st.methods.Direct().identify(record, library), 5, process_time)


def spent(decay: xr.Dataset, system: str, forces: str) -> list[str]:
    """Processor time of `identify` and `discover`, s, and as it would be on the machine of the bar."""
    moving = load_system(system or None)
    library, methods = methods_of(system, forces)
    start = BOTH.select(["zeta", *moving.held])
    others = BOTH.select(s for s in BOTH.symbols if s not in (*start.symbols, *moving.impossible))

    def identify() -> None:
        st.cross_check(decay, *identifications(decay, library, [methods["averaging"], methods["direct"]]))

    def discover() -> None:
        st.discover(decay, start, others, constraints=dict(moving.held))

    cells = []
    for call in (identify, discover):
        before, seconds, after = direct_ms(), timed(call, process_time)[1], direct_ms()
        cells += [f"{seconds:.1f}", f"{seconds * 90.0 / (before + after):.1f}"]
    return cells


def times_rows(records) -> Iterator[list[str]]:
    """Of each record what `spent` says."""
    for title, file, columns, window, system, forces, _ in records:
        decay = st.free_decay(st.read_record(records_folder() / file, **columns), window=window)
        decay = decay.isel(time=slice(None, None, -(-decay.sizes["time"] // 20_000)))
        yield [title, f"{decay.sizes['time']:,}", *spent(decay, system, forces)]


def predicted(records) -> Iterator[list[str]]:
    """Of each record what `row` says, of another run of it too; its answer on the whole is printed."""
    for title, file, columns, window, system, forces, other in records:
        decay = st.free_decay(st.read_record(records_folder() / file, **columns), window=window)
        library, methods = methods_of(system, forces)
        yield [title, *row(*two_thirds(decay), library, methods)]
        if other:
            unseen = st.free_decay(st.read_record(records_folder() / other, **columns))
            yield [f"{title}: another run", *row(decay, unseen, library, methods)]
        pair = identifications(decay, library, [methods["averaging"], methods["direct"]])
        print(f"{title}, whole: {signs(pair[better_of(*pair)])}", flush=True)


def main(asked: Namespace) -> None:
    warnings.simplefilter("ignore")
    records = [record for record in RECORDS if asked.only in record[0]]
    if asked.time:
        heads = ("record", "samples", "identify (s)", "at 45 ms", "discover (s)", "at 45 ms")
        return shown("", heads, times_rows(records))
    kinds = ("averaging", "direct", "trajectory")
    labels = [f"{name} {option}" for name in kinds for option in ("off", "random")]
    heads = ("record", "answer", "its RMS", "over the best", *labels, "processor (s)")
    return shown("", heads, predicted(records), 220)
