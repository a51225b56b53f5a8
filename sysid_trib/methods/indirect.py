"""Indirect inference: the bias of a simplified model is what it gets wrong on motions of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.scope import Method, scope_of
from sysid_trib.noise.level import sensor_noise
from sysid_trib.records.runs import Decays
from sysid_trib.results.birge import birge_ratio
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.variables import variable
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.initial_conditions import first_guess, fit_start

MAX_CORRECTIONS = 20
# Steps that end the correction: of the standard errors, or of the values where there is next to no noise.
SETTLED_ERRORS, SETTLED_VALUES = 1e-3, 1e-9


@dataclass(frozen=True)
class AuxiliaryFit:
    """Least squares of an auxiliary model on envelopes.

    Attributes
    ----------
    values : (value,) array of float
        Coefficients and, last, the frequency (rad/s).
    residuals : Mapping of str to list of array
        Of each group of equations, in each run.
    degrees_of_freedom : Mapping of str to int
        Of each group's residuals.
    chi_square : callable
        Chi-square of residuals of a group, given its name and the residuals.
    covariance : callable
        Covariance of the values, (value, value); each group's errors are multiplied by its number.
    """

    values: Array
    residuals: Mapping[str, Sequence[Array]]
    degrees_of_freedom: Mapping[str, int]
    chi_square: Callable[[str, Sequence[Array]], float]
    covariance: Callable[[Mapping[str, float]], Array]

    def birge_ratio(self, *groups: str) -> float:
        """Root of the reduced chi-square of some groups."""
        total = sum(self.chi_square(group, self.residuals[group]) for group in groups)
        return birge_ratio(total, sum(self.degrees_of_freedom[group] for group in groups))

    def error_factors(self) -> dict[str, float]:
        """The Birge ratio of each group, by which errors are raised; at least 1."""
        return {group: max(1.0, self.birge_ratio(group)) for group in self.residuals}


@dataclass(frozen=True)
class AuxiliaryModel:
    """A simplified model of the envelope of a decay, quick to fit, and biased.

    Attributes
    ----------
    measure : callable
        Envelope of a decay (see `envelope`).
    fit : callable
        `AuxiliaryFit` of the envelopes of all runs.
    library : ForceLibrary
        The forces of the coefficients, for motions of its own.
    shapes : Mapping of str to float
        Shape parameters of these forces.
    """

    measure: Callable[[xr.Dataset], xr.Dataset]
    fit: Callable[[Sequence[xr.Dataset]], AuxiliaryFit]
    library: ForceLibrary
    shapes: Mapping[str, float] = field(default_factory=dict)

    def model(self, values: Array) -> Model:
        """The model of coefficients and, last, the frequency (rad/s)."""
        coefficients = dict(zip(self.library.symbols, values[:-1].tolist(), strict=True))
        return Model(self.library, coefficients, float(values[-1]), self.shapes)


@dataclass(frozen=True)
class IndirectEstimate:
    """Values of an auxiliary model without their bias.

    Attributes
    ----------
    values, bias : (value,) array of float
        Coefficients and, last, the frequency (rad/s); what was taken off them.
    covariance : (value, value) array of float
        Scaled by the Birge ratios.
    noises : list of float, rad
        The sensor's, of each run.
    birge_ratios : Mapping of str to float
        Of each group of equations.
    birge_ratio : float
        Of all.
    bias_removed : str
        `yes`, or `no` and why.
    """

    values: Array
    bias: Array
    covariance: Array
    noises: Sequence[float]
    birge_ratios: Mapping[str, float]
    birge_ratio: float
    bias_removed: str


def indirect_estimate(
    auxiliary: AuxiliaryModel, decays: Sequence[xr.Dataset], *, correct: bool
) -> IndirectEstimate:
    """Fit an auxiliary model to decays, and remove its bias by indirect inference.

    Parameters
    ----------
    auxiliary : AuxiliaryModel
        What is fitted.
    decays : sequence of Dataset
        The runs.
    correct : bool
        Whether the bias is removed.

    Notes
    -----
    The model of the values is simulated from the fitted start, the auxiliary model is fitted to its motion as
    to the record, and what that got wrong is subtracted, until nothing moves (Gourieroux et al. 1993).
    """
    measured = [auxiliary.measure(decay) for decay in decays]
    first = auxiliary.fit(measured)
    values, last, bias_removed = first.values, first, "no"
    if correct:
        try:
            values, last = _corrected(auxiliary, decays, measured, first)
            bias_removed = "yes"
        except (SysidTribError, np.linalg.LinAlgError) as error:
            bias_removed = f"no: {error}"
    return IndirectEstimate(
        values,
        first.values - values,
        first.covariance(last.error_factors()),
        [sensor_noise(decay) for decay in decays],
        {group: last.birge_ratio(group) for group in last.residuals},
        last.birge_ratio(*last.residuals),
        bias_removed,
    )


def _corrected(
    auxiliary: AuxiliaryModel,
    decays: Sequence[xr.Dataset],
    measured: Sequence[xr.Dataset],
    first: AuxiliaryFit,
) -> tuple[Array, AuxiliaryFit]:
    """Values whose motions give the same fit as the records; the fit of these motions.

    Its residuals are those of the records beyond those of the motions.

    Raises
    ------
    SysidTribError
        A motion cannot be computed or measured, or the values do not settle.
    """
    frequency = float(first.values[-1])
    beginnings = [_first_swings(decay, frequency) for decay in decays]
    starts = [first_guess(*part, frequency) for part in beginnings]
    errors = np.sqrt(np.diag(first.covariance(first.error_factors())))
    settled = SETTLED_ERRORS * errors + SETTLED_VALUES * np.abs(first.values)
    values = first.values
    for _ in range(MAX_CORRECTIONS):
        model = auxiliary.model(values)
        simulated = []
        for decay, part, start, envelope in zip(decays, beginnings, starts, measured, strict=True):
            motion = fit_start(model, *part, start, offset=None)
            time = decay.time.values.astype(float)
            angle = trajectory(model, time, motion.angle, motion.rate).angle
            again = auxiliary.measure(xr.Dataset({"angle": ("time", angle)}, {"time": time}))
            simulated.append(_as_measured(again, envelope))
        fit = auxiliary.fit(simulated)
        step = first.values - fit.values
        values = values + step
        if np.all(np.abs(step) <= settled):
            # What the auxiliary model leaves of a motion of its own is no sign of another force.
            residuals = {
                group: [
                    old[: len(new)] - new[: len(old)]
                    for old, new in zip(first.residuals[group], fit.residuals[group], strict=True)
                ]
                for group in first.residuals
            }
            return values, replace(fit, residuals=residuals)
    raise SysidTribError("the correction did not settle")


def _first_swings(decay: xr.Dataset, frequency: float) -> tuple[Array, Array]:
    """Two periods fix the start; a model that is still biased may slip out of phase later."""
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    count = int(np.searchsorted(time, time[0] + 4.0 * np.pi / frequency)) + 1
    return time[:count], angle[:count]


def _as_measured(simulated: xr.Dataset, measured: xr.Dataset) -> xr.Dataset:
    """The simulated envelope at the record's half periods and with its standard errors."""
    shift = int(np.argmin(np.abs(simulated.extremum_time.values - measured.extremum_time.values[0])))
    count = min(measured.sizes["half_period"], simulated.sizes["half_period"] - shift)
    part = simulated.isel(half_period=slice(shift, shift + count), instant=slice(shift, shift + count - 2))
    names = ["extremum_standard_error", "extremum_time_standard_error"]
    return part.assign(measured[names].isel(half_period=slice(0, count)).data_vars)


def as_identification(
    method: Method, decay: Decays, asked: ForceLibrary, indirect: IndirectEstimate, offered: ForceLibrary
) -> xr.Dataset:
    """An indirect estimate as an identification, with its bias and what the method assumes."""
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (indirect.birge_ratio, "1", "Birge ratio of the equations")
    }
    for group, value in indirect.birge_ratios.items():
        if group:
            extra[f"{group}_birge_ratio"] = (value, "1", f"Birge ratio of the {group}'s equations alone")
    estimate = Estimate(
        indirect.values[:-1], indirect.covariance, float(indirect.values[-1]), indirect.noises, extra
    )
    result = identification(method, decay, asked, estimate, offered=offered)
    result["first_order_bias"] = variable("force", indirect.bias[:-1], "first-order bias removed", "1")
    assumes = scope_of(method).assumes
    return result.assign_attrs(first_order_bias_removed=indirect.bias_removed, assumes=assumes)
