"""Defects of a motion, its samples and its rows, and of files that are no text."""

import bz2  # noqa: F401
import gzip  # noqa: F401
import io
import json  # noqa: F401
import tarfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pandas as pd
import xarray as xr  # noqa: F401
from numpy.linalg import norm  # noqa: F401
from scipy.io import savemat, wavfile  # noqa: F401
from scipy.signal import lfilter

from benchmarks.contact.writing import Array, Draw, Swing, decay_at

Rows = list[list[str]]


def held_by_hand(draw: Draw, m: Swing) -> Array:
    """Brought to the start by a hand, with wobbles, and let go at the release."""
    x, before = m.x.copy(), m.time < m.release
    s = np.clip(m.time[before] / (0.8 * m.release), 0, 1)
    wobble = np.sin(np.pi * s) * np.sin(draw.rng.uniform(9, 12) * s + draw.rng.uniform(0, 6))
    x[before] = m.start * (s * s * (3 - 2 * s) + 0.15 * wobble)
    return x


def stopped_by_hand(draw: Draw, m: Swing) -> Array:
    """Caught, and held for five seconds."""
    end, rest = m.time[-1] * draw.within(0.7, 0.9), draw.within(-0.05, 0.05)
    x = rest + (m.x - rest) * np.exp(-np.maximum(m.time - end, 0) / (0.1 * m.period))
    whole = np.concatenate([x, np.full(int(5 * m.rate), rest)])
    return whole + draw.noise(whole.size, 1e-3)


def dry(draw: Draw) -> Swing:
    """Half periods about +-lam, each viscous; then held, away from the middle."""
    period, start = draw.within(0.6, 2.0), draw.within(0.2, 0.5)
    zeta, lam = draw.within(0.001, 0.004), draw.within(1e-3, 4e-3)
    half, rate = period / 2, float(f"{draw.within(40, 90) / period:.2g}")
    turns, fall = [start], np.exp(-zeta * np.pi / np.sqrt(1 - zeta**2))
    while abs(turns[-1]) > lam:
        centre = np.sign(turns[-1]) * lam
        turns.append(centre - (turns[-1] - centre) * fall)
    time = np.arange(int((half * len(turns) + draw.within(10, 30)) * rate)) / rate
    which = np.minimum((time / half).astype(int), len(turns) - 2)
    turn = np.array(turns)[which]
    local = np.minimum(time - half * which, half)
    x = np.sign(turn) * lam + decay_at(local, np.pi / half, zeta, 1.0)[0] * (turn - np.sign(turn) * lam)
    return Swing(time, x, x, x, period, zeta, start, rate)


def driven_before(m: Swing, periods: float) -> tuple[Array, Array]:
    """Driven at its own frequency until the drive is switched off."""
    count = int(periods * m.period * m.rate)
    before = m.start * np.cos(2 * np.pi / m.period * np.arange(-count, 0) / m.rate)
    x = np.concatenate([before, m.x])
    return np.arange(x.size) / m.rate, x


def pumped(draw: Draw, m: Swing) -> Array:
    """Pushed up by a hand over several periods and let swing, twice."""
    up = np.arange(int(draw.pick(6, 10) * m.period * m.rate)) / m.rate
    ramp = m.start * up / up[-1] * np.cos(2 * np.pi / m.period * (up - up[-1] - 1 / m.rate))
    whole = np.concatenate([ramp, m.x] * 2)
    return whole + draw.noise(whole.size, 1e-3)


def shaking(draw: Draw, m: Swing) -> Array:
    """Ambient shaking of the same mode, of size 1."""
    pole = np.exp((-m.zeta + 1j) * 2.0 * np.pi / m.period / m.rate)
    shaken = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], draw.noise(m.time.size, 1.0))
    return shaken / shaken.std()


def spiked(draw: Draw, x: Array) -> Array:
    """Single bad samples, and a bad first one."""
    count = draw.pick(1, 3, 8)
    at = draw.rng.choice(x.size, count, replace=False)
    x[at] += draw.rng.uniform(1, 8, count) * draw.rng.choice([-1, 1], count)
    x[0] = draw.pick(x[0], draw.pick(0.0, 9.99, -5.0))
    return x


def chosen(draw: Draw, size: int, count: int) -> Array:
    """Ones at some places, zeros elsewhere."""
    return np.isin(np.arange(size), draw.rng.choice(size, count, replace=False)).astype(int)


