"""Fits of law models: curves if the data allow them, with sensor errors and even parts if significant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import root_mean_square
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.methods.scope import Method
from sysid_trib.records.runs import one_or_all
from sysid_trib.records.signal import ANGLE_UNIT
from sysid_trib.results import schema, signal_scale
from sysid_trib.results.law_curves import NO_BETTER, VARIABLE_OF_LAW
from sysid_trib.results.models import library_of, shape_values_of
from sysid_trib.simulation.model import Model
from sysid_trib.smooth_laws.model import LawModel
from sysid_trib.smooth_laws.passive import Passive, made_passive
from sysid_trib.validation.residuals import FollowedRuns, residuals

# Forces that differ between directions or sides, and typical errors of cameras, encoders and potentiometers.
EVEN_FORCES = ("even_speed", "even_drag", "even_spring", "bilinear")
SENSOR_TERMS = ("shutter", "sensor_curve", "sensor_cubic", "sensor_delay")
# Significance level of these terms; they are kept if the residual decreases to less than this fraction.
EXTENSION_LEVEL, EXTENSION_GAIN = 1e-4, 0.8
# Number of refinements in a fit that starts at another fit, and in a fit to a part of the record.
REFINEMENTS_OF_EXTENSION, REFINEMENTS_OF_PART = 4, 2


@dataclass(frozen=True)
class LawFit:
    """Fit of a law model to runs by one method.

    Attributes
    ----------
    method : Direct, Averaging or Trajectory
    model : LawModel
    library : ForceLibrary
        Forces of the model over the range of the runs.
    followed : FollowedRuns
        The identification, and its motion in each run.
    largest : mapping of str to float, optional
        Largest displacement `x` (rad) and speed `v` (rad/s) of the runs; given if friction is made passive.
    """

    method: Direct | Averaging | Trajectory
    model: LawModel
    library: ForceLibrary
    followed: FollowedRuns
    largest: Mapping[str, float] | None = None

    @property
    def asked_method(self) -> Method:
        """Method, made passive if requested."""
        return self.method if self.largest is None else Passive(self.method, self.largest)

    def made_passive(self, largest: Mapping[str, float]) -> "LawFit":
        """Return the fit with friction that dissipates energy at every speed."""
        result = made_passive(self.followed.result, largest)
        return replace(self, largest=largest, followed=FollowedRuns(self.followed.runs, result))

    def method_from_here(self, refinements: int) -> Direct | Averaging | Trajectory:
        """Return the method; Direct becomes a fit that starts at this one."""
        if not isinstance(self.method, Direct) or self.method.random_force != "off":
            return self.method
        start = schema.model_of(self.followed.result)
        return replace(self.method, start=start, most_refinements=refinements)

    @property
    def method_of_parts(self) -> Method:
        """Method for parts of the record: it starts at this fit, and is made passive if requested."""
        method = self.method_from_here(REFINEMENTS_OF_PART)
        return method if self.largest is None else Passive(method, self.largest)

    @property
    def _residuals(self) -> xr.Dataset:
        of = self.followed
        return of.once("residual", lambda: residuals({"": of}, of.result))

    @property
    def is_white(self) -> bool:
        """True if the residual is only noise."""
        return bool(self._residuals.p_value.item() >= WHITE_LEVEL)

    @property
    def residual_rms(self) -> float:
        """RMS of record minus motion, rad; infinite without a motion."""
        of = self.followed
        # One run without a motion is decisive, so that later runs are not computed.
        if any(of.motion(at) is None for at in of.runs):
            return float("inf")
        pairs = zip(of.runs.values(), of.motions, strict=True)
        missed = [run.angle.values - motion.offset - motion.x for run, motion in pairs if motion is not None]
        size = root_mean_square([root_mean_square(residual) for residual in missed])
        return size if np.isfinite(size) else float("inf")


def fit_of(
    runs: Sequence[xr.Dataset], method: Direct | Averaging, model: LawModel, lowest: float = 0.0
) -> LawFit:
    """Fit a law model with a method, without further forces."""
    library = model.library(runs, lowest, method.reference_frequency)
    if model.own and isinstance(method, Direct):
        method = replace(method, own=tuple(dict.fromkeys((*method.own, *model.own_symbols(library)))))
    result = method.identify(one_or_all(list(runs)), library)
    return LawFit(method, model, library, FollowedRuns(dict(enumerate(runs)), result))


def fitted(
    runs: Sequence[xr.Dataset],
    method: Direct | Averaging,
    model: LawModel,
    lowest: float = 0.0,
    named: LawFit | None = None,
) -> LawFit:
    """Fit curves, or only the named forces if no curve's motion follows the record better.

    A model error within the cycle may lead to a curve without a possible motion. With a random force each
    half period is a separate equation, which avoids this. `named`: the fit of the named forces, if it has
    been computed.
    """
    without = replace(model.without_curves, reason=model.reason or NO_BETTER)
    if not model.odd:
        return fit_of(runs, method, without, lowest)
    try:
        fit = fit_of(runs, method, model, lowest)
    except (SysidTribError, np.linalg.LinAlgError):
        return fit_of(runs, method, without, lowest)
    if fit.is_white:
        return fit
    named = named or fit_of(runs, method, without, lowest)
    follows = np.isfinite(fit.residual_rms) and fit.residual_rms <= named.residual_rms
    if follows or method.random_force != "off":
        return min((named, fit), key=lambda of: of.residual_rms)
    try:
        other = fit_of(runs, replace(method, random_force="estimated"), model, lowest)
    except (SysidTribError, np.linalg.LinAlgError):
        return named
    return min((named, other), key=lambda of: of.residual_rms)


def explaining_own_laws(
    runs: Sequence[xr.Dataset], method: Direct, model: LawModel
) -> tuple[str, ...] | None:
    """Return the laws that explain the runs if they are separate for each run, with the fewest laws.

    Empty if no separate laws do; None if common laws do not even explain each run alone.
    """

    def explain(given: Sequence[xr.Dataset], own: tuple[str, ...]) -> bool:
        try:
            return fitted(given, method, replace(model, own=own)).is_white
        except (SysidTribError, np.linalg.LinAlgError):
            return False

    if not all(explain([run], ()) for run in runs):
        return None
    choices = [*((law,) for law in VARIABLE_OF_LAW), tuple(VARIABLE_OF_LAW)]
    return next((own for own in choices if explain(runs, own)), ())


def fitted_to_driven(runs: Sequence[xr.Dataset], method: Direct, model: LawModel) -> LawFit:
    """Fit curves, or only the named forces if these follow driven records better, each with extensions.

    Curves can follow a motor axis better than odd named forces, but worse than named forces with even parts.
    """
    plain = fit_of(runs, method, replace(model.without_curves, reason=model.reason or NO_BETTER))
    named = extended(plain)
    if not model.odd:
        return named
    fit = fitted(runs, method, model, named=plain)
    if not fit.model.odd or named.residual_rms <= fit.residual_rms:
        return named
    return min((named, extended(fit)), key=lambda of: of.residual_rms)


def extended(fit: LawFit) -> LawFit:
    """Return the fit with errors of the sensor, or even parts of the laws, if the record requires them.

    An even error of the sensor is similar to an even force: the one with the smaller residual is added first.
    """
    whole, offered = fit, [SENSOR_TERMS] * _is_angle(fit) + [EVEN_FORCES]
    while offered and not whole.is_white:
        tried = [(names, other) for names in offered if (other := _with_forces(whole, names)) is not None]
        names, best = min(tried, key=lambda pair: pair[1].residual_rms, default=((), whole))
        # At a high noise level, a residual that becomes pure noise hardly decreases.
        if not (best.residual_rms < EXTENSION_GAIN * whole.residual_rms or best.is_white):
            break
        whole, offered = best, [other for other in offered if other != names]
    return whole


def _is_angle(fit: LawFit) -> bool:
    """Return true if an angle was measured, which cameras and encoders distort."""
    # A displacement is scaled by its motion here like an angle, so its original unit is compared.
    units = [run.attrs.get(signal_scale.UNIT_ATTR, ANGLE_UNIT) for run in fit.followed.runs.values()]
    return all(unit == ANGLE_UNIT for unit in units)


def _with_forces(fit: LawFit, symbols: tuple[str, ...]) -> LawFit | None:
    """Return the fit with more forces, or errors of each run's sensor; None if they are not needed."""
    runs = list(fit.followed.runs.values())
    added = load_library(EFFECTS).select(symbols)
    model, method = fit.model, fit.method
    if not isinstance(method, Direct):
        return None
    if model.is_free_to_move:
        # A body without a restoring force has no equilibrium and therefore no sides.
        added = added.select(force.symbol for force in added if "x" not in force.formula.names)
        symbols = added.symbols
    model = replace(model, named=replace(model.named, forces=(*model.named.forces, *added.forces)))
    even = symbols != SENSOR_TERMS
    if even and model.odd:
        # Even parts are added to the laws whose odd part is a curve.
        model = replace(model, even=tuple(f"{name}_even" for name in model.odd))
    elif not even and len(runs) > 1:
        method = replace(method, own=symbols)
    try:
        plain = fit_of(runs, method, replace(model, even=()))
        if p_value_of(plain.followed.result, symbols) >= EXTENSION_LEVEL:
            return None
        return fit_of(runs, method, model) if model.even else plain
    except (SysidTribError, np.linalg.LinAlgError):
        return None


