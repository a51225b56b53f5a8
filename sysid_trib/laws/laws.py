"""`laws`: friction against speed and restoring force against displacement, without choosing a form."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS, System, load_system, with_shipped
from sysid_trib.laws import bands, curves
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.methods import Averaging, Direct
from sysid_trib.records.decay import Decays, as_runs, one_or_all, root_mean_square
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.smoothing import swing_frequency
from sysid_trib.results import signal_scale
from sysid_trib.results.variables import described, group_names
from sysid_trib.validation import cross_check, findings, model_error
from sysid_trib.validation.residuals import FollowedRuns, residuals, with_motions
from sysid_trib.validation.verdict import APPROXIMATE_PART, RESIDUAL_LEVEL

# Forces outside of the penalty where no system is named, and the one that is always there: a jump at rest.
USUAL, JUMP = ("lambda", "zeta", "delta", "nu", "epsilon"), "sign(v)"
# Forces that differ between directions and sides, and errors that cameras, encoders and potentiometers have.
EVEN_FORCES = ("even_speed", "even_drag", "even_spring", "bilinear")
SENSOR_TERMS = ("shutter", "sensor_curve", "sensor_cubic", "sensor_delay")
# Level of a test that finds them; they are kept where the residual shrinks to less than this part.
EXTENSION_LEVEL, EXTENSION_GAIN = 1e-4, 0.95
NO_BETTER = (
    "No motion of curves follows the record better than that of the named forces, whose laws these are."
)
# Fewer half periods, or amplitudes that change by less than this factor, decide no curve.
FEWEST_OF_A_CURVE, SMALLEST_RANGE = 8, 1.15
# A law of averaging begins at this part of the smallest amplitude: below, averages tell nothing.
BELOW_SMALLEST = 0.5


@dataclass(frozen=True)
class LawModel:
    """What is fitted: named forces, curves, and what is held.

    Attributes
    ----------
    named : ForceLibrary
        Forces outside of the penalty, and those that are held.
    constraints : mapping
        Of coefficients.
    odd, even : tuple of str
        Curves of `libraries/curves.toml`; none where the record decides no curve.
    reason : str
        Why the record decides no curve; empty where it does.
    """

    named: ForceLibrary
    constraints: ConstraintTable
    odd: tuple[str, ...] = curves.ODD_CURVES
    even: tuple[str, ...] = ()
    reason: str = ""

    def library(self, runs: Sequence[xr.Dataset], lowest: float = 0.0) -> ForceLibrary:
        """Return all forces, the parts of the curves over the range of the runs."""
        return curves.with_curves(self.named, (*self.odd, *self.even), curves.ranges(runs), lowest)


def laws(
    decay: Decays,
    system: str | System | None = None,
    constraints: ConstraintTable | None = None,
    *,
    library: ForceLibrary | None = None,
    random_force: RandomForceOption = "off",
    tell: Tell = silent,
) -> xr.DataTree:
    """Identify friction as a function of speed and restoring force as a function of displacement.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        `angle(time)`; several runs share their laws.
    system : str or System, optional
        A system of `libraries/systems.toml`: what it holds, as a pendulum its gravity, stays as it is, and
        its usual forces are outside of the penalty.
    constraints : mapping of str to float, (float, float) or str, optional
        Known forces: `{"gravity": 1.0}`.
    library : ForceLibrary, optional
        Where forces of the constraints are looked for before those of the package.
    random_force : "off", "estimated" or float
        As that of `methods.Direct`.
    tell : callable
        Called with a few words as the work goes on.

    Returns
    -------
    DataTree
        As that of `identify`: groups `record`, `averaging`, `direct`, `comparison`, `backbone`. Each
        identification also holds `friction(speed)` (rad/s^2 over rad/s: the force over the inertia) and
        `restoring(displacement)` (rad/s^2 over rad), each with `_standard_error`, `_low`, `_high` (a
        simultaneous 95 % band over the visited range), `_error_of_model` and `_covariance`;
        `speed_visited`, `displacement_visited`. `comparison` holds the difference of both methods' laws over
        its error at each speed and displacement. Its attrs say the preferred method (`answer`), what was
        decided about even parts (`even`), and `reason` where the record decides no curve.

    Raises
    ------
    DecayError
        The record cannot support the request.
    UsageError
        No such system or force, or a force of an angle for a displacement.

    Notes
    -----
    theta'' = -w^2 (theta + K(theta) + D(theta'/w) + known forces). K and D are penalised splines in mixed
    model form outside of whose penalty the named forces stay (Ruppert, Wand & Carroll 2003). `Direct` reads
    them within the cycle, averaging from amplitude to amplitude.
    """
    moving = system if isinstance(system, System) else load_system(system)
    model = _named(moving, Constraints(constraints or NO_CONSTRAINTS), library)
    runs = as_runs(decay)
    if not signal_scale.counts_angles(runs[0]):
        for force in model.named:
            if not signal_scale.scalable(force):
                raise UsageError(
                    f"Force '{force.symbol}' is a function of an angle, but a displacement was measured; "
                    "leave it out, or give the pendulum's length, --length M."
                )
    tree = _identified(decay, model, random_force, tell=tell)
    asked = {"system": moving.name, "constraints": dict(constraints or {}), "random_force": random_force}
    tree["comparison"].attrs["options"] = json.dumps(asked)
    return tree


def _named(system: System, asked: Constraints, library: ForceLibrary | None) -> LawModel:
    """Return the forces outside of the penalty and what is held."""
    whole = library or load_library()
    symbols = list(dict.fromkeys((*(system.symbols or USUAL), *asked.names)))
    whole = with_shipped(whole, symbols)
    jump = whole.role(JUMP) or load_library().role(JUMP)
    named = whole.select(symbols)
    if jump is not None and named.role(JUMP) is None:
        named = replace(named, forces=(jump, *named.forces))
    held = {symbol: value for symbol, value in system.held.items() if symbol not in asked.names}
    return LawModel(named, {**held, **asked.table})


@signal_scale.in_units_of_the_motion
def _identified(
    decay: Decays, model: LawModel, random_force: RandomForceOption, *, tell: Tell
) -> xr.DataTree:
    runs = as_runs(decay)
    amplitudes = np.concatenate([np.abs(envelope(run).extremum.values) for run in runs])
    if reason := _no_curve(amplitudes):
        model = replace(model, odd=(), even=(), reason=reason)
    tell("direct")
    direct = _fitted(runs, Direct(random_force=random_force, constraints=model.constraints), model)
    if not reason and not direct.is_white:
        tell("errors of the sensor, and even parts")
        direct = _extended(direct)
    tell("averaging")
    # Averages tell nothing of even forces, nor of what a law does far below the smallest amplitude.
    odd = replace(model, named=_odd_forces(model), even=())
    lowest = BELOW_SMALLEST * float(amplitudes.min() / amplitudes.max())
    method = Averaging(random_force=random_force, constraints=model.constraints)
    fits: dict[str, LawFit] = {}
    failed = ""
    try:
        fits["averaging"] = _fitted(runs, method, odd, lowest)
    except (SysidTribError, np.linalg.LinAlgError) as error:
        failed = str(error)
    fits["direct"] = direct
    tell("errors")
    largest = _largest(runs)
    return _tree(runs, {name: _with_laws(fit, largest) for name, fit in fits.items()}, fits, failed)


@dataclass(frozen=True)
class LawFit:
    """One method's fit of a law model to runs.

    Attributes
    ----------
    method : Direct or Averaging
    model : LawModel
    library : ForceLibrary
        The forces of the model over the range of the runs.
    followed : FollowedRuns
        The identification, and its motion in each run.
    """

    method: Direct | Averaging
    model: LawModel
    library: ForceLibrary
    followed: FollowedRuns

    @property
    def _residuals(self) -> xr.Dataset:
        of = self.followed
        return of.once("residual", lambda: residuals({"": of}, of.result))

    @property
    def is_white(self) -> bool:
        """True if the residual is nothing but noise."""
        return bool(self._residuals.residual_p_value.item() >= RESIDUAL_LEVEL)

    @property
    def residual_rms(self) -> float:
        """RMS of record minus motion, rad; infinite without a motion."""
        of = self.followed
        if any(motion is None for motion in of.motions):
            return float("inf")
        pairs = zip(of.runs.values(), of.motions, strict=True)
        missed = [run.angle.values - motion.offset - motion.x for run, motion in pairs if motion is not None]
        size = root_mean_square([root_mean_square(residual) for residual in missed])
        return size if np.isfinite(size) else float("inf")


def _fit(
    runs: Sequence[xr.Dataset], method: Direct | Averaging, model: LawModel, lowest: float = 0.0
) -> LawFit:
    """Fit a law model with a method as it is."""
    library = model.library(runs, lowest)
    result = method.identify(one_or_all(list(runs)), library)
    return LawFit(method, model, library, FollowedRuns(dict(enumerate(runs)), result))


def _fitted(
    runs: Sequence[xr.Dataset], method: Direct | Averaging, model: LawModel, lowest: float = 0.0
) -> LawFit:
    """Fit curves, or only the named forces where the motion of no curve follows the record better.

    What a model lacks within the cycle may be taken for a curve that no motion bears. A random force makes
    each half period an equation of its own, which is immune to that.
    """
    fit = _fit(runs, method, model, lowest)
    if fit.is_white or not model.odd:
        return fit
    named = _fit(runs, method, replace(model, odd=(), even=(), reason=NO_BETTER), lowest)
    if fit.residual_rms <= named.residual_rms or method.random_force != "off":
        return min((fit, named), key=lambda of: of.residual_rms)
    try:
        other = _fit(runs, replace(method, random_force="estimated"), model, lowest)
    except (SysidTribError, np.linalg.LinAlgError):
        return named
    return min((other, named), key=lambda of: of.residual_rms)


def _largest(runs: Sequence[xr.Dataset]) -> dict[str, float]:
    """Return the largest displacement (rad) and speed (rad/s) of the runs."""
    w = max(swing_frequency(run) for run in runs)
    ranges = curves.ranges(runs, w)
    return {"x": ranges["x"], "v": ranges["v"] * w}


def _no_curve(amplitudes: Array) -> str:
    """Return why the amplitudes decide no curve, or nothing."""
    if len(amplitudes) < FEWEST_OF_A_CURVE:
        return (
            f"{len(amplitudes)} half periods are too few for a curve (it takes {FEWEST_OF_A_CURVE}): the "
            "laws are those of the named forces."
        )
    ratio = float(amplitudes.max() / max(amplitudes.min(), 1e-300))
    if ratio < SMALLEST_RANGE:
        return (
            f"The amplitude changes by a factor of {ratio:.3g} only, too little for a curve (it takes "
            f"{SMALLEST_RANGE:g}): the laws are those of the named forces."
        )
    return ""


def _extended(fit: LawFit) -> LawFit:
    """Return the fit with errors of the sensor, or even parts of the laws, where the record asks for them.

    An even error of the sensor looks like an even force: the one with the smaller residual is taken first.
    """
    whole, offered = fit, [SENSOR_TERMS] * _is_angle(fit) + [EVEN_FORCES]
    while offered and not whole.is_white:
        tried = [(names, other) for names in offered if (other := _with_forces(whole, names)) is not None]
        names, best = min(tried, key=lambda pair: pair[1].residual_rms, default=((), whole))
        if not best.residual_rms < EXTENSION_GAIN * whole.residual_rms:
            break
        whole, offered = best, [other for other in offered if other != names]
    return whole


def _is_angle(fit: LawFit) -> bool:
    """Return True if an angle was measured, which cameras and encoders distort."""
    return all(signal_scale.counts_angles(run) for run in fit.followed.runs.values())


def _with_forces(fit: LawFit, symbols: tuple[str, ...]) -> LawFit | None:
    """Return the fit with more forces, or errors of each run's sensor; None where they are not needed."""
    runs = list(fit.followed.runs.values())
    added = load_library(EFFECTS).select(symbols)
    named = replace(fit.model.named, forces=(*fit.model.named.forces, *added.forces))
    model, method = replace(fit.model, named=named), fit.method
    if symbols == EVEN_FORCES and model.odd:
        model = replace(model, even=curves.EVEN_CURVES)
    elif symbols == SENSOR_TERMS and len(runs) > 1 and isinstance(method, Direct):
        method = replace(method, own=symbols)
    try:
        plain = _fit(runs, method, replace(model, even=()))
        result = plain.followed.result
        at = np.flatnonzero(np.isin([name.rsplit("_", 1)[0] for name in result.force.values], symbols))
        at = np.union1d(at, np.flatnonzero(np.isin(result.force.values, symbols)))
        values, covariance = result.coefficient.values[at], result.covariance.values[np.ix_(at, at)]
        square = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
        if scipy.stats.chi2.sf(square, len(at)) >= EXTENSION_LEVEL:
            return None
        return _fit(runs, method, model) if model.even else plain
    except (SysidTribError, np.linalg.LinAlgError):
        return None


def _odd_forces(model: LawModel) -> ForceLibrary:
    """Return the named forces that averages over a cycle see."""
    return model.named.select(force.symbol for force in model.named if force.parity != "even")


def _with_laws(fit: LawFit, largest: Mapping[str, float]) -> FollowedRuns:
    """Return the identification with its laws, whose errors hold that of the model where one is missing."""
    followed, result = fit.followed, fit.followed.result
    whole_laws = bands.laws_of(result, largest)
    of_model = [np.zeros_like(law.covariance) for law in whole_laws]
    if not fit.is_white:
        runs = list(followed.runs.values())
        parts = model_error.fitted_parts(runs, fit.method, fit.library, result, later_only=True)
        of_parts = [bands.laws_of(part, largest) for part in parts.results]
        if of_parts:
            of_model = [_movement(law, [laws[at] for laws in of_parts]) for at, law in enumerate(whole_laws)]
        result = result.assign(described("identification", {"held_out_rms": parts.held_out_rms}))
    values, places = bands.law_variables(whole_laws, of_model)
    return followed.with_result(result.assign_coords(places).assign(values))


def _movement(law: bands.Law, parts: Sequence[bands.Law]) -> Array:
    """Return the covariance of a law by its change between parts of the record, (place, place)."""
    changes = [part.values - law.values for part in parts]
    errors = [np.sqrt(np.diag(part.covariance)) for part in parts]
    return model_error.covariance_by_parts(changes, errors, np.sqrt(np.diag(law.covariance)))


def _tree(
    runs: Sequence[xr.Dataset],
    followed: Mapping[str, FollowedRuns],
    fits: Mapping[str, LawFit],
    failed: str,
) -> xr.DataTree:
    """Return the result with both methods' laws compared."""
    names, results = list(followed), {name: of.result for name, of in followed.items()}
    second = results[names[-1]]
    records = with_motions(followed)
    compared = residuals(followed, second)
    over_motion = {"residual_over_motion": cross_check.residual_over_motion(records)}
    compared = compared.assign(described("cross_check", over_motion))
    compared = compared.assign(findings.failure_of_models(records))
    if len(names) == 2:
        compared = compared.merge(_difference(results[names[0]], second))
    explained = cross_check.explained_by(compared)
    at = cross_check.better_of(results[names[0]], second) if len(names) == 2 else 0
    answer = names[at]
    unexplained = compared.residual_over_motion.sel(model=answer).item()
    approximate = "approximate" if unexplained <= APPROXIMATE_PART else "not explained"
    compared.attrs = {
        "laws": "yes",
        "first": names[0],
        "second": names[-1],
        "answer": answer,
        "explained": explained,
        "verdict_on_record": "explained" if explained == "yes" else approximate,
        "even": ", ".join(fits[names[-1]].model.even),
        "sensor": ", ".join(s for s in SENSOR_TERMS if s in fits[names[-1]].model.named.symbols),
        "reason": fits[answer].model.reason,
        "averaging_failed": failed,
    }
    groups: dict[str, Any] = dict(zip(group_names("record", len(runs)), records, strict=True))
    of_envelopes = [envelope(run) for run in runs]
    groups |= dict(zip(group_names("envelope", len(runs)), of_envelopes, strict=True))
    groups |= results | {"comparison": compared} | cross_check.backbones_of(runs, results)
    return xr.DataTree.from_dict(groups)


def _difference(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Return the difference of both methods' laws over its error: of their odd parts, which both see.

    Both methods saw the same noise: the sum of their variances is more than that of their difference.
    """
    values: dict[str, Any] = {}
    for law in ("friction", "restoring"):
        averaged, other = xr.align(bands.odd_part(first, law), bands.odd_part(second, law))
        error = np.hypot(averaged[f"{law}_standard_error"], other[f"{law}_standard_error"])
        values[f"{law}_difference"] = (averaged[law] - other[law]).assign_attrs(units="rad/s^2")
        values[f"{law}_z"] = ((averaged[law] - other[law]) / error).assign_attrs(units="1")
    return xr.Dataset(values)
