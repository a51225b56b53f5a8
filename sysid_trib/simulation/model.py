"""A model: forces with coefficients, and the frequency to which the coefficients refer."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import Channel, Force, ForceLibrary, channels_of
from sysid_trib.records.inputs import FORCING_CHANNEL, INPUT, KnownInput


@dataclass(frozen=True)
class Model:
    """theta'' + w^2 theta = -w^2 sum of coefficient * h(theta, theta'/w) (Le Bot et al. 2019, Eq. 1).

    Parameters
    ----------
    library : ForceLibrary
        Forces to choose from.
    coefficients : mapping of str to float
        By symbol, dimensionless with angles in rad; forces left out are absent.
    reference_frequency : float, rad/s
        w.
    shapes : mapping of str to float
        `{"dahl.s": 0.02}`; defaults of the library where left out.
    inputs : mapping of str to KnownInput
        What drives the motion, by the names that forces hold; `input` is an acceleration (rad/s^2) on the
        right side of the equation. An input that is not given is zero.

    Raises
    ------
    UsageError
        A symbol or shape parameter that the library does not have.
    LibraryError
        A coefficient or frequency that is not a finite number (the frequency: positive).
    """

    library: ForceLibrary
    coefficients: Mapping[str, float]
    reference_frequency: float
    shapes: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, KnownInput] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for symbol, value in self.coefficients.items():
            if not np.isfinite(value):
                raise LibraryError(f"Coefficient {symbol} = {value} of a model must be a finite number.")
            self.library[symbol]
        if not (np.isfinite(self.reference_frequency) and self.reference_frequency > 0):
            raise LibraryError(f"Reference frequency {self.reference_frequency} must be positive (rad/s).")
        check_shapes(self.shapes, self.library)

    @property
    def forces(self) -> tuple[Force, ...]:
        """Forces that act on the motion, in the library's order."""
        return tuple(f for f in self.library if f.symbol in self.coefficients and f.kind == "force")

    @property
    def sensors(self) -> tuple[Force, ...]:
        """Terms that change what is measured, not the motion."""
        return tuple(f for f in self.library if f.symbol in self.coefficients and f.kind == "sensor")

    @property
    def driven(self) -> tuple[Channel, ...]:
        """What the equation of motion holds of inputs: first one that pushes by itself, if there is one."""
        forcing = (FORCING_CHANNEL,) if INPUT in self.inputs else ()
        return (*forcing, *channels_of(self.forces))

    def with_coefficients(self, coefficients: Mapping[str, float]) -> "Model":
        """The model with other coefficients."""
        return replace(self, coefficients=dict(coefficients))


def rescaling_factors(forces: tuple[Force, ...], old: float, new: float) -> NDArray[np.float64]:
    """Factor of each coefficient when the reference frequency changes from `old` to `new` (rad/s).

    A force homogeneous of degree q in v and without states gets (old/new)^(2 - q); NaN marks the others,
    which keep their reference, terms of the sensor among them.
    """
    degrees = [np.nan if f.speed_degree is None or f.kind == "sensor" else f.speed_degree for f in forces]
    return np.asarray((old / new) ** (2.0 - np.array(degrees)))


def check_shapes(names: Iterable[str], library: ForceLibrary) -> None:
    """Refuse a shape parameter, such as `dahl.s`, that no force of the library has.

    Raises
    ------
    UsageError
        The force or the parameter does not exist.
    """
    for key in names:
        symbol, _, name = key.partition(".")
        if name not in library[symbol].shape:
            raise UsageError(f"Force '{symbol}' has no shape parameter '{name}'.")
