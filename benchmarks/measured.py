"""Measured free decays: fitted on two thirds, predicted on the last, beside pysindy on the same split.

python -m benchmarks measured [--only WORDS]

On the last third only the start of the motion and the zero of the sensor are fitted anew. Of the steel
pendulum every tenth sample is used; its encoder's step is 0.16 mrad, the ship's 0.09 mrad. The records are
read from ../shared/data beside the project, or from the folder in SYSID_TRIB_DATA.
"""

import sys
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline

import sysid_trib as st
from benchmarks import DATA, peers
from benchmarks.study.common import shown, timed
from sysid_trib import Model, free_decay, load_library, read_record
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.systems import load_system
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.methods.options import with_random_force
from sysid_trib.physics import model_of
from sysid_trib.simulation.initial_conditions import first_guess, fit_start
from sysid_trib.validation import cross_check, verdict
from sysid_trib.validation.residuals import fitted_motion

SIX = load_library()
BOTH = replace(SIX, forces=(*SIX.forces, *load_library("candidate_effects").forces))
# The frequency for which the windows of the peers were tuned; time is scaled to it.
TUNED = 9.91
# At longer steps (s) the polynomials of the peers' windows have more coefficients than samples.
STEP = 0.01
# Savitzky-Golay windows (s) that are tried: noise differs from record to record.
WINDOWS = (0.15, 0.25, 0.4, 0.6)
# Nothing but gravity restores a pendulum: its coefficient is one, not fitted.
HELD = {"gravity": (1 - 1e-6, 1 + 1e-6)}
# First guesses of shapes; those of every force of a model are fitted.
GUESSES = {"dahl.s": 0.004, "ambient.W": 7.9, "ambient.p": -0.2, "maxwell.s": 1.0}


@dataclass(frozen=True)
class Record:
    """A file, how it is read, and the models that its physics suggests, one a line."""

    title: str
    file: str
    columns: dict[str, str]
    window: tuple[float | None, float | None]
    stride: int
    models: str

    def decay(self) -> xr.Dataset:
        """The free decay, every so many samples."""
        read = read_record(records_folder() / self.file, **self.columns)
        return free_decay(read, window=self.window).isel(time=slice(None, None, self.stride))


SWING = """lambda delta gravity
lambda zeta delta gravity
lambda zeta delta gravity detent
zeta delta gravity dahl
lambda zeta delta gravity detent sensor_curve ambient"""
FILMED = """zeta delta gravity
zeta delta gravity nu
zeta delta gravity nu sensor_curve
zeta delta gravity nu sensor_curve sensor_cubic shutter
zeta delta gravity nu sensor_curve sensor_cubic shutter even_drag
zeta delta gravity nu sensor_curve sensor_cubic tilted_damping even_drag"""
ROLL = """delta epsilon
zeta cubic_damping epsilon
zeta delta epsilon maxwell
zeta cubic_damping epsilon maxwell
delta cubic_damping epsilon quintic maxwell"""
RECORDS = (
    Record("Steel pendulum, 15 to 75 s", "single_pendulum/free_swing.csv", {}, (15.0, 75.0), 10, SWING),
    Record("Bob on a string, filmed", "string_pendulum/run_1.txt", {}, (None, None), 1, FILMED),
    Record("Rolling ship model", "roll_decay/model_test_21337.csv", {"angle": "phi"}, (25.0, None), 1, ROLL),
)


def records_folder() -> Path:
    """Folder of the measured records."""
    if not DATA.is_dir():
        sys.exit(f"There are no measured records in {DATA}; set SYSID_TRIB_DATA to their folder.")
    return DATA


