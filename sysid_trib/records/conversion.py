"""Factors between units of one kind, such as m and mm, kN and N, mN m and N*m."""

import re
from collections import Counter

from sysid_trib.records.units import ANGLE_UNITS, POSITION_UNITS, RADIANS, STANDARD_GRAVITY

# A size, and powers of kg, m, s, A and rad.
Parsed = tuple[float, dict[str, int]]
PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
NEWTON = {"kg": 1, "m": 1, "s": -2}
VOLT = {"kg": 1, "m": 2, "s": -3, "A": -1}
# Units that have prefixes: sizes in SI, and powers of what they are made of.
WITH_PREFIXES: dict[str, Parsed] = {
    "m": (1.0, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "g": (1e-3, {"kg": 1}),
    "A": (1.0, {"A": 1}),
    "N": (1.0, NEWTON),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "V": (1.0, VOLT),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "Hz": (1.0, {"s": -1}),
    "rad": (1.0, {"rad": 1}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
}
# Units that have none.
WITHOUT_PREFIXES: dict[str, Parsed] = {
    "min": (60.0, {"s": 1}),
    "in": (0.0254, {"m": 1}),
    "lbf": (4.4482216152605, NEWTON),
    "kgf": (STANDARD_GRAVITY, NEWTON),
    "gf": (1e-3 * STANDARD_GRAVITY, NEWTON),
    # The unit g of signals, not a gram.
    "g": (STANDARD_GRAVITY, {"m": 1, "s": -2}),
    "mg": (1e-3 * STANDARD_GRAVITY, {"m": 1, "s": -2}),
    "rpm": (RADIANS["rev"] / 60.0, {"rad": 1, "s": -1}),
    **{name: (size, {"rad": 1}) for name, size in RADIANS.items() if name != "rad"},
}
# Names that are written out.
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
        In any usual spelling, products with `*`, a dot or a blank, quotients with `/`; capitals count.
    """
    if given.strip() == wanted.strip():
        return 1.0
    pair = _parsed(given), _parsed(wanted)
    if pair[0] is None or pair[1] is None or pair[0][1] != pair[1][1]:
        return None
    return pair[0][0] / pair[1][0]


def _parsed(text: str) -> Parsed | None:
    """Parse a unit into its size and powers; None of one that is not known."""
    # `N-m` is a product.
    text = re.sub(r"(?<=[^\W\d_])-(?=[^\W\d_])", "*", text)
    over = text.replace("μ", "µ").replace("²", "^2").replace("**", "^").replace("(", " ").replace(")", " ")
    numerator, *denominators = over.split("/")
    size, powers = 1.0, Counter[str]()
    for part, sign in ((numerator, 1), *((part, -1) for part in denominators)):
        for factor in filter(None, re.split(r"[\s*·⋅.]+", part)):
            if factor == "1":
                continue
            match = _FACTOR.fullmatch(factor)
            known = _known(match[1]) if match else None
            if match is None or known is None:
                return None
            exponent = sign * int(match[2] or 1)
            size *= known[0] ** exponent
            powers.update({name: exponent * power for name, power in known[1].items()})
    return size, {name: power for name, power in powers.items() if power}


def _known(name: str) -> Parsed | None:
    """Look up a unit without powers, with a prefix or without; a torque without a sign, `Nmm`, too."""
    name = SPELT.get(name.lower(), name)
    name = ANGLE_UNITS.get(name.lower(), POSITION_UNITS.get(name.lower(), name) if len(name) > 2 else name)
    if name in WITHOUT_PREFIXES:
        return WITHOUT_PREFIXES[name]
    if name in WITH_PREFIXES:
        return WITH_PREFIXES[name]
    if name[:1] in PREFIXES and name[1:] in WITH_PREFIXES:
        size, powers = WITH_PREFIXES[name[1:]]
        return PREFIXES[name[0]] * size, powers
    torque = re.fullmatch(r"([numµkM]?N)([mc]?m)", name)
    return _parsed(" ".join(torque.groups())) if torque else None
