"""Values of options as the command line writes them: numbers in their ranges, windows, values with errors."""

import re
from math import isfinite

from sysid_trib.commands.options import POSITIVE
from sysid_trib.errors import UsageError

PLUS_MINUS = re.compile(r"\s*(?:±|\+/-|\+-)\s*")


def check_between(value: float | None, option: str, low: float, high: float, units: str = "") -> None:
    """Refuse a number outside of a range, or none, by the name of its option."""
    if value is not None and not low <= value <= high:
        raise UsageError(f"{option} '{value:g}' must be a number from {low:g} to {high:g}{units}.")


def parse_window(
    text: str, option: str, form: str = "START:STOP in seconds, such as 15:75, 25: or :60"
) -> tuple[float | None, float | None]:
    """`15:75`; either side may be empty. `form` says how it is written."""
    sides = text.split(":")
    if len(sides) != 2:
        raise UsageError(f"{option} '{text}' must be {form}.")
    low, high = (parse_number(side, option) if side.strip() else None for side in sides)
    return low, high


def parse_value_with_error(text: str | None, option: str) -> tuple[float, float] | None:
    """`8.87`, `8.87±0.01` or `8.87+-0.01`."""
    if text is None:
        return None
    parts = PLUS_MINUS.split(text.strip())
    if len(parts) > 2:
        raise UsageError(f"{option} '{text}' must be VALUE or VALUE±ERROR.")
    value = parse_number(parts[0], option)
    error = parse_number(parts[1], option) if len(parts) == 2 else 0.0
    check_between(value, option, *POSITIVE)
    if not 0.0 <= error <= value:
        raise UsageError(f"{option} '{text}': the error must be positive and below the value.")
    return value, error


def assigned(texts: list[str], refusal: str) -> dict[str, float]:
    """Values by name of `NAME=VALUE,...`; the refusal takes what is no such pair."""
    values: dict[str, float] = {}
    for setting in (part for text in texts for part in text.split(",")):
        name, equals, value = (part.strip() for part in setting.partition("="))
        if not equals or not name:
            raise UsageError(refusal.format(setting))
        values[name] = parse_number(value, f"--set {name}")
    return values


def parse_number(text: str, option: str) -> float:
    """A finite number, or a sentence that names the option."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise UsageError(f"{option}: '{text.strip()}' is not a finite number.")
    return value
