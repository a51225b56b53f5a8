"""Records: an angle or displacement over time from a file, with its unit, and notes on its reading."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records import (
    assumed_units,
    cleaning,
    drives,
    equilibrium,
    inputs,
    reading,
    tables,
    units as lab,
)
from sysid_trib.records.columns import ChosenColumns, choose_columns
from sysid_trib.records.constants import with_constants
from sysid_trib.records.integration import as_position
from sysid_trib.records.own_quantity import with_own_quantity
from sysid_trib.records.published import named_file
from sysid_trib.records.row_times import input_columns, inputs_near, row_times, with_inputs
from sysid_trib.records.tables import LISTED
from sysid_trib.records.unit_tables import ACCELEROMETER, METRES, STANDARD_GRAVITY
from sysid_trib.records.unwrapping import unwrapped

# Largest number of the file's columns that a record lists.
MOST_COLUMNS_NAMED = 30


def read_record(
    path: str | os.PathLike[str],
    *,
    time: str | int | None = None,
    angle: str | int | None = None,
    signal: str | None = None,
    units: str | None = None,
    sampling_rate: float | None = None,
    time_units: str | None = None,
    length: float | None = None,
    input: str | Sequence[str] | Mapping[str, str | int] | None = None,
    between: str | None = None,
    constants: Mapping[str, str | float] | None = None,
) -> xr.Dataset:
    """Read an oscillation from a file.

    Parameters
    ----------
    path : str or path
        Text, CSV or JSON, MATLAB, NumPy, Excel, netCDF, HDF5, Parquet or TDMS, or one of them as .gz; the
        content decides, not the name. `-` is standard input, and `dataset:NAME` a record of `st.datasets`,
        read by the options stored there unless others are given.
    time : str or int, optional
        Name of the time column, or its number from 0. If not given, it is recognised by its name or because
        it rises. The columns of MATLAB and HDF5 files are named like `data.Y[0]`.
    angle : str or int, optional
        Name or number of the signal's column, or a formula of columns, `atan2(x - 3.1, -y)`; by default the
        only plausible column.
    signal : {"angle", "displacement", "rate", "acceleration"}, optional
        Measured quantity; by default by unit and name. A rate is integrated once and an acceleration twice,
        without the drift due to their bias.
    units : str, optional
        Unit of the signal, if the file does not state it: rad, deg, mrad, mm, px, V, au, rad/s, g, ...
    sampling_rate : float, Hz, optional
        Sampling rate in place of a time column.
    time_units : {"s", "ms", "us", "ns", "min", "h", "d"}, optional
        Unit of the time, if the file does not state it; by default s.
    length : float, m, optional
        Length of a pendulum: a displacement in a unit of length becomes an angle.
    input : str, sequence of str, or mapping of str to str, optional
        Columns of the inputs that drive the motion: `"V1"` is the input `u` of formulas,
        `{"u": "V1", "b": "V2"}` are several by their names. `"base.mat:y"` is a column of another file, with
        its own clock; `"*_y.mat:y"` is one of the file with the most similar name.
    between : {"smooth", "linear", "held", "cubic"}, optional
        Interpolation of inputs between their samples: smooth, like a signal measured without aliasing; held,
        like the output of a converter. By default smooth, or held if they move in steps.
    constants : mapping of str to (str or float), optional
        Known constants of the run, such as a gain, a load or a temperature, by their names in formulas: a
        number, the name of a column, or the name of a number that the file states once.

    Returns
    -------
    Dataset
        `angle(time)` in rad, or a displacement in the file's unit (its attribute `units`), and `rate(time)`
        or `acceleration(time)` where that was measured. Times are those of the file. Attrs describe the
        reading: `signal`, `angle_unit_in_file`, `clock`, `reading`.

    Raises
    ------
    UsageError
        An unknown column, option or file; an option that contradicts the header; several columns that could
        be the signal; several runs side by side (`read_records` gives all).
    RecordError
        A file without such a record: malformed, not finite, times out of order.

    Examples
    --------
    The header states the units of the columns.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> swing = st.records.paper_twin()
    >>> table = np.column_stack([1000.0 * swing.time, np.degrees(swing.angle)])
    >>> np.savetxt("swing.csv", table, delimiter=",", header="time (ms),angle (deg)", comments="")
    >>> record = st.read_record("swing.csv")
    >>> record.angle[0].round(3).item(), record.time[-1].round(2).item()
    (0.3, 24.99)
    """
    if not isinstance(path, str | os.PathLike):
        raise UsageError(
            "read_record reads a file; data in memory are used directly: st.free_decay((t, angle))."
        )
    given = time, angle, signal, units, sampling_rate, time_units, length
    how = reading.Reading(
        *given, inputs=inputs.named_inputs(input), between=between, constants=constants or {}
    )
    records = read_records(path, how)
    if len(records) > 1:
        names = ", ".join(str(record.attrs["angle_column"]) for record in records)
        wrong = f"{Path(path).name}: {len(records)} runs side by side ({names})"
        raise UsageError(f"{wrong}; name a column, or take all with read_records.")
    return records[0]


def read_records(path: str | os.PathLike[str], how: reading.Reading | None = None) -> list[xr.Dataset]:
    """Read every run of a file: one, or several side by side.

    Runs are side by side if each has its own time column and the names of their columns differ only by a
    number or a letter: `time 1, angle 1, time 2, angle 2`.

    Parameters
    ----------
    path : str or path
        As in `read_record`.
    how : Reading, optional
        Options for reading.

    Returns
    -------
    list of Dataset
        Each record in the form of `read_record`.

    Raises
    ------
    UsageError, RecordError
        As in `read_record`.

    Examples
    --------
    Two runs side by side, each with its own times.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> swing = st.records.paper_twin()
    >>> table = np.column_stack([swing.time, swing.angle, swing.time, 0.9 * swing.angle])
    >>> np.savetxt("runs.csv", table, delimiter=",", header="time 1,angle 1,time 2,angle 2", comments="")
    >>> [record.angle[0].round(2).item() for record in st.records.read_records("runs.csv")]
    [0.3, 0.27]
    """
    named_as = named_file(path)
    path = named_as.path
    how = named_as.reading(how or reading.Reading())
    how = replace(how, inputs=inputs_near(how.inputs, path))
    if how.time is not None and how.sampling_rate is not None:
        raise UsageError(f"{path.name}: give a time column or a sampling rate, not both.")
    table = named_as.whole(tables.read_table(path))
    if reading.is_expression(table, how.angle):
        table = reading.with_expression(table, str(how.angle), how.units)
    of_columns = (value for value in how.constants.values() if isinstance(value, str))
    named = [column for value in of_columns if (column := table.match(value)) is not None]
    chosen = choose_columns(table, how, [*input_columns(how.inputs, table), *named])
    records = [_read(table, columns, how) for columns in chosen]
    # A small swing does not show that it is in degrees, but another run of the file may.
    if {record.attrs["angle_unit_in_file"] for record in records} == {"rad", "deg"} and how.units is None:
        hows = [how if columns[1].stated else replace(how, units="deg") for columns in chosen]
        records = [_read(table, *pair) for pair in zip(chosen, hows, strict=True)]
    for number, record in enumerate(records, 1):
        # Two runs of one file are two records.
        record.attrs["record_checksum"] = table.checksum + f"-{number}" * (len(chosen) > 1)
        record.attrs |= named_as.attrs()
    return records


def reading_text(runs: Sequence[xr.Dataset]) -> str:
    """Return in words how the runs of a file were read: quantity, unit, columns, clock, and changes.

    Parameters
    ----------
    runs : sequence of Dataset
        As `read_records` returns them.

    Returns
    -------
    str

    Examples
    --------
    >>> import sysid_trib as st
    >>> st.records.reading_text([st.datasets.load("certified/viscous_1e-4")])
    'angle in rad from column angle (rad); 100 Hz clock'
    """
    attrs = runs[0].attrs
    column = " and ".join(dict.fromkeys(str(run.attrs["angle_column"]) for run in runs))
    facts = [f"{attrs['signal']} in {attrs['angle_unit_in_file']} from column {column}", attrs["clock"]]
    facts += [attrs[name] for name in ("reading", "separation", "integration") if attrs.get(name)]
    return "; ".join(facts)


def _read(table: tables.FileTable, columns: ChosenColumns, how: reading.Reading) -> xr.Dataset:
    column, time_column = columns.signal, columns.time
    values, absent = column.signal
    times = row_times(table, time_column, column, values, how)
    time, rows, breaks, seen, _ = times.clock
    kept = np.isfinite(values[rows])
    missing = int(np.count_nonzero(~kept))
    copies = f"the same numbers are in {', '.join(columns.copies[:LISTED])}" if columns.copies else ""
    said = [columns.reason, copies, *table.said, *times.said, absent]
    if missing and not absent:
        said.append(f"{missing} values missing" if missing > 1 else "1 value missing")
    time, rows = time[kept], rows[kept]
    values = values[rows]
    if values.size < 2:
        raise RecordError(f"{table.source}: a single sample is not a record.")
    # A bad sample contains no information on the unit.
    calm = np.delete(np.arange(values.size), cleaning.spikes(time, values))
    unit, why = assumed_units.unit_of(table, column, how, time[calm], values[calm])
    values = values * unit.factor
    if unit.quantity in lab.POSITIONS:
        is_angle = unit.quantity == "angle"
        values, turn, cuts = unwrapped(values, 2.0 * np.pi if is_angle else None)
        at_end = f"the end of its range ({cuts} times, {turn:.6g} {unit.text})"
        where = f"a whole turn ({cuts} times)" if is_angle else at_end
        said += [f"put together again where it was cut at {where}"] if cuts else []
    attrs: dict[str, Any] = {
        "source": table.source,
        "signal": unit.quantity,
        "time_column": time_column.name if time_column else f"none, {1.0 / np.median(np.diff(time)):g} Hz",
        "time_unit_in_file": times.unit,
        "angle_column": column.name,
        # More columns have names made by a program.
        "columns_in_file": "; ".join(other.name for other in table.columns[:MOST_COLUMNS_NAMED]),
        "angle_unit_in_file": unit.text,
        "clock": "; ".join(seen),
        "reading": "; ".join(text for text in (*said, why) if text),
    }
    if breaks:
        attrs["breaks"] = list(breaks)
    if not how.inputs and (acting := drives.drives_among(table.columns, column)):
        attrs["drives"] = [drive.name for drive in acting]
    record = with_inputs(_as_record(time, values, unit, attrs, how), table, rows, how, times.origin)
    record = with_constants(record, table, rows, how.constants)
    return with_own_quantity(record) if how.inputs or how.constants else record


def _as_record(
    time: Array, values: Array, unit: lab.SignalUnit, attrs: Mapping[str, Any], how: reading.Reading
) -> xr.Dataset:
    """Return the record of a signal: `angle(time)`, and the measured quantity if it differs.

    A rate is integrated once, an acceleration twice, without the drift of a bias. An accelerometer on a
    pendulum measures g sin(x) + r x'' along its path. Without friction x'' = -w^2 sin(x), so to first order
    the angle is the arcsine of its reading over g - r w^2.
    """
    position, scale = unit.position, 1.0
    time_axis = ("time", time, {"units": "s", "long_name": "time"})
    record = xr.Dataset(coords={"time": time_axis}, attrs=attrs)
    if how.distance is None and how.length is not None and position in METRES:
        position, scale = "rad", METRES[position] / how.length
        record.attrs["length"] = how.length
    if times := lab.INTEGRATIONS[unit.quantity]:
        swing, quantity = equilibrium.find_swing(time, values), unit.quantity
        bias = float(np.median(values)) if swing is None else swing.equilibrium
        period = float(np.ptp(time)) if swing is None else swing.oscillation.period
        said = f"integrated {'once' if times == 1 else 'twice'}, without the drift of its bias"
        made: dict[str, Any] = {f"{quantity}_bias": bias, "integrations": times}
        made["integration"] = f"{said} (splines, knots two periods apart)"
        measured = {"units": position + inputs.PER_KIND[quantity], "long_name": f"{quantity} as measured"}
        if how.distance is not None:
            made = _felt(str(attrs["source"]), swing, how.distance)
            quantity = record.attrs["signal"] = ACCELEROMETER
            measured, position = {"units": "m/s^2", "long_name": "acceleration that was felt"}, "rad"
        record[quantity] = ("time", values * scale, measured)
        record.attrs |= {"measured": quantity, **made}
        values = as_position(time, values - bias, period, made)
    name = "angle" if position == "rad" else "displacement"
    record["angle"] = ("time", values * scale, {"units": position, "long_name": name})
    return record


def _felt(source: str, swing: equilibrium.Swing | None, distance: float) -> dict[str, Any]:
    """Return the acceleration that an accelerometer at a distance (m) measures per sine of the angle."""
    if swing is None:
        raise RecordError(f"{source}: no oscillation is visible above the noise; choose another axis.")
    felt = STANDARD_GRAVITY - distance * (2.0 * np.pi / swing.oscillation.period) ** 2
    # An accelerometer that measures less than this fraction of gravity does not show the angle.
    if felt < 0.02 * STANDARD_GRAVITY:
        wrong = (
            f"{source}: at {distance:g} m from the axis an accelerometer measures almost nothing of a swing"
        )
        raise RecordError(f"{wrong} ({felt:.3g} m/s^2 of 9.81): correct --distance, or choose another axis.")
    made = "its angle by the arcsine, as if there were no friction"
    return {"integrations": 0, "distance": distance, "felt_per_sine": felt, "integration": made}


def scale_translation(record: xr.Dataset, mass: float, natural_frequency: float, load: float) -> xr.Dataset:
    """Convert the position of a translational tribometer to the dimensionless angle of the theory.

    Parameters
    ----------
    record : Dataset
        `angle(time)` in a unit of length.
    mass : float, kg
        Moving mass m.
    natural_frequency : float, rad/s
        Natural frequency w0.
    load : float, N
        Normal load P.

    Returns
    -------
    Dataset
        `angle(time)` = m w0^2 x / P; a friction force T then acts as f = -T/P (Le Bot et al. 2019, Sec. 2).

    Raises
    ------
    UsageError
        The record is not a position in a unit of length, or a value is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> table = {"time": np.arange(0.0, 5.0, 0.01), "x (mm)": np.ones(500)}
    >>> record = st.records.one_record(table, "my_function")
    >>> scaled = st.records.scale_translation(record, mass=0.5, natural_frequency=10.0, load=2.0)
    >>> scaled.angle[0].round(6).item(), scaled.angle.attrs["units"]
    (0.025, 'rad')
    """
    source = record.attrs.get("source", "record")
    unit = str(record["angle"].attrs.get("units"))
    if unit not in METRES:
        raise UsageError(f"{source}: only a position can be scaled; read the record with units=m (or mm).")
    for name, value in (("mass", mass), ("natural frequency", natural_frequency), ("load", load)):
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} of {value}: give a positive number.")
    factor = METRES[unit] * mass * natural_frequency**2 / load
    scaled = record.copy()
    scaled["angle"] = (record["angle"] * factor).assign_attrs(units="rad", long_name="scaled position")
    said = f"m = {mass:g} kg, w0 = {natural_frequency:g} rad/s, P = {load:g} N"
    made = {"translation": f"angle = m w0^2 x / P with {said}", "translation_factor": factor}
    scaled.attrs = record.attrs | made
    return scaled
