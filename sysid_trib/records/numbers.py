"""The numbers of a column: missing ones are nan, dates and clock times become seconds."""

from datetime import datetime, time as clock_time
from typing import Any

import numpy as np
import pandas as pd

from sysid_trib.arrays import Array
from sysid_trib.decays.signal import LARGEST_NUMBER
from sysid_trib.errors import RecordError

# Rows of a column by which its kind is judged.
MOST_LOOKED_AT = 1000
MISSING_TEXTS = {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/v", "#n/a"}


def numbers(values: Any, name: str, source: str) -> Array:
    """Finite numbers, or nan where a value is missing.

    Parameters
    ----------
    values : array_like
        As the file has them: numbers, texts, dates, or times of the day.
    name, source : str
        Of the column and of the file, for messages.

    Raises
    ------
    RecordError
        A text that is no number, or an infinite value, with its row (from 1, below the header).
    """
    values = np.asarray(values)
    if values.dtype.kind == "O" and all(isinstance(value, datetime) for value in values):
        values = values.astype("datetime64[us]")
    if values.dtype.kind == "M":
        return np.asarray((values - values[0]) / np.timedelta64(1, "ns"), dtype=float) * 1e-9
    if values.dtype.kind not in "fiub":
        values = _of_texts(values, name, source)
    values = values.astype(np.float64)
    vast = np.flatnonzero(np.isfinite(values) & (np.abs(np.nan_to_num(values)) > LARGEST_NUMBER))
    if vast.size:
        raise RecordError(
            f"{source}: row {vast[0] + 1} of column {name} holds {values[vast[0]]:g}, too much for an "
            "oscillation or its time; scale it."
        )
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        raise RecordError(
            f"{source}: row {infinite[0] + 1} of column {name} is infinite ({infinite.size} such rows); "
            "cut them out, or keep the part between them."
        )
    return values


def is_numeric(values: Any) -> bool:
    """Whether a column could hold a signal: numbers, most of the first ones."""
    values = np.asarray(values)
    if values.dtype.kind in "fiub":
        return True
    first = values[:MOST_LOOKED_AT].tolist()
    return not is_clock_time(values) and sum(map(_is_a_number, first)) * 2 > len(first)


def _is_a_number(value: object) -> bool:
    try:
        return float(str(value).replace(",", ".")) is not None
    except ValueError:
        return False


def is_clock_time(values: Any) -> bool:
    """Whether a column holds dates or times of the day, `12:00:01.250`."""
    values = np.asarray(values)
    if values.dtype.kind == "M":
        return True
    first = [value for value in values[:5] if value == value and value is not None]
    return bool(first) and all(
        isinstance(value, (datetime, clock_time)) or (isinstance(value, str) and value.count(":") >= 1)
        for value in first
    )


def _of_texts(values: Any, name: str, source: str) -> Array:
    if is_clock_time(values):
        texts = [str(value).replace(",", ".") for value in values]
        try:
            return np.asarray(pd.to_timedelta(texts).total_seconds(), dtype=float)
        except ValueError:
            pass
        try:
            dates = pd.to_datetime(texts)
            return np.asarray((dates - dates[0]).total_seconds(), dtype=float)
        except ValueError:
            pass
    return np.array([_number(value, name, row, source) for row, value in enumerate(values, 1)])


def _number(value: object, name: str, row: int, source: str) -> float:
    if value is None or str(value).strip().lower() in MISSING_TEXTS:
        return float("nan")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        pass
    try:
        return float(str(value).replace(",", "."))
    except ValueError:
        raise RecordError(
            f"{source}: row {row} of column {name} holds {str(value)[:30]!r}, not a number; "
            "correct it or cut it out."
        ) from None
