"""Kinds of files that are no text: Excel, MATLAB, HDF5, netCDF, Parquet."""

from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from scipy.io import savemat

from benchmarks.contact.writing import DEG, Draw, Right, kind, swing


def book(path: Path, sheets: dict[str, list[list[object]]]) -> None:
    with pd.ExcelWriter(path, engine="openpyxl") as file:
        for name, rows in sheets.items():
            width = max(map(len, rows))
            padded = [[*row, *[None] * (width - len(row))] for row in rows]
            pd.DataFrame(padded).to_excel(file, sheet_name=name, header=False, index=False)


@kind("excel.xlsx", "Excel: titles, notes, units in a row of their own, empty columns, a summary below")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25, 40), falls=6.0)
    x = np.round((motion.x + draw.noise(motion.x.size, 1e-3)) * DEG, 3)
    rows: list[list[object]] = [[t, v] for t, v in zip(motion.time.tolist(), x.tolist(), strict=True)]
    head: list[list[object]] = draw.pick(
        [["Time (s)", "Angle (deg)"]],
        [["Pendulum 3"], [], ["Time [s]", "Angle [°]"]],
        [["Time", "Angle"], ["s", "deg"]],
        [["Time", "Angle"], ["[s]", "[deg]"]],
        [["Run", 3], ["Mass (kg)", 0.25], [], ["t (s)", "theta (deg)"]],
    )
    if draw.pick(True, False):
        rows += [[], ["Mean", 0.01]]
    if draw.pick(True, False):
        head, rows = ([[None, *row] for row in part] for part in (head, rows))
    sheets = {"Data": [*head, *rows]}
    if draw.pick(True, False):
        sheets = {"Notes": [["Operator", "n. n."], ["Date", "12.03.2019"]], **sheets}
    book(path, sheets)
    return motion.right("angle", "deg")


@kind("phyphox.xlsx", "phyphox: a sheet of data, sheets of the device")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25, 40), falls=6.0)
    v = motion.v + draw.noise(motion.v.size, 0.005)
    rows = [
        list(row)
        for row in zip(
            motion.time.tolist(), (0.01 * v).tolist(), v.tolist(), (0.02 * v).tolist(), strict=True
        )
    ]
    head = ["Time (s)", "Gyroscope x (rad/s)", "Gyroscope y (rad/s)", "Gyroscope z (rad/s)"]
    times = [["event", "experiment time", "system time"], ["START", 0.0, 1.55e9], ["PAUSE", 60.0, 1.55e9]]
    book(
        path,
        {
            "Raw Data": [head, *rows],
            "Metadata Device": [["property", "value"], ["version", "1.1.8"]],
            "Metadata Time": times,
        },
    )
    return motion.right("rate", "rad/s")


@kind("excel_times.xlsx", "Excel: the time as dates, decimal commas as texts")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=20.0, period=(0.8, 2.0), falls=6.0)
    x = np.round((motion.x + draw.noise(motion.x.size, 1e-3)) * DEG, 3)
    begin = datetime(2019, 3, 12, 14, 2, 33)
    texts = draw.pick(True, False)
    if texts:
        rows = [
            [f"{t:.3f}".replace(".", ","), f"{v:.3f}".replace(".", ",")]
            for t, v in zip(motion.time, x, strict=True)
        ]
    else:
        rows = [
            [begin + timedelta(milliseconds=round(1000 * t)), v]
            for t, v in zip(motion.time, x.tolist(), strict=True)
        ]
    book(path, {"Tabelle1": [["Zeit (s)" if texts else "Zeit", "Winkel (°)"], *rows]})
    return motion.right("angle", "deg")