def two_thirds(decay: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """The first two thirds of a record, and the rest."""
    t = decay.time.values
    split = int(np.searchsorted(t, t[0] + (t[-1] - t[0]) * 2 / 3, side="right"))
    return decay.isel(time=slice(split)), decay.isel(time=slice(split, None))


def frequency_of(train: xr.Dataset) -> float:
    """Reference frequency by viscous friction alone, rad/s."""
    return float(Direct().identify(train, SIX.select(["zeta"])).reference_frequency)


def residuals(model: Model, decay: xr.Dataset) -> list[str]:
    """RMS of both parts of a record."""
    begin = float(decay.time[0])
    return [
        f"{residual_rms(model, p.time.values, p.angle.values, float(p.time[0]) - begin):.2f}"
        for p in two_thirds(decay)
    ]


def residual_rms(model: Model, time: np.ndarray, angle: np.ndarray, seconds: float) -> float:
    """RMS (mrad) of a model's motion `seconds` after the beginning of the decay, its start fitted."""
    shapes = dict(model.shapes)
    if "ambient" in model.coefficients:
        # The clock of the shaking runs on, while `t` counts from the first sample.
        shapes["ambient.p"] += shapes["ambient.W"] * seconds
    model = replace(model, shapes=shapes)
    motion = fit_start(model, time, angle, first_guess(time, angle, model.reference_frequency))
    return 1e3 * float(np.sqrt(np.mean((angle - motion.offset - motion.x) ** 2)))


def ours(method, forces: str, decay: xr.Dataset) -> tuple[Model, int]:
    """Model identified by a method, and how many numbers were fitted for it."""
    library = BOTH.select(forces.split())
    count = len(library) + sum(len(f.shape) for f in library) + 1 - ("gravity" in library.symbols)
    return model_of(method.identify(decay, library)), count


def physical(forces: str) -> Trajectory:
    """Trajectory fit of a model with all its shapes."""
    shapes = {f"{f.symbol}.{k}": s.default for f in BOTH.select(forces.split()) for k, s in f.shape.items()}
    shapes = {name: GUESSES.get(name, value) for name, value in shapes.items()}
    bounds = HELD if "gravity" in forces else {}
    return Trajectory(fit_shapes=tuple(shapes), shapes=shapes, constraints=bounds)


def pysindy(peer: Callable, forces: str, w: float, decay: xr.Dataset) -> tuple[Model, int]:
    """Model by pysindy, w being held and `alpha` unknown; coarse records are made denser by a spline."""
    library = BOTH.select(("alpha", *forces.split()))
    t, angle = decay.time.values * w / TUNED, decay.angle.values
    if peer is not peers.sindy:
        dense = np.arange(t[0], t[-1], min(STEP, np.median(np.diff(t))))
        t, angle = dense, CubicSpline(t, angle)(dense)
    values, _ = peer(library, TUNED, t, angle)
    return Model(library, dict(zip(library.symbols, values.tolist(), strict=True)), w), len(library)


def smoothed(forces: str, w: float, decay: xr.Dataset) -> tuple[Model, int]:
    """Model by `pysindy.SINDy` after the Savitzky-Golay window that follows the training part best."""
    tried = []
    for window in WINDOWS:
        derivatives = partial(peers.inner_savitzky_golay, window=window)
        fitted = pysindy(partial(peers.sindy, derivatives=derivatives), forces, w, decay)
        tried.append((residual_rms(fitted[0], decay.time.values, decay.angle.values, 0.0), fitted))
    return min(tried, key=lambda pair: pair[0])[1]


def contestants(record: Record, w: float) -> list[tuple[str, str, Callable]]:
    """Method, forces and what to call with the training decay."""
    six = " ".join(s for s in SIX.symbols if s != "alpha")
    rows: list[tuple[str, str, Callable]] = [
        (type(m).__name__, six, partial(ours, m, six)) for m in (Averaging(), Direct(), Trajectory())
    ]
    rows += [
        ("Trajectory", forces, partial(ours, physical(forces), forces))
        for forces in record.models.splitlines()
    ]
    # pysindy knows no states and no sensors: the second model has neither.
    for forces in (six, record.models.splitlines()[1]):
        asked = f"alpha {forces}"
        finite, weak = (partial(pysindy, peer, forces, w) for peer in (peers.sindy, peers.weak_sindy))
        rows.append(("pysindy SINDy, finite differences", asked, finite))
        rows.append(("pysindy SINDy, Savitzky-Golay", asked, partial(smoothed, forces, w)))
        rows.append(("pysindy WeakPDELibrary", asked, weak))
    return rows


def rows_of(record: Record, decay: xr.Dataset) -> Iterator[list[str]]:
    """Every method on one record."""
    train, _ = two_thirds(decay)
    for name, forces, identify in contestants(record, frequency_of(train)):
        try:
            (model, count), seconds = timed(partial(identify, train))
            yield [name, forces, str(count), *residuals(model, decay), f"{seconds:.2f}"]
        except SysidTribError as error:
            yield [name, forces, "", str(error)[:60], "", ""]


def measured(asked: Namespace) -> None:
    heads = ("method", "forces", "fitted", "train", "hold-out", "time (s)")
    for record in (record for record in RECORDS if asked.only.lower() in record.title.lower()):
        decay = record.decay()
        counts = " + ".join(str(part.sizes["time"]) for part in two_thirds(decay))
        shown(f"{record.title}: {counts} samples, RMS in mrad", heads, rows_of(record, decay))


TANK = "lambda zeta delta nu epsilon"
# Title, file, columns, window, system, forces, file of another run that is predicted.
HIGH, WHOLE = "string_pendulum/run_high.txt", (None, None)
ANSWERED = (
    ("steel pendulum", "single_pendulum/free_swing.csv", {}, (15.0, 75.0), "pendulum", "", ""),
    ("string, low", "string_pendulum/run_1.txt", {}, WHOLE, "pendulum", "", HIGH),
    ("string, high", HIGH, {}, WHOLE, "pendulum", "", ""),
    ("ship", "roll_decay/model_test_21337.csv", {"angle": "phi"}, (25.0, None), "ship", "", ""),
    ("tank, 0.953", "sloshing/decay_0p953.csv", {}, WHOLE, "", TANK, "sloshing/decay_0p967.csv"),
    ("tank, 0.967", "sloshing/decay_0p967.csv", {}, WHOLE, "", TANK, ""),
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


def row_of_answer(
    train: xr.Dataset, unseen: xr.Dataset, library: st.forces.ForceLibrary, methods: dict
) -> list[str]:
    """The answer's prediction, that of each method and noise, and what the answer takes."""
    began = process_time()
    pair = verdict.identifications(train, library, [methods["averaging"], methods["direct"]])
    at, seconds = cross_check.better_of(*pair), process_time() - began
    answer, others = rest_of(pair[at], unseen), []
    for method in methods.values():
        for option in ("off", "estimated"):
            others.append(np.inf)
            with suppress(SysidTribError, np.linalg.LinAlgError):
                others[-1] = rest_of(with_random_force(method, option).identify(train, library), unseen)
    ratio = answer / min(answer, *others)
    cells = [f"{value:.4g}" for value in others]
    return [("averaging", "direct")[at], f"{answer:.4g}", f"{ratio:.2f}", *cells, f"{seconds:.1f}"]


def predicted(records) -> Iterator[list[str]]:
    """Yield the rows of each record, and of another run of it; print the preferred method."""
    for title, file, columns, window, system, forces, other in records:
        decay = st.free_decay(st.read_record(records_folder() / file, **columns), window=window)
        library, methods = methods_of(system, forces)
        yield [title, *row_of_answer(*two_thirds(decay), library, methods)]
        if other:
            unseen = st.free_decay(st.read_record(records_folder() / other, **columns))
            yield [f"{title}: another run", *row_of_answer(decay, unseen, library, methods)]
        pair = verdict.identifications(decay, library, [methods["averaging"], methods["direct"]])
        result = pair[cross_check.better_of(*pair)]
        each = zip(result.force.values, result.coefficient.values, result.standard_error.values, strict=True)
        print(f"{title}, whole: {', '.join(f'{s} {c:.3g} ± {e:.1g}' for s, c, e in each)}", flush=True)


def answer(asked: Namespace) -> None:
    warnings.simplefilter("ignore")
    records = [record for record in ANSWERED if asked.only in record[0]]
    kinds = ("averaging", "direct", "trajectory")
    labels = [f"{name} {option}" for name in kinds for option in ("off", "random")]
    heads = ("record", "answer", "its RMS", "over the best", *labels, "processor (s)")
    shown("", heads, predicted(records), 220)
