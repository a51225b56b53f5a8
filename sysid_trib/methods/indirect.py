"""Indirect inference: removal of the bias of a simplified model by fits to its own motions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, jacobian
from sysid_trib.errors import DecayError, SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    is_fitted,
    random_force_of_ratio,
    random_force_variables,
)
from sysid_trib.methods.auxiliary import (
    AuxiliaryModel,
    Groups,
    birge_ratios,
    random_force_ratio,
    swing_frequency,
    with_random_force,
)
from sysid_trib.methods.half_period_equations import DENSITY, ENVELOPE_ERRORS
from sysid_trib.methods.scope import Method, scope_of
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results.random_force import RandomForce
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.variables import described, variable
from sysid_trib.simulation.initial_conditions import FittedMotion, first_guess, fit_start
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.stand_in import accuracy_of
from sysid_trib.simulation.trajectory import trajectory

# Steps at which the correction has converged: relative to the standard errors, or to the values if there is
# almost no noise.
SETTLED_ERRORS, SETTLED_VALUES = 5e-3, 1e-9
# The same for smooth curves, whose basis functions are nearly collinear: their sum converges far earlier.
SETTLED_CURVES = 0.1
# Most rounds in which values and random force are estimated in turn, and the step of the density, over its
# standard error, that ends them.
DENSITY_ROUNDS, SETTLED_DENSITY = 3, 0.1


@dataclass(frozen=True)
class IndirectEstimate:
    """Values of an auxiliary model without their bias.

    Attributes
    ----------
    values, bias : (value,) array of float
        Coefficients and, last, the frequency (rad/s); and the bias subtracted from them.
    covariance : (value, value) array of float
        Covariance, multiplied by the Birge ratios.
    birge_ratios : Mapping of str to float
        Birge ratio of each group of equations, and of all under an empty name.
    bias_removed : bool
        Whether the bias was subtracted.
    bias_reason : str
        Why the bias was not subtracted although this was tried.
    random_forces : list of RandomForce
        Random force of each run; empty without a random force.
    """

    values: Array
    bias: Array
    covariance: Array
    birge_ratios: Mapping[str, float]
    bias_removed: bool
    bias_reason: str
    random_forces: Sequence[RandomForce] = ()

    def mapped(self, function: Callable[[Array], Array]) -> "IndirectEstimate":
        """Return the estimate of functions of these values, to first order."""
        slopes = jacobian(function, self.values, np.sqrt(np.diag(self.covariance)))
        values, covariance = function(self.values), slopes @ self.covariance @ slopes.T
        return replace(self, values=values, bias=slopes @ self.bias, covariance=covariance)


def indirect_estimate(
    auxiliary: AuxiliaryModel,
    decays: Sequence[xr.Dataset],
    *,
    correct: bool,
    random_force: RandomForceOption = "off",
) -> IndirectEstimate:
    """Fit an auxiliary model to decays, and remove its bias by indirect inference.

    Parameters
    ----------
    auxiliary : AuxiliaryModel
        Auxiliary model to fit.
    decays : sequence of Dataset
        The runs.
    correct : bool
        Whether the bias is removed.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Random force in the errors of the envelopes, in addition to the sensor's noise. If the most likely
        density is zero in every run, the estimate is that of `off`.

    Notes
    -----
    The model with these values is simulated from the fitted start. The auxiliary model is fitted to its
    motion as to the record, and its error is subtracted, until convergence (Gourieroux et al. 1993).
    """
    measured = [auxiliary.measure(decay) for decay in decays]
    # With a held density, the residuals determine the sensor's noise alone: a first fit is sufficient.
    held = not isinstance(random_force, str) and random_force > 0.0
    estimate, last = _estimate(auxiliary, decays, measured, correct=correct and not held)
    if not is_fitted(random_force):
        return estimate
    plain = estimate
    forces: list[RandomForce] = []
    for _ in range(1 if held else DENSITY_ROUNDS):
        groups = [last[name] for name in auxiliary.wandering]
        ratios = [
            random_force_ratio([group.runs[run] for group in groups], of_run, random_force)
            for run, of_run in enumerate(measured)
        ]
        if not any(ratio.ratio for ratio in ratios):
            return plain
        pairs = list(zip(measured, ratios, strict=True))
        before = forces
        forces = [random_force_of_ratio(ratio, swing_frequency(run), random_force) for run, ratio in pairs]
        # Stop if the densities hardly differ from those of the round before; a held density never does.
        steps = [abs(new.density - old.density) for new, old in zip(forces, before, strict=False)]
        errors = [SETTLED_DENSITY * np.nan_to_num(force.standard_error) for force in forces]
        if steps and all(step <= error for step, error in zip(steps, errors, strict=True)):
            break
        stochastic = [with_random_force(envelope, ratio) for envelope, ratio in pairs]
        estimate, last = _estimate(auxiliary, decays, stochastic, correct=correct)
    return replace(estimate, random_forces=forces)


def _estimate(
    auxiliary: AuxiliaryModel, decays: Sequence[xr.Dataset], measured: Sequence[xr.Dataset], *, correct: bool
) -> tuple[IndirectEstimate, Groups]:
    """Return the estimate with the stated errors of the envelopes, and the fit of its residuals."""
    first = auxiliary.fit(measured)
    values, last = auxiliary.values(first), first
    bias_removed, bias_reason = False, ""
    if correct:
        try:
            values, last = _corrected(auxiliary, decays, measured, first)
            bias_removed = True
        except (SysidTribError, np.linalg.LinAlgError) as error:
            bias_reason = str(error)
    ratios, bias = birge_ratios(last), auxiliary.values(first) - values
    covariance = auxiliary.covariance(first, ratios)
    estimate = IndirectEstimate(values, bias, covariance, ratios, bias_removed, bias_reason)
    return estimate, last


def _corrected(
    auxiliary: AuxiliaryModel,
    decays: Sequence[xr.Dataset],
    measured: Sequence[xr.Dataset],
    first: Groups,
) -> tuple[Array, Groups]:
    """Return the values whose simulated motions give the same fit as the records, and this fit.

    Its residuals are those of the records minus those of the motions.

    Raises
    ------
    SysidTribError
        A motion cannot be computed or measured, or the values do not converge.
    """
    biased = values = auxiliary.values(first)
    errors = np.sqrt(np.diag(auxiliary.covariance(first, birge_ratios(first))))
    part = SETTLED_CURVES if auxiliary.curves else SETTLED_ERRORS
    settled = part * errors + SETTLED_VALUES * np.abs(biased)
    starts: list[FittedMotion | None] = [None] * len(decays)
    tried: list[Array] = []
    steps: list[Array] = []
    for _ in range(20):
        model, simulated = auxiliary.model(values), []
        for run, (decay, envelope) in enumerate(zip(decays, measured, strict=True)):
            motion, starts[run] = _motion_from_start(model, decay, starts[run], float(biased[-1]))
            simulated.append(as_measured(auxiliary.measure(motion), envelope))
        fit = auxiliary.fit_simulated(simulated, values, first)
        tried.append(values)
        steps.append(biased - auxiliary.values(fit))
        values = _accelerated(tried, steps, np.where(settled > 0.0, settled, 1.0))
        if np.all(np.abs(steps[-1]) <= settled):
            # The residual of the auxiliary model on its own motion does not indicate another force.
            return values, {name: old.without_bias(fit[name]) for name, old in first.items()}
    raise SysidTribError("the correction did not converge")


def _motion_from_start(
    model: Model, decay: xr.Dataset, before: FittedMotion | None, frequency: float
) -> tuple[xr.Dataset, FittedMotion]:
    """Return a motion of the model that starts as a decay does, and its start; `before` is a nearby start."""
    time, angle = (decay[name].to_numpy().astype(float) for name in ("time", "angle"))
    # Two periods determine the start; later, a still biased model may lose the phase.
    count = np.searchsorted(time, time[0] + 4.0 * np.pi / frequency) + 1
    begin = time[:count], angle[:count]
    guess = first_guess(*begin, frequency) if before is None else (before.angle, before.rate)
    sensitivity = None if before is None else before.sensitivity
    start = fit_start(model, *begin, guess, offset=None, sensitivity=sensitivity)
    accuracy = accuracy_of(model)
    simulated = trajectory(model, time, start.angle, start.rate, accuracy=accuracy).angle
    return xr.Dataset({"angle": ("time", simulated)}, {"time": time}), start


def _accelerated(tried: Sequence[Array], steps: Sequence[Array], unit: Array) -> Array:
    """Return the zero of steps that are nearly linear in the values (Anderson 1965); first the plain step.

    With a strong random force, plain steps converge slowly or diverge.
    """
    # Number of corrections whose differences scale the next one.
    recent = slice(-5, None)
    by_values, by_steps = (np.diff(np.array(known[recent]), axis=0).T for known in (tried, steps))
    part = np.linalg.lstsq(by_steps / unit[:, None], steps[-1] / unit, rcond=None)[0]
    return np.asarray(tried[-1] + steps[-1] - (by_values + by_steps) @ part)


def as_measured(simulated: xr.Dataset, measured: xr.Dataset) -> xr.Dataset:
    """Return the simulated envelope at the record's half periods and with its standard errors.

    Raises
    ------
    DecayError
        The envelopes have fewer than three half periods in common, for example if the motion stops early.
    """
    shift = int(np.argmin(np.abs(simulated.extremum_time.values - measured.extremum_time.values[0])))
    count = min(measured.sizes["half_period"], simulated.sizes["half_period"] - shift)
    if count < 3:
        raise DecayError(
            f"the motion of the model and the record have {count} of the three half periods in common that "
            "are needed"
        )
    part = simulated.isel(half_period=slice(shift, shift + count), instant=slice(shift, shift + count - 2))
    errors = [name for name in (*ENVELOPE_ERRORS, DENSITY) if name in measured]
    return part.assign(measured[errors].isel(half_period=slice(0, count)).data_vars)


def as_identification(
    method: Method, decay: Decays, asked: ForceLibrary, indirect: IndirectEstimate, offered: ForceLibrary
) -> xr.Dataset:
    """Return an indirect estimate as an identification, with its bias and the assumptions of the method."""
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        f"{name}_birge_ratio": (value, "1", f"Birge ratio of the {name}'s equations alone")
        for name, value in indirect.birge_ratios.items()
        if name
    }
    extra["birge_ratio"] = indirect.birge_ratios[""], "1", "Birge ratio of the equations"
    noises = [sensor_noise(run) for run in as_runs(decay)]
    *coefficients, frequency = indirect.values
    estimate = Estimate(np.array(coefficients), indirect.covariance, float(frequency), noises, extra)
    result = identification(method, decay, asked, estimate, offered=offered)
    result["first_order_bias"] = variable("force", indirect.bias[:-1], "first-order bias removed", "1")
    if indirect.random_forces:
        result = result.assign(random_force_variables(indirect.random_forces))
    assumes = scope_of(method).assumes
    result = result.assign(described("identification", {"first_order_bias_removed": indirect.bias_removed}))
    return result.assign_attrs(first_order_bias_reason=indirect.bias_reason, assumes=assumes)