@kind("struct.mat", "MATLAB: structs, nested ones, rates and steps as scalars, texts of units")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = motion.x + draw.noise(motion.x.size, 1e-3)
    column = draw.pick(lambda a: a[None, :], lambda a: a[:, None])
    content = draw.pick(
        {"t": column(motion.time), "theta": column(x)},
        {"data": {"time": column(motion.time), "angle": column(x)}},
        {
            "ScopeData": {
                "time": motion.time[:, None],
                "signals": {"values": x[:, None], "label": "theta"},
                "blockName": "m/Scope",
            }
        },
        {"theta": column(x), "Fs": float(motion.rate)},
        {"theta": column(x), "Ts": 1.0 / motion.rate},
        {"exp": {"theta": column(x), "dt": 1.0 / motion.rate, "m": 0.25}},
        {"M": np.column_stack([motion.time, x])},
        {"M": np.vstack([motion.time, x])},
    )
    savemat(path, content, format=draw.pick("5", "5"))
    return motion.right("angle", "rad")


@kind("degrees.mat", "MATLAB: degrees by the name or the unit, single precision, counts")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = (motion.x + draw.noise(motion.x.size, 1e-3)) * DEG
    content = draw.pick(
        {"t": motion.time, "theta_deg": x},
        {"time_ms": 1e3 * motion.time, "angle_deg": x.astype(np.float32)},
        {"t": motion.time, "angle": x, "unit": "deg"},
        {"rec": {"t": motion.time, "phi": x, "units": {"t": "s", "phi": "deg"}}},
    )
    savemat(path, content)
    return motion.right("angle", "deg")


@kind("groups.h5", "HDF5: groups, attributes of unit and rate, two-dimensional and compound data")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(("deg", DEG), ("rad", 1.0), ("mrad", 1e3))
    x = (motion.x + draw.noise(motion.x.size, 1e-3)) * scale
    layout = draw.pick("pair", "rate", "dataset rate", "table", "compound", "ms")
    name = draw.pick("units", "unit", "Unit")
    with h5py.File(path, "w") as file:
        group = file.create_group(draw.pick("run_1", "entry/data", "measurement"))
        if layout in ("pair", "ms"):
            factor, clock = (1e3, "ms") if layout == "ms" else (1.0, "s")
            group.create_dataset("time", data=factor * motion.time).attrs[name] = clock
            group.create_dataset("angle", data=x).attrs[name] = unit
        elif layout == "rate":
            group.create_dataset("angle", data=x).attrs[name] = unit
            group.attrs[draw.pick("fs", "sampling_rate")] = motion.rate
        elif layout == "dataset rate":
            group.create_dataset("angle", data=x).attrs[name] = unit
            group.create_dataset("fs", data=motion.rate)
        elif layout == "table":
            table = group.create_dataset("table", data=np.column_stack([motion.time, x]))
            table.attrs["columns"] = ["time (s)", f"angle ({unit})"]
        else:
            rows = np.zeros(x.size, dtype=[("time", "f8"), (f"angle_{unit}", "f8")])
            rows["time"], rows[f"angle_{unit}"] = motion.time, x
            group.create_dataset("rows", data=rows)
    return motion.right("angle", unit)


@kind("variables.nc", "netCDF: units as attributes, times since a date, a second dimension of one")
def _(path: Path, draw: Draw) -> Right:
    import xarray as xr

    motion = swing(draw)
    unit, scale = draw.pick(("degrees", DEG), ("rad", 1.0), ("degree", DEG))
    x = (motion.x + draw.noise(motion.x.size, 1e-3)) * scale
    factor, clock = draw.pick(
        (1.0, "s"),
        (1e3, "milliseconds"),
        (1.0, "seconds since 2019-03-12 14:00:00"),
        (1e3, "milliseconds since 2019-03-12"),
    )
    data = xr.Dataset(
        {"theta": ("time", x, {"units": unit})}, {"time": ("time", factor * motion.time, {"units": clock})}
    )
    if draw.pick(True, False):
        data["temperature"] = ("time", 21 + 0.001 * motion.time, {"units": "degC"})
    data.to_netcdf(path, engine="h5netcdf")
    return motion.right("angle", "rad" if unit == "rad" else "deg")
