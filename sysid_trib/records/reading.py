"""Options for reading a file; a signal that is a formula of columns, `atan2(x - 3.1, -y)`."""

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.notation import parse, with_instead
from sysid_trib.records import units as lab
from sysid_trib.records.column import Column
from sysid_trib.records.inputs import BETWEEN_SAMPLES
from sysid_trib.records.tables import FileTable
from sysid_trib.records.unit_tables import ACCELEROMETER, METRES, RADIANS

# Names of record variables that an input must not have.
TAKEN_NAMES = ("time", "angle", "rate", "acceleration", "input", "x", "v", "t")
# Options with numbers: smallest and largest value, and description.
GIVEN_NUMBERS = {
    "sampling_rate": (1e-9, 1e9, "a positive number of samples a second"),
    "length": (1e-300, 1e6, "the pendulum's length in m"),
    "distance": (0.0, 1e6, "the distance from the axis in m"),
}


@dataclass(frozen=True)
class Reading:
    """Options for reading a file; options that are not given are taken from the file.

    Parameters
    ----------
    time, angle : str or int, optional
        Columns of time and signal, by name or number from 0.
    signal : {"angle", "displacement", "rate", "acceleration", "accelerometer"}, optional
        Measured quantity; an accelerometer on a pendulum also measures gravity's component along its path.
    units : str, optional
        Unit of the signal.
    sampling_rate : float, Hz, optional
        Sampling rate in place of a time column.
    time_units : {"s", "ms", "us", "ns", "min", "h", "d"}, optional
        Unit of the time column.
    length : float, m, optional
        Length of a pendulum: a displacement in a unit of length becomes an angle.
    distance : float, m, optional
        Distance of an accelerometer from the axis of its pendulum.
    usual : str, optional
        Usual quantity of such a system: that of the signal if it is not stated.
    gravity : bool
        Whether the body may swing under gravity; if not, its frequency does not show the unit of an angle.
    inputs : mapping of str to (str or int)
        Columns of inputs by their names in forces, `{"u": "V1"}`; `base.mat:y` is a column of another file.
    between : {"smooth", "linear", "held", "cubic"}, optional
        Interpolation of inputs between their samples (see `KnownInput`); by default `usual_between`.
    constants : mapping of str to (str or float)
        Known constants of the run by their names in forces, `{"kp": 100.0, "load": "load"}`: a number, or a
        constant column.

    Examples
    --------
    >>> import sysid_trib as st
    >>> st.records.paper_twin().angle.to_series().to_csv("swing.csv", header=["left"])
    >>> how = st.records.Reading(units="deg", time_units="ms")
    >>> (record,) = st.records.read_records("swing.csv", how)
    >>> record.attrs["angle_unit_in_file"], record.time[-1].round(5).item()
    ('deg', 0.02499)
    """

    time: str | int | None = None
    angle: str | int | None = None
    signal: str | None = None
    units: str | None = None
    sampling_rate: float | None = None
    time_units: str | None = None
    length: float | None = None
    distance: float | None = None
    usual: str | None = None
    gravity: bool = True
    inputs: Mapping[str, str | int] = field(default_factory=dict)
    between: str | None = None
    constants: Mapping[str, str | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, offered in (("signal", lab.SIGNALS), ("between", BETWEEN_SAMPLES)):
            if (given := getattr(self, name)) is not None and given not in offered:
                raise UsageError(f"{name} {given!r} is unknown: give {', '.join(offered)}.")
        if both := self.inputs.keys() & self.constants.keys():
            raise UsageError(f"{min(both)} is given as an input and as a constant; choose one.")
        for name in (*self.inputs, *self.constants):
            if not name.isidentifier() or name in TAKEN_NAMES:
                raise UsageError(
                    f"{name!r} cannot name an input; write u=COLUMN, as in the formulas of forces."
                )
        if self.time_units is not None and self.time_units not in lab.TIME_UNITS:
            raise UsageError(f"time units {self.time_units!r} are unknown: give {lab.OFFERED_TIME_UNITS}.")
        if self.units is not None and lab.signal_unit(self.units) is None:
            raise UsageError(f"units {self.units!r} are unknown: give {lab.OFFERED_UNITS}.")
        for name, (low, high, what) in GIVEN_NUMBERS.items():
            if (value := getattr(self, name)) is not None:
                text = name.replace("_", " ")
                if not isinstance(value, Real):
                    raise UsageError(f"{text} {value!r} is not a number; give a number.")
                if not low <= float(value) <= high:
                    raise UsageError(f"{text} {value:g}: give {what}.")
        if (self.signal == ACCELEROMETER) != (self.distance is not None):
            wrong = "An accelerometer on a pendulum is read by its distance from the axis"
            raise UsageError(f"{wrong}: give --signal accelerometer and --distance M, or neither.")

    @property
    def quantity(self) -> str | None:
        """Measured quantity, if it is given; an accelerometer measures an acceleration."""
        return "acceleration" if self.signal == ACCELEROMETER else self.signal


_STATED = re.compile(r"\W*(?P<name>[^\W\d]\w*)\s*=\s*(?P<value>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)\s*")
# Relative difference within which a factor equals the ratio of two units.
CONVERTED = 2e-3


def with_expression(table: FileTable, text: str, units: str | None) -> FileTable:
    """Return the table with an additional column, named by the expression.

    Parameters
    ----------
    table : FileTable
        Table whose columns are named by their headers without units, in upper or lower case: `x`, `pot`.
        Numbers that the file states once, such as scalars of MATLAB, have their names.
    text : str
        A formula as in forces; or `atan2(formula, formula)`, an angle in rad.
    units : str or None
        Unit of the result, if the user states it; else it follows from the units of the columns.

    Raises
    ------
    UsageError
        The text is not a formula of the columns, two columns have the same name, or no unit follows.
    """
    signal, parts, held = evaluated(table, text, "--angle")
    # Use the usual name of a unit, so that deg and degrees are equal.
    follows = _unit(parts, {name: column.unit_text for name, column in held.items()})
    unit = _agreed(follows, units)
    if unit is None:
        columns = ", ".join(column.name for column in held.values())
        wrong = f"{table.source}: the unit of --angle '{text}' does not follow from its columns ({columns})"
        raise UsageError(f"{wrong}, whose numbers it takes unchanged; state it with --units (units=).")
    base = next(iter(held)) if len(held) == 1 else ""
    made = Column(text, np.where(np.isfinite(signal), signal, np.nan), table.source, base, unit)
    return replace(table, columns=(*table.columns, made))


def evaluated(table: FileTable, text: str, flag: str) -> tuple[Array, list[Formula], dict[str, Column]]:
    """Evaluate a formula of columns: its values (row,), its parts, and its columns by name.

    Raises
    ------
    UsageError
        The text is not a formula of the columns, or two columns have the same name.
    """
    names: dict[str, list[Column]] = {}
    for column in table.columns:
        name = column.base.replace(" ", "_")
        if name.isidentifier():
            names.setdefault(name, []).append(column)
    stated = _stated(table, text, flag, names)
    known = frozenset({*names, *stated})
    try:
        parts = [parse(part, known, frozenset(), flag) for part in _arguments(text.lower())]
        # Replace names by the numbers that the file states.
        for name, value in stated.items():
            parts = [with_instead(part, name, repr(value)) for part in parts]
    except LibraryError as error:
        raise UsageError(
            f"{table.source}: {error} Columns that it may contain: {', '.join(names)}."
        ) from None
    used = {name for part in parts for name in part.names & names.keys()}
    held = {name: _single(names[name], name, f"{flag} '{text}'") for name in sorted(used)}
    if not held:
        wrong = f"{flag} '{text}' contains no column of numbers; it may contain {', '.join(names)}."
        raise UsageError(f"{table.source}: {wrong}")
    columns = {name: column.numbers for name, column in held.items()}
    sizes = {column.size for column in columns.values()}
    if len(sizes) > 1:
        raise UsageError(f"{table.source}: the columns of {flag} '{text}' are not of one length.")
    with np.errstate(all="ignore"):
        made = [np.broadcast_to(part.evaluate(columns), tuple(sizes)) for part in parts]
        signal = np.arctan2(*made) if len(made) == 2 else made[0].astype(float)
    return signal, parts, held


def is_expression(table: FileTable, wanted: str | int | None) -> bool:
    """Return true if a text could be a formula of columns, and no column has that name."""
    # Characters that occur in an expression but not in names.
    signs = isinstance(wanted, str) and re.search(r"[-+*/(]", wanted) is not None
    return signs and table.match(wanted) is None


def _arguments(text: str) -> list[str]:
    """Return the two arguments of an arc tangent, or the text itself."""
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        match ast.parse(text.strip(), mode="eval").body:
            case ast.Call(func=ast.Name(id="atan2"), args=[first, second], keywords=[]):
                return [ast.unparse(first), ast.unparse(second)]
    return [text.strip()]


def _stated(table: FileTable, text: str, flag: str, columns: Iterable[str]) -> dict[str, float]:
    """Return numbers that notes of a file state as `name = value`, for the names in a formula."""
    stated: dict[str, float] = {}
    # A name with arguments is a function.
    words = {*re.findall(r"\b\w+\b(?!\s*\()", text.lower())} - {*columns, "pi"}
    for match in filter(None, (_STATED.fullmatch(note.lower()) for note in table.notes)):
        name, value = match["name"], match["value"]
        if name in words and stated.setdefault(name, float(value)) != float(value):
            wrong = f"{flag} '{text}' contains {name}, which the file states as {stated[name]:g} and {value}"
            raise UsageError(f"{table.source}: {wrong}; write the number itself.")
    return stated


def _single(columns: Sequence[Column], name: str, expression: str) -> Column:
    """Return the only column of numbers with a name; `expression` : the option and its formula."""
    if len(columns) > 1:
        listed = ", ".join(column.name for column in columns)
        raise UsageError(
            f"{columns[0].source}: there is no single column '{name}' for {expression}: {listed}; "
            "rename one in the file."
        )
    if not columns[0].is_numeric:
        holds = f"column '{columns[0].name}' of {expression} contains no numbers."
        raise UsageError(f"{columns[0].source}: {holds}")
    return columns[0]


def _unit(parts: Sequence[Formula], units: Mapping[str, str]) -> str | None:
    """Return the unit of a formula or arc tangent; empty if no column has one, None if none follows."""
    if not any(units.values()):
        return "rad" if len(parts) == 2 else ""
    unit, *others = {*units.values()}
    powers = [_power(part.tree) for part in parts]
    if others or powers[0] is None:
        return None
    if len(powers) == 2:
        return "rad" if powers[0] == powers[1] else None
    if powers[0] == 1.0:
        return None if _converts(parts[0], unit, units) else unit
    return None if powers[0] else ""


def _agreed(follows: str | None, given: str | None) -> str | None:
    """Return the unit that follows, or the given one if none follows or if it is of another quantity."""
    of_columns, asked = lab.signal_unit(follows or ""), lab.signal_unit(given or "")
    if asked is None or (of_columns is not None and of_columns.quantity == asked.quantity):
        return follows
    return given


def _converts(formula: Formula, unit: str, names: Iterable[str]) -> bool:
    """Return true if the factor of a formula converts its unit to another one, as in `a*pi/180`."""
    of_unit = lab.signal_unit(unit)
    table = RADIANS if of_unit and of_unit.position == "rad" else METRES
    if of_unit is None or (table is METRES and of_unit.position not in METRES):
        return False
    size = of_unit.factor * (METRES[of_unit.position] if table is METRES else 1.0)
    with np.errstate(all="ignore"):
        ends = [float(formula.evaluate(dict.fromkeys(names, at))) for at in (0.0, 1.0)]
    factor = abs(ends[1] - ends[0])
    others = (size / other for other in table.values())
    return abs(factor - 1.0) > CONVERTED and any(abs(factor / other - 1.0) < CONVERTED for other in others)


def _power(tree: ast.AST) -> float | None:
    """Return the power of the columns' unit in a formula, 0 for a number; None if it has no power."""
    match tree:
        case ast.Constant() | ast.Name(id="pi"):
            return 0.0
        case ast.Name():
            return 1.0
        case ast.UnaryOp(operand=operand):
            return _power(operand)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() | float() as exponent)):
            base = _power(left)
            return None if base is None else base * float(exponent)
        case ast.BinOp(left=left, op=op, right=right):
            name, args = type(op).__name__, [left, right]
        case ast.Call(func=ast.Name(id=name), args=args):
            pass
        case _:
            return None
    powers = [power for power in map(_power, args) if power is not None]
    if len(powers) < len(args) or name == "Pow":
        return None
    if name in ("Mult", "Div"):
        return powers[0] - powers[1] if name == "Div" else powers[0] + powers[1]
    if name in ("Add", "Sub", "abs", "min", "max"):
        # A number that is added to a column has the unit of the column.
        others = {*powers} - {0.0}
        return None if len(others) > 1 else next(iter(others), 0.0)
    if name == "sqrt":
        return 0.5 * powers[0]
    return 0.0 if powers[0] == 0.0 or name == "sign" else None
