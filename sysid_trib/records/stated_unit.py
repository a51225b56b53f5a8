"""Unit of a signal: as the user says, as the file says, or as its numbers let one assume."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.assumed_units import assumed_unit, circle_radius
from sysid_trib.records.columns import Chosen
from sysid_trib.records.headers import as_written, names_quantity, split_header
from sysid_trib.records.notes import noted_unit
from sysid_trib.records.reading import Reading
from sysid_trib.records.tables import FileTable
from sysid_trib.records.units import (
    ACCELEROMETER,
    OFFERED_ANGLES,
    OFFERED_UNITS,
    SignalUnit,
    plain_unit,
    signal_unit,
)

LARGEST_AMPLITUDE = 4.0 * np.pi


def stated_unit(
    table: FileTable, columns: Chosen, how: Reading, time: Array, values: Array, source: str
) -> tuple[SignalUnit, str]:
    """Unit of the signal, and why that one where neither user nor file says it.

    Parameters
    ----------
    table : FileTable
    columns : Chosen
    how : Reading
    time, values : (sample,) array of float, s and as in the file
        The signal, without bad samples.
    source : str
        Of whom sentences speak.

    Raises
    ------
    UsageError
        The header says another unit, or another quantity, than the user.
    RecordError
        An amplitude that no oscillation has in this unit.
    """
    name = columns.signal
    # What an accelerometer feels is in the units of an acceleration.
    signal = "acceleration" if how.signal == ACCELEROMETER else how.signal
    base, in_header = table.made.get(name) or split_header(name)
    in_header = as_written(name, in_header)
    stated = signal_unit(table.units.get(name, "") or in_header or noted_unit(table.notes))
    given = None if how.units is None else signal_unit(how.units)
    if given and how.signal and given.quantity in ("angle", "displacement") and how.signal != given.quantity:
        # "deg" of a rate is deg/s.
        given = SignalUnit(given.text, how.signal, given.position, given.factor, given.known)
    if given and stated and stated.known and _differs(stated, given):
        known = "" if given.known else f", which is none of those that are known ({OFFERED_UNITS})"
        raise UsageError(
            f"{source}: the header of column {name} says {stated.text}, but --units says {how.units} (units= "
            f"in Python){known}; leave the option out or correct the header."
        )
    if given and not given.known and given.quantity == "angle":
        # In whatever it is, no coefficient would have its size.
        raise UsageError(
            f"{source}: --units '{how.units}' (units= in Python) is no unit of an angle that is known; give "
            f"{OFFERED_ANGLES}."
        )
    unit, why = given or stated, ""
    if unit is None:
        meant = signal or names_quantity(base) or how.usual
        unit, why = assumed_unit(base, time, values, circle_radius(table, name), meant)
    if signal is not None and signal != unit.quantity:
        per_second = "/s" if signal == "rate" else "/s^2" if signal == "acceleration" else ""
        if unit.quantity in ("angle", "displacement") and per_second:
            unit = SignalUnit(f"{unit.text}{per_second}", signal, unit.position, unit.factor, unit.known)
        elif stated is not None and stated.known:
            raise UsageError(
                f"{source}: the header of column {name} says {stated.text}: {_article(stated.quantity)}; but "
                f"--signal says {how.signal} (signal= in Python); leave the option out."
            )
    if not unit.known:
        why = f"unit {unit.text} is none of those that are known ({OFFERED_UNITS}): coefficients are in it"
    swing = 0.5 * float(np.ptp(values)) * unit.factor
    if unit.quantity == "angle" and swing > LARGEST_AMPLITUDE and unit.text.lower().startswith("rad"):
        raise RecordError(
            f"{source}: an amplitude of {swing:.3g} rad (column {name}) is too much for an oscillation; if "
            "it is in degrees say so with --units deg (units= in Python), if it is no angle name its unit."
        )
    return unit, why


def _differs(stated: SignalUnit, given: SignalUnit) -> bool:
    same_kind = stated.position == given.position and np.isclose(stated.factor, given.factor)
    return not (
        same_kind and (stated.quantity == given.quantity or plain_unit(stated.text) == plain_unit(given.text))
    )


def _article(quantity: str) -> str:
    return f"an {quantity}" if quantity[0] in "a" else f"a {quantity}"