def three_axes(
    draw: Draw, main: Array, rest: float, share: float, noise: float, offset: float = 0.0
) -> Array:
    """Three axes of a sensor, one of which has the motion."""
    axes = share * main + rest + draw.noise((3, main.size), noise)
    axes[draw.pick(0, 1, 2)] = offset + main + draw.noise(main.size, noise)
    return axes


def packet_times(draw: Draw, m: Swing) -> Array:
    """Stamps of packets, some of them late; a packet does not overtake the one before."""
    row, size = np.arange(m.time.size), draw.pick(4, 6, 8)
    first = row // size * size
    late = draw.within(0.0, 0.05) * (draw.noise(row.size, 1.0) > 1.5)[first]
    arrival = np.maximum.accumulate(first / m.rate + late)
    return np.maximum.accumulate(arrival + draw.pick(0.0, 0.001) * (row % size))


def pairs(draw: Draw, m: Swing, scale: float, count: int) -> Iterable[tuple[float, ...]]:
    """Return the columns after the time: angle, and time and angle of further runs."""
    runs = [scale * (m.x + draw.noise(m.x.size, 1e-3)) for _ in range(count)]
    return zip(*[c for run in runs for c in (m.time, run)][1:], strict=True)


def scope_facts(m: Swing) -> list[str]:
    """An oscilloscope's facts in the first columns of the first rows."""
    facts = f"Record Length,2.5e+03,Points;Sample Interval,{1 / m.rate:.6e},s;Trigger Point,0,Samples;,,"
    facts += ";Source,CH1,;Vertical Units,V,"
    return (facts.split(";") + [",,"] * m.x.size)[: m.x.size]


