"""A random force in the motion: white acceleration, its size in every unit that is asked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import xarray as xr
from scipy.stats import chi2

from sysid_trib.errors import UsageError
from sysid_trib.likelihood.variance_ratio import VarianceRatio
from sysid_trib.results.variables import Variables, variable

# What a method is asked to do: estimate the random force, leave it out, or take this one-sided density.
# `auto` leaves it to `identify` and the commands, which decide by what the record tells; the method alone
# takes none then.
RandomForceOption: TypeAlias = Literal["auto", "estimated", "off"] | float
OPTIONS = ("auto", "estimated", "off")
DENSITY_UNITS = "(rad/s^2)^2/Hz"


@dataclass(frozen=True)
class RandomForce:
    """White acceleration a(t) in theta'' = ... + a(t), as it was estimated in one run.

    Attributes
    ----------
    density : float, (rad/s^2)^2/Hz
        One-sided power spectral density of the acceleration: a velocity that it alone drives has the variance
        density/2 * time. 0 where the maximum of the likelihood is there.
    standard_error : float, (rad/s^2)^2/Hz
        Of the density; nan where it was given, or left out.
    p_value : float
        Of no random force, by half a chi-square (Chernoff 1954); nan where it was given, or left out.
    """

    density: float = 0.0
    standard_error: float = float("nan")
    p_value: float = float("nan")

    def __bool__(self) -> bool:
        return self.density > 0.0

    @staticmethod
    def p_value_of_gain(gain: float) -> float:
        """p-value of no random force, where one lowers the deviance by `gain` (Chernoff 1954)."""
        return 0.5 * float(chi2.sf(gain, 1)) if gain > 0.0 else 1.0

    def relative(self, frequency: float) -> float:
        """Root of the density over w^2, 1/sqrt(Hz), at a reference frequency w (rad/s)."""
        return float(np.sqrt(self.density)) / frequency**2

    def per_tau(self, frequency: float) -> float:
        """Growth of the variance of v = theta'/w by a unit of tau = w t (rad^2): density/(2 w^3)."""
        return 0.5 * self.density / frequency**3

    @staticmethod
    def density_of(per_tau: float, frequency: float) -> float:
        """Density (rad/s^2)^2/Hz that makes the variance of v grow by `per_tau` (rad^2) a unit of tau."""
        return 2.0 * per_tau * frequency**3

    def periods_to(self, size: float, frequency: float) -> float:
        """Periods after which a motion that is known now has wandered by `size` (rad, RMS).

        Half of the growth of v is in x: its variance is per_tau * tau / 2. Infinite without a random force.
        """
        growth = self.per_tau(frequency)
        return float(np.inf) if growth == 0.0 else 2.0 * size**2 / growth / (2.0 * np.pi)


def check_random_force(option: RandomForceOption) -> None:
    """Refuse what is neither a word of `OPTIONS`, nor a density.

    Raises
    ------
    UsageError
        Another word, or a density that is negative or not finite.
    """
    if isinstance(option, str):
        if option not in OPTIONS:
            raise UsageError(f"random_force='{option}' is none of {', '.join(OPTIONS)}, and no density.")
    elif not (np.isfinite(option) and option >= 0.0):
        raise UsageError(f"random_force={option} is no density; give {DENSITY_UNITS}, 'auto' or 'off'.")


def is_fitted(option: RandomForceOption) -> bool:
    """True if a method itself has a random force besides the sensor's noise."""
    return option not in ("auto", "off")


def random_force_of_ratio(ratio: VarianceRatio, frequency: float, option: RandomForceOption) -> RandomForce:
    """The random force in SI units, tau = `frequency` t; as it was given where `option` is a density."""
    if not isinstance(option, str):
        return RandomForce(float(option))
    density = RandomForce.density_of(ratio.ratio * ratio.variance, frequency)
    error = density * ratio.relative_error
    if density == 0.0:
        error = RandomForce.density_of(ratio.upper * ratio.variance, frequency)
    return RandomForce(density, error, ratio.p_value)


def random_force_variables(forces: Sequence[RandomForce]) -> Variables:
    """The random force of each run as variables of a result: their mean, and each where there are several."""
    densities = np.array([force.density for force in forces])
    errors = np.array([force.standard_error for force in forces])
    p_values = np.array([force.p_value for force in forces])
    mean_error = np.sqrt(np.sum(errors**2)) / len(forces)
    least = np.minimum(1.0, len(forces) * np.min(p_values))
    names = {
        "random_force_density": (densities.mean(), densities, "one-sided density of the random force"),
        "random_force_standard_error": (mean_error, errors, "standard error of that density"),
        "random_force_p_value": (least, p_values, "p-value of no random force"),
    }
    variables = {}
    for name, (mean, of_runs, text) in names.items():
        units = "1" if name.endswith("p_value") else DENSITY_UNITS
        variables[name] = variable((), float(mean), text, units)
        if len(forces) > 1:
            variables[f"run_{name}"] = variable("run", of_runs, f"{text} in the run", units)
    return variables


def random_force_of(result: xr.Dataset, run: int | None = None) -> RandomForce:
    """The random force of an identification, in one run or on the mean; none where it has no word of one."""
    if "random_force_density" not in result:
        return RandomForce()
    of_run = run is not None and "run_random_force_density" in result
    names = ("random_force_density", "random_force_standard_error", "random_force_p_value")
    values = (result[f"run_{name}"].values[run] if of_run else result[name].item() for name in names)
    return RandomForce(*(float(value) for value in values))