def p_value_of(result: xr.Dataset, symbols: Sequence[str]) -> float:
    """Return the p-value for some coefficients, or those of each run, being all zero (Wald's test)."""
    names = result.force.values.tolist()
    at = [i for i, name in enumerate(names) if name in symbols or name.rsplit("_", 1)[0] in symbols]
    values, covariance = result.coefficient.values[at], result.covariance.values[np.ix_(at, at)]
    square = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
    return float(scipy.stats.chi2.sf(square, len(at)))


def refitted(runs: Sequence[xr.Dataset], fit: LawFit) -> LawFit:
    """Fit the motion itself: named forces are free, basis functions of curves keep their estimates."""
    result = fit.followed.result
    # The library contains one copy of each run's own forces.
    library = library_of(result)
    start = _model_of_all_runs(result, library)
    held = {force.symbol: start.coefficients[force.symbol] for force in library if force.curve}
    own = fit.method.own if isinstance(fit.method, Direct) else ()
    of_runs = Constraints(fit.method.constraints).of_each_run(own, len(runs))
    asked = Constraints({**of_runs.table, **held})
    method = Trajectory(
        reference_frequency=fit.method.reference_frequency,
        random_force="off",
        constraints=asked.table,
        # A fit without a motion is not a suitable start.
        start=start if np.isfinite(fit.residual_rms) else None,
    )
    result = method.identify(one_or_all(list(runs)), library)
    # Fits of parts start where this one ended.
    method = replace(method, start=_model_of_all_runs(result, library))
    return LawFit(method, fit.model, library, FollowedRuns(dict(enumerate(runs)), result))


def _model_of_all_runs(result: xr.Dataset, library: ForceLibrary) -> Model:
    """Return the model of an identification with the own forces of every run."""
    pairs = zip(result.force.values.tolist(), result.coefficient.values.tolist(), strict=True)
    return Model(library, dict(pairs), result.reference_frequency.item(), shape_values_of(result))