def with_gaps(draw: Draw, rows: Rows, long: int) -> Rows:
    """Samples missing: single ones, one long gap."""
    keep = draw.rng.random(len(rows)) > 0.01
    at = int(draw.rng.integers(len(rows) // 3, len(rows) // 2))
    keep[at : at + long] = False
    return [row for row, kept in zip(rows, keep, strict=True) if kept or row is rows[0]]


def with_cells(draw: Draw, rows: Rows, count: int, text: str) -> Rows:
    """A text in the place of some numbers."""
    for at in draw.rng.choice(len(rows), count, replace=False):
        rows[at][1] = text
    return rows


def with_row(rows: Rows, at: int, row: list[str]) -> Rows:
    return [*rows[:at], row, *rows[at:]]


def rows_of(*columns: object) -> list[list[object]]:
    """Rows of a sheet."""
    lists = [c.tolist() if isinstance(c, np.ndarray) else c for c in columns]
    return [list(row) for row in zip(*lists, strict=True)]  # type: ignore[call-overload]


def book(path: Path, sheets: dict[str, list[list[object]]]) -> None:
    """An Excel file."""
    with pd.ExcelWriter(path, engine="openpyxl") as file:
        for name, rows in sheets.items():
            # Of rows of unequal length pandas warns.
            width = max(map(len, rows))
            padded = [[*row, *[None] * (width - len(row))] for row in rows]
            pd.DataFrame(padded).to_excel(file, sheet_name=name, header=False, index=False)


def groups(path: Path, draw: Draw, m: Swing, x: Array, unit: str) -> None:
    """HDF5: groups, attributes of unit and rate, two-dimensional and compound data."""
    layout = draw.pick("pair", "rate", "dataset rate", "table", "compound", "ms")
    name = draw.pick("units", "unit", "Unit")
    with h5py.File(path, "w") as file:
        group = file.create_group(draw.pick("run_1", "entry/data", "measurement"))
        if layout == "table":
            table = group.create_dataset("table", data=np.column_stack([m.time, x]))
            table.attrs["columns"] = ["time (s)", f"angle ({unit})"]
            return
        if layout == "compound":
            group["rows"] = np.rec.fromarrays([m.time, x], names=f"time,angle_{unit}")
            return
        group.create_dataset("angle", data=x).attrs[name] = unit
        if layout == "rate":
            group.attrs[draw.pick("fs", "sampling_rate")] = m.rate
        elif layout == "dataset rate":
            group["fs"] = m.rate
        else:
            clock, factor = ("ms", 1e3) if layout == "ms" else ("s", 1.0)
            group.create_dataset("time", data=factor * m.time).attrs[name] = clock


def known(unit: str) -> str:
    """The unit of an angle as it is read."""
    of_degrees = ("deg", "°", "Grad", "degrés", "grados", "gradi", "graus", "graden", "grader")
    return "deg" if unit in of_degrees else unit


def clock_times(seconds: np.ndarray, form: str) -> list[str]:
    """Times of the day, to the ms: minutes m, seconds s, their whole part and thousandths ms."""
    times = [divmod(round(1000 * t), 60_000) for t in seconds]
    return [form.format(m=m, s=rest / 1000, whole=rest // 1000, ms=rest % 1000) for m, rest in times]


def iso_stamps(seconds: np.ndarray, form: str) -> list[str]:
    """Dates and times; `{0}` the date, `{2}` with strokes, `{1}` the time."""
    at = np.datetime64("2019-03-12T23:59:40.000") + np.round(1000 * seconds).astype("m8[ms]")
    return [form.format(day, clock, day.replace("-", "/")) for day, clock in (str(t).split("T") for t in at)]


def dates(seconds: np.ndarray) -> list[object]:
    """Dates of a spreadsheet."""
    return (np.datetime64("2019-03-12T14:02:33.000") + np.round(1000 * seconds).astype("m8[ms]")).tolist()


def decimal_commas(values: np.ndarray) -> list[str]:
    return [f"{value:.3f}".replace(".", ",") for value in values]


def grouped(values: np.ndarray, marks: str) -> list[str]:
    """Signs of thousands and of decimals."""
    return [f"{value:,.3f}".translate(str.maketrans(",.", marks)) for value in values]


def lvm(samples: int, rate: float, sign: str, columns: str) -> str:
    """The head of a LabVIEW measurement file."""
    step = f"{1.0 / rate:.6f}".replace(".", sign)
    date = "Date\t2019/03/12{0}\nTime\t14:02:33,1234567{0}\n"
    return (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t{sign}\nMulti_Headings\tYes\nX_Columns\t{columns}\nTime_Pref\tRelative\n"
        f"Operator\tlab\n{date.format('')}***End_of_Header***\t\n\t\nChannels\t1\t\nSamples\t{samples}\t\n"
        f"{date.format(chr(9))}Y_Unit_Label\tVolts\t\nX_Dimension\tTime\t\nX0\t0{sign}0000000000000000E+0\t\n"
        f"Delta_X\t{step}\t\n***End_of_Header***\t\t\nX_Value\tVoltage\tComment"
    )


def flattened(parts: Iterable[Rows]) -> Rows:
    """Rows of parts below each other."""
    return [row for part in parts for row in part]


def hdf5_of(path: Path, data: Mapping[str, Array], attributes: Mapping[str, Mapping[str, object]]) -> None:
    """HDF5: datasets with their attributes."""
    with h5py.File(path, "w") as file:
        for name, values in data.items():
            file[name] = values
            file[name].attrs.update(attributes.get(name, {}))


def structs(items: list[dict[str, object]]) -> np.ndarray:
    """An array of structs for MATLAB."""
    made = np.empty((1, len(items)), dtype=[(name, "O") for name in items[0]])
    for at, item in enumerate(items):
        for name, value in item.items():
            made[0, at][name] = value
    return made


def zipped(path: Path, parts: Mapping[str, bytes]) -> None:
    """A .zip of files."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)


def tarred(path: Path, parts: Mapping[str, bytes]) -> None:
    """A .tar.gz of files."""
    with tarfile.open(path, "w:gz") as archive:
        for name, content in parts.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))


def merged_book(path: Path, rows: list[list[object]], merged: list[str]) -> None:
    """An Excel file with merged cells."""
    made = openpyxl.Workbook()
    for row in rows:
        made.active.append(row)
    for cells in merged:
        made.active.merge_cells(cells)
    made.save(path)


def universal_file(values: Array, step: float) -> str:
    """A universal file, dataset 58: a function over time."""
    head = ["    -1", "    58", "run 12", "NONE", "12-Mar-19 14:02:33", "NONE", "NONE"]
    head += [
        "    1         0    0         0 NONE         1   1 NONE         0   0",
        f"         4{len(values):10d}         1  0.00000e+00{step:13.5e}  0.00000e+00",
        "        17    0    0    0                 Time                    s",
        "        12    0    0    0         Acceleration                 NONE",
        *["         0    0    0    0                 NONE                 NONE"] * 2,
    ]
    rows = ["".join(f"{value:13.5e}" for value in values[at : at + 6]) for at in range(0, len(values), 6)]
    return "\n".join([*head, *rows, "    -1"]) + "\n"
