"""Factors between units of one kind, such as m and mm, kN and N, mN m and N*m."""

import re
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from sysid_trib.records.unit_tables import ANGLE_UNITS, POSITION_UNITS, RADIANS, STANDARD_GRAVITY


class UnitSize(NamedTuple):
    """Size of a unit in SI units, and its powers of kg, m, s, A and rad."""

    size: float
    powers: Mapping[str, int]


PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
NEWTON = {"kg": 1, "m": 1, "s": -2}
VOLT = {"kg": 1, "m": 2, "s": -3, "A": -1}
# Units with prefixes: sizes in SI, and powers of their base units.
WITH_PREFIXES: dict[str, UnitSize] = {
    "m": UnitSize(1.0, {"m": 1}),
    "s": UnitSize(1.0, {"s": 1}),
    "g": UnitSize(1e-3, {"kg": 1}),
    "A": UnitSize(1.0, {"A": 1}),
    "N": UnitSize(1.0, NEWTON),
    "Pa": UnitSize(1.0, {"kg": 1, "m": -1, "s": -2}),
    "J": UnitSize(1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": UnitSize(1.0, {"kg": 1, "m": 2, "s": -3}),
    "V": UnitSize(1.0, VOLT),
    "T": UnitSize(1.0, {"kg": 1, "s": -2, "A": -1}),
    "Hz": UnitSize(1.0, {"s": -1}),
    "rad": UnitSize(1.0, {"rad": 1}),
    "bar": UnitSize(1e5, {"kg": 1, "m": -1, "s": -2}),
}
# Units without prefixes.
WITHOUT_PREFIXES: dict[str, UnitSize] = {
    "min": UnitSize(60.0, {"s": 1}),
    "in": UnitSize(0.0254, {"m": 1}),
    "lbf": UnitSize(4.4482216152605, NEWTON),
    "kgf": UnitSize(STANDARD_GRAVITY, NEWTON),
    "gf": UnitSize(1e-3 * STANDARD_GRAVITY, NEWTON),
    # The unit g of signals is gravity, not a gram.
    "g": UnitSize(STANDARD_GRAVITY, {"m": 1, "s": -2}),
    "mg": UnitSize(1e-3 * STANDARD_GRAVITY, {"m": 1, "s": -2}),
    "rpm": UnitSize(RADIANS["rev"] / 60.0, {"rad": 1, "s": -1}),
    **{name: UnitSize(size, {"rad": 1}) for name, size in RADIANS.items() if name != "rad"},
}
# Names that are spelt out.
SPELT = {
    "newton": "N",
    "newtons": "N",
    "ampere": "A",
    "amperes": "A",
    "amps": "A",
    "pascal": "Pa",
    "watt": "W",
}
_FACTOR = re.compile(r"([^\W\d_]+|°|[µ][^\W\d_]+)(?:\^?(-?\d))?")


def factor_between(given: str, wanted: str) -> float | None:
    """Return the factor from one unit to another; None if they are of different kinds.

    Parameters
    ----------
    given, wanted : str
        Units in any usual spelling: products with `*`, a dot or a blank, quotients with `/`; case matters.
    """
    if given.strip() == wanted.strip():
        return 1.0
    first = _parsed(given)
    second = _parsed(wanted)
    if first is None or second is None or first.powers != second.powers:
        return None
    return first.size / second.size


def _parsed(text: str) -> UnitSize | None:
    """Parse a unit into its size and powers; return None if it is unknown."""
    # `N-m` is a product.
    text = re.sub(r"(?<=[^\W\d_])-(?=[^\W\d_])", "*", text)
    over = text.replace("μ", "µ").replace("²", "^2").replace("**", "^").replace("(", " ").replace(")", " ")
    numerator, *denominators = over.split("/")
    size = 1.0
    powers = Counter[str]()
    for part, sign in ((numerator, 1), *((part, -1) for part in denominators)):
        for factor in filter(None, re.split(r"[\s*·⋅.]+", part)):
            if factor == "1":
                continue
            match = _FACTOR.fullmatch(factor)
            known = _known(match[1]) if match else None
            if match is None or known is None:
                return None
            exponent = sign * int(match[2] or 1)
            size *= known.size**exponent
            powers.update({name: exponent * power for name, power in known.powers.items()})
    return UnitSize(size, {name: power for name, power in powers.items() if power})


def _known(name: str) -> UnitSize | None:
    """Look up a unit without powers, with or without a prefix, also a torque without a sign, `Nmm`."""
    name = SPELT.get(name.lower(), name)
    name = ANGLE_UNITS.get(name.lower(), POSITION_UNITS.get(name.lower(), name) if len(name) > 2 else name)
    if name in WITHOUT_PREFIXES:
        return WITHOUT_PREFIXES[name]
    if name in WITH_PREFIXES:
        return WITH_PREFIXES[name]
    if name[:1] in PREFIXES and name[1:] in WITH_PREFIXES:
        size, powers = WITH_PREFIXES[name[1:]]
        return UnitSize(PREFIXES[name[0]] * size, powers)
    torque = re.fullmatch(r"([numµkM]?N)([mc]?m)", name)
    return _parsed(" ".join(torque.groups())) if torque else None
