"""Measured free decays: fitted on the first two thirds, predicted on the last, beside pysindy on the same split.

python benchmarks/measured.py [--quick] [--only WORDS]

On the last third only the start of the motion and the zero of the sensor are fitted anew. The records are
read from ../shared/data beside the project, or from the folder in SYSID_TRIB_DATA.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).parent))
import peers  # noqa: E402

from sysid_trib import Model, free_decay, load_library, model_of, read_record  # noqa: E402
from sysid_trib.errors import SysidTribError  # noqa: E402
from sysid_trib.methods import Averaging, Direct, Trajectory  # noqa: E402
from sysid_trib.start import first_guess, fit_start  # noqa: E402

SIX = load_library()
BOTH = replace(SIX, forces=(*SIX.forces, *load_library("candidate_effects").forces))
# The frequency for which the windows of the peers were tuned; time is scaled to it.
TUNED = 9.91
# At longer steps (s) the polynomials of the peers' windows have more coefficients than samples.
STEP = 0.01
# Rounds in which the terms of the sensor settle.
TURNS = 5
# Nothing but gravity restores a pendulum: the coefficient is one, not fitted.
PENDULUM = {"gravity": (1 - 1e-6, 1 + 1e-6)}


@dataclass(frozen=True)
class Fitted:
    """A physical model: forces, first guesses of shapes to fit, bounds of coefficients."""

    forces: str
    shapes: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Record:
    """A file, how it is read, and the models that its physics suggests, each with what it adds."""

    title: str
    file: str
    window: tuple[float | None, float | None]
    columns: dict[str, str]
    stride: int
    models: tuple[Fitted, ...]


RECORDS = (
    Record(
        "Steel pendulum on a bearing, 15 to 75 s, every 10th sample",
        "single_pendulum/free_swing.csv",
        (15.0, 75.0),
        {},
        10,
        (
            Fitted("lambda delta gravity", bounds=PENDULUM),
            Fitted("lambda zeta delta gravity", bounds=PENDULUM),
            Fitted("lambda zeta delta gravity detent", bounds=PENDULUM),
            Fitted("zeta delta gravity dahl", {"dahl.s": 0.004}, PENDULUM),
            Fitted(
                "lambda zeta delta gravity detent sensor_curve ambient",
                {"ambient.W": 7.9, "ambient.p": 0.0},
                PENDULUM,
            ),
        ),
    ),
    Record(
        "Bob on a string, filmed",
        "string_pendulum/run_1.txt",
        (None, None),
        {},
        1,
        (
            Fitted("zeta delta gravity", bounds=PENDULUM),
            Fitted("zeta delta gravity nu", bounds=PENDULUM),
            Fitted("zeta delta gravity nu sensor_curve", bounds=PENDULUM),
            Fitted("zeta delta gravity nu sensor_curve sensor_cubic tilted_damping", bounds=PENDULUM),
            Fitted(
                "zeta delta gravity partial_slip sensor_curve sensor_cubic tilted_damping", bounds=PENDULUM
            ),
        ),
    ),
    Record(
        "Rolling ship model, from 25 s",
        "roll_decay/model_test_21337.csv",
        (25.0, None),
        {"angle": "phi"},
        1,
        (
            Fitted("delta epsilon"),
            Fitted("zeta cubic_damping epsilon"),
            Fitted("zeta delta epsilon maxwell", {"maxwell.s": 1.0}),
            Fitted("zeta cubic_damping epsilon maxwell", {"maxwell.s": 1.0}),
            Fitted("delta cubic_damping epsilon quintic maxwell", {"maxwell.s": 1.0}),
        ),
    ),
)


def records_folder() -> Path:
    """Folder of the measured records."""
    folder = Path(os.environ.get("SYSID_TRIB_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        sys.exit(f"There are no measured records in {folder}; set SYSID_TRIB_DATA to their folder.")
    return folder


def gap(model: Model, time: np.ndarray, angle: np.ndarray, seconds: float) -> float:
    """RMS (mrad) of a model's motion `seconds` after the beginning of the decay, its start fitted."""
    shapes = dict(model.shapes)
    if "ambient" in model.coefficients:
        # The clock of the shaking runs on, while `t` counts from the first sample.
        shapes["ambient.p"] += shapes["ambient.W"] * seconds
    model = replace(model, shapes=shapes)
    found = fit_start(model, time, angle, first_guess(time, angle, model.reference_frequency))
    return 1e3 * float(np.sqrt(np.mean((angle - found.offset - found.x) ** 2)))


