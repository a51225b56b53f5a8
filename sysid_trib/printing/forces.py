"""The forces of a library as a table."""

from fractions import Fraction
from math import pi

import numpy as np
from rich.table import Table

from sysid_trib.arrays import Array
from sysid_trib.averaging.signatures import averages, dissipated_power
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.printing.layout import text_table


def force_table(library: ForceLibrary) -> Table:
    """Forces of a library with what is derived from their formulas."""
    heads = ["symbol", "name", "formula", "parity", "type", "unit"]
    heads += ["<h sin phi>", "<h cos phi>", "loses power"]
    rows = []
    for force in library:
        power = "-" if force.kind == "sensor" else loses_power(force)
        unit = "" if force.units == "1" else force.units
        words = [force.symbol, force.name, force.formula.text, force.parity, force.character, unit]
        rows.append([*words, *signature_text(force), power])
    return text_table(heads, rows, whole=(0, 6, 7))


def signature_text(force: Force) -> tuple[str, str]:
    """The signature as a closed form where it is one term, else its values at two amplitudes."""
    sine, cosine = averages(force, np.array([0.1, 1.0]), None, 1.0 if force.holds_time else 0.0)
    return _average_text(sine, force.degree), _average_text(cosine, force.degree)


def _average_text(average: Array, degree: float | None) -> str:
    small, unit = average.tolist()
    if np.max(np.abs(average)) < 1e-13:
        return "0"
    return f"{small:.3g}, {unit:.3g} (a = 0.1, 1)" if degree is None else _term(unit, degree)


def _term(value: float, degree: float) -> str:
    number = _closed(value)
    if degree == 0:
        return number
    power = "a" if degree == 1 else f"a^{degree:g}"
    return number.replace("1", power) if number in ("1", "-1") else f"{number} {power}"


def _closed(value: float) -> str:
    for unit, name in ((1.0, ""), (1.0 / pi, "/pi")):
        fraction = Fraction(value / unit).limit_denominator(64)
        if fraction and abs(float(fraction) - value / unit) < 1e-12 * abs(value / unit):
            over = fraction.denominator
            if not name:
                return str(fraction)
            return f"{fraction.numerator}/pi" if over == 1 else f"{fraction.numerator}/({over} pi)"
    return f"{value:.4g}"


def loses_power(force: Force) -> str:
    """Whether a positive coefficient takes energy out, at the amplitudes at which a pendulum swings."""
    power = dissipated_power(force, np.array([0.05, 0.3, 1.0]), None, time=1.0)
    if np.all(np.abs(power) < 1e-13):
        return "no"
    return "yes" if np.all(power > -1e-13) else "gains power" if np.all(power < 1e-13) else "by amplitude"
