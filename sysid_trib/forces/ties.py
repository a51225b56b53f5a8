"""What texts say of parameters: values, ranges, and ties by the whitelist of force formulas."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.formulas import SMOOTH, SWITCHING, Formula, parse

# A word, with the shape parameter behind a point: not the exponent of a number such as 1e-3.
WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?", re.ASCII)
PARAMETER = re.compile(r"[A-Za-z]\w*(\.[A-Za-z_]\w*)?", re.ASCII)


@dataclass(frozen=True)
class Tie:
    """One parameter as a function of others.

    Parameters
    ----------
    name : str
        The parameter that is tied.
    text : str
        The formula as written.
    formula : Formula
        The formula over stand-ins of the parameters' names, which need not be words of Python.
    names : tuple of str
        The parameters it holds; the stand-in of the first is `p0`.
    """

    name: str
    text: str
    formula: Formula
    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.name}={self.text}"

    def value(self, values: Mapping[str, float]) -> float:
        """Value at the given parameters; nan where it has none.

        Parameters
        ----------
        values : mapping of str to float
            Value of each parameter that the formula holds.
        """
        with np.errstate(all="ignore"):
            value = float(self.formula.evaluate(self._stand_ins(values)))
        return value if np.isfinite(value) else np.nan

    def derivatives(self, values: Mapping[str, float]) -> dict[str, float]:
        """Derivative by each parameter that the formula holds.

        Parameters
        ----------
        values : mapping of str to float
            Value of each of these parameters.
        """
        given = self._stand_ins(values)
        with np.errstate(all="ignore"):
            slopes = [float(self.formula.derivative(given, stand_in)) for stand_in in given]
        return dict(zip(self.names, slopes, strict=True))

    def linear(self, known: Mapping[str, float] | None = None) -> tuple[float, dict[str, float]] | None:
        """Constant and factor of each parameter, if the formula is linear; else None.

        Parameters
        ----------
        known : mapping of str to float, optional
            Values of parameters that count as constants.
        """
        variable = [name for name in self.names if name not in (known or {})]

        def value(numbers: NDArray[np.float64]) -> float:
            return self.value({**(known or {}), **dict(zip(variable, numbers.tolist(), strict=True))})

        constant = value(np.zeros(len(variable)))
        slopes = np.array([value(unit) - constant for unit in np.eye(len(variable))])
        random = np.random.default_rng(20190417)
        shape = (16, len(variable))
        points = random.choice((-1.0, 1.0), shape) * random.uniform(1e-3, 30.0, shape)
        # Known by what it does: a formula of any form may be linear.
        same = np.isclose([value(point) for point in points], constant + points @ slopes, rtol=1e-9)
        return (constant, dict(zip(variable, slopes.tolist(), strict=True))) if same.all() else None

    def _stand_ins(self, values: Mapping[str, float]) -> dict[str, np.float64]:
        return {f"p{i}": np.float64(values[name]) for i, name in enumerate(self.names)}


def parse_tie(name: str, text: str, known: Sequence[str]) -> Tie:
    """Read a tie.

    Parameters
    ----------
    name : str
        The parameter that is tied.
    text : str
        Its formula.
    known : sequence of str
        Parameters that the formula may hold.

    Raises
    ------
    UsageError
        The formula holds another name, the tied parameter itself, or is not of the whitelist.
    """
    words = list(dict.fromkeys(WORD.findall(text)))
    names = tuple(word for word in words if word in known)
    strangers = [word for word in words if word not in (*names, "pi", *SWITCHING, *SMOOTH)]
    if strangers:
        raise UsageError(
            f"The tie '{name}={text}' holds '{strangers[0]}', which is no parameter; "
            f"there are {', '.join(known)}."
        )
    if name in names:
        raise UsageError(f"The tie '{name}={text}' ties {name} to itself; use other parameters.")
    stand_ins = {word: f"p{i}" for i, word in enumerate(names)}
    replaced = WORD.sub(lambda word: stand_ins.get(word[0], word[0]), text)
    shapes = frozenset(p for word, p in stand_ins.items() if "." in word)
    try:
        formula = parse(replaced, frozenset(stand_ins.values()), shapes, name)
    except LibraryError:
        raise UsageError(
            f"The tie '{name}={text}' is not a formula of numbers, parameters, + - * / ** and the functions "
            f"{' '.join((*SWITCHING, *SMOOTH))}."
        ) from None
    return Tie(name, text, formula, names)


def parse_pairs(texts: Iterable[str], option: str, example: str) -> dict[str, str]:
    """Names and values of texts `NAME=VALUE` of an option."""
    pairs: dict[str, str] = {}
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not value or not PARAMETER.fullmatch(name):
            raise UsageError(f"{option} '{text}' must be of the form {example}.")
        if name in pairs:
            raise UsageError(f"{option} is given twice for {name}; choose one.")
        pairs[name] = value
    return pairs


def parse_range(text: str, where: str) -> tuple[float, float]:
    """Both ends of `LOW:HIGH`, infinite where left out."""
    low, sign, high = (part.strip() for part in text.partition(":"))
    if not sign or not (low or high):
        raise UsageError(f"{where} must be LOW:HIGH, of which one side may be empty.")
    return parse_number(low, where) if low else -np.inf, parse_number(high, where) if high else np.inf


def parse_number(text: str, where: str) -> float:
    """A number, refused with where it stands."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{where}: '{text}' is not a number.") from None