def ours(method, decay: xr.Dataset, forces: tuple[str, ...]) -> tuple[Model, int]:
    """Model identified by a method, and how many numbers were fitted for it.

    The methods identify forces: terms of the sensor are fitted to what these leave, in turn with them.
    """
    sensors = [f for f in BOTH.select(forces) if f.kind == "sensor"]
    moving = BOTH.select(s for s in forces if s not in {f.symbol for f in sensors})
    t, angle, errors = decay.time.values, decay.angle.values, np.zeros(len(decay.time))
    for _ in range(TURNS if sensors else 1):
        result = method.identify(decay.assign(angle=("time", angle - errors)), moving)
        model = model_of(result)
        if not sensors:
            break
        start = (result.start_angle.item(), result.start_rate.item())
        motion = fit_start(model, t, angle - errors, start)
        terms = np.stack([f.value(motion.x, motion.v, t - t[0]) for f in sensors], axis=1)
        # The start moves along, or a cubic error would be taken for amplitude.
        table = np.column_stack([terms, motion.sensitivity, np.ones(len(t))])
        found = np.linalg.lstsq(table, angle - motion.x, rcond=None)[0][: len(sensors)]
        errors = terms @ found
        model = replace(model, library=BOTH, coefficients=dict(model.coefficients))
        model.coefficients.update(zip((f.symbol for f in sensors), found.tolist(), strict=True))
        method = replace(method, start=model_of(result), shapes=model.shapes)
    held = sum(low > 0.999 for low, _ in getattr(method, "bounds", {}).values())
    count = len(forces) + 1 + len(getattr(method, "fit_shapes", ())) - held
    return model, count


def pysindy(identify: Callable, w: float, decay: xr.Dataset, forces: tuple[str, ...]) -> tuple[Model, int]:
    """Model by pysindy, w being held and `alpha` unknown; coarse records are made denser by a spline."""
    library = BOTH.select(("alpha", *forces))
    t, angle = decay.time.values * w / TUNED, decay.angle.values
    if identify is not peers.sindy:
        dense = np.arange(t[0], t[-1], min(STEP, np.median(np.diff(t))))
        t, angle = dense, CubicSpline(t, angle)(dense)
    found = identify(library, TUNED, t, angle)
    return Model(library, dict(zip(library.symbols, found.tolist(), strict=True)), w), len(library)


def contestants(record: Record, w: float) -> list[tuple[str, str, Callable]]:
    """Method, forces and what to call with the training decay."""
    six = tuple(s for s in SIX.symbols if s != "alpha")
    rows: list[tuple[str, str, Callable]] = [
        (type(m).__name__, " ".join(six), partial(ours, m, forces=six))
        for m in (Averaging(), Direct(), Trajectory())
    ]
    for model in record.models:
        method = Trajectory(fit_shapes=tuple(model.shapes), shapes=model.shapes, bounds=model.bounds)
        rows.append(("Trajectory", model.forces, partial(ours, method, forces=tuple(model.forces.split()))))
    plain = max(
        record.models,
        key=lambda m: (not m.shapes and "sensor" not in m.forces and "slip" not in m.forces, len(m.forces)),
    )
    for forces in (six, tuple(s for s in plain.forces.split())):
        for name, identify in (
            ("SINDy, finite differences", peers.sindy),
            ("SINDy, Savitzky-Golay", partial(peers.sindy, derivatives=peers.inner_savitzky_golay)),
            ("WeakPDELibrary", peers.weak_sindy),
        ):
            rows.append(
                (f"pysindy {name}", "alpha " + " ".join(forces), partial(pysindy, identify, w, forces=forces))
            )
    return rows


def table_of(record: Record, folder: Path, quick: bool, progress: Progress) -> Table:
    """Every method on one record."""
    decay = free_decay(read_record(folder / record.file, **record.columns), window=record.window)
    decay = decay.isel(time=slice(None, None, record.stride * (4 if quick and record.stride > 1 else 1)))
    t, angle = decay.time.values, decay.angle.values
    split = int(np.searchsorted(t, t[0] + (t[-1] - t[0]) * 2 / 3, side="right"))
    train = decay.isel(time=slice(split))
    w = Direct().identify(train, SIX.select(["zeta"])).reference_frequency.item()
    table = Table(
        title=f"{record.title}: {split} + {len(t) - split} samples, RMS in mrad", title_justify="left"
    )
    for head, side in (("method", "left"), ("forces", "left"), ("fitted", "right"), ("train", "right")):
        table.add_column(head, justify=side)
    for head in ("hold-out", "time (s)"):
        table.add_column(head, justify="right")
    rows = contestants(record, w)
    for name, forces, identify in progress.track(rows, description=record.title):
        begin = time.perf_counter()
        try:
            model, count = identify(train)
            taken = f"{time.perf_counter() - begin:.2f}"
            gaps = [
                gap(model, t[:split], angle[:split], 0.0),
                gap(model, t[split:], angle[split:], t[split] - t[0]),
            ]
            table.add_row(name, forces, str(count), *(f"{g:.2f}" for g in gaps), taken)
        except SysidTribError as error:
            table.add_row(name, forces, "", str(error)[:60], "", f"{time.perf_counter() - begin:.2f}")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="every fourth of the pendulum's samples")
    parser.add_argument("--only", metavar="WORDS", default="", help="records whose title holds these words")
    options = parser.parse_args()
    folder, console = records_folder(), Console()
    chosen = [r for r in RECORDS if options.only.lower() in r.title.lower()]
    with Progress(console=Console(stderr=True), transient=True) as progress:
        tables = [table_of(record, folder, options.quick, progress) for record in chosen]
    for table in tables:
        console.print(table)


if __name__ == "__main__":
    main()
