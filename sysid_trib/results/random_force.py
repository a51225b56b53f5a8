"""The random force of an identification, in every unit."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

DENSITY_UNITS = "(rad/s^2)^2/Hz"
# Significance level of a random force, and of its dependence on the motion or on time.
DEPENDENCE_LEVEL = 0.01


@dataclass(frozen=True)
class RandomForce:
    """White acceleration a(t) in theta'' = ... + a(t), estimated in one run.

    Attributes
    ----------
    density : float, (rad/s^2)^2/Hz
        One-sided power spectral density of the acceleration: a velocity that only this acceleration drives
        has the variance density/2 * time. 0 if the likelihood has its maximum there.
    standard_error : float, (rad/s^2)^2/Hz
        Standard error of the density; nan if the density was given or left out.
    p_value : float
        P-value of no random force, from half a chi-square (Chernoff 1954); nan if it was given or left out.
    """

    density: float = 0.0
    standard_error: float = float("nan")
    p_value: float = float("nan")

    def __bool__(self) -> bool:
        return self.density > 0.0

    def relative(self, frequency: float) -> float:
        """Return the root of the density over w^2, 1/sqrt(Hz), at a reference frequency w (rad/s)."""
        return float(np.sqrt(self.density)) / frequency**2

    def per_tau(self, frequency: float) -> float:
        """Return growth of the variance of v = theta'/w per unit of tau = w t (rad^2): density/(2 w^3)."""
        return 0.5 * self.density / frequency**3

    @staticmethod
    def density_of(per_tau: float, frequency: float) -> float:
        """Return density (rad/s^2)^2/Hz that makes v's variance grow by `per_tau` (rad^2) per unit of tau."""
        return 2.0 * per_tau * frequency**3

    def periods_to(self, size: float, frequency: float) -> float:
        """Return the periods after which a known motion is uncertain by `size` (rad, RMS).

        Half of the variance growth of v appears in x: its variance is per_tau * tau / 2. Infinite without a
        random force.
        """
        growth = self.per_tau(frequency)
        return float(np.inf) if growth == 0.0 else 2.0 * size**2 / growth / (2.0 * np.pi)


def random_force_of(result: xr.Dataset, run: int | None = None) -> RandomForce:
    """Return the random force of an identification, in one run or as the mean; None if it states none."""
    if "random_force_density" not in result:
        return RandomForce()
    of_run = run is not None and "run_random_force_density" in result
    names = ("random_force_density", "random_force_standard_error", "random_force_p_value")
    values = (result[f"run_{name}"].values[run] if of_run else result[name].item() for name in names)
    return RandomForce(*(float(value) for value in values))


def is_found(force: RandomForce) -> bool:
    """Return true if a random force is significant or given."""
    return bool(force) and not force.p_value >= DEPENDENCE_LEVEL
