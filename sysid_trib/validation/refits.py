"""Forces fitted anew: to each run by itself, and to a record in every other defensible way."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import xarray as xr
from scipy.optimize import minimize_scalar

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, Tell, silent
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.library import counted_from
from sysid_trib.likelihood.random_force import DENSITY_UNITS, RandomForceOption, random_force_of
from sysid_trib.methods import Averaging, Direct, Trajectory, method_of
from sysid_trib.methods.scope import Method, constrained, with_random_force
from sysid_trib.records.decay import RECORD_PARTS, Decays, as_runs, one_or_all
from sysid_trib.results.references import (
    ASYMPTOTIC_FREQUENCY,
    comparable,
    comparison_covariance,
    comparison_values,
    in_model,
    stated_covariance,
)
from sysid_trib.results.schema import library_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, chi_square_test, variable, with_error
from sysid_trib.validation.model_error import between

# Significance level below which runs, or methods, are said to disagree.
HOMOGENEITY_LEVEL = 0.01
MIXED_UNITS = "1; rad/s for the frequency"
# The noise that a fit of the motion may allow for.
NOISES: tuple[RandomForceOption, ...] = ("off", "estimated")
# One fit: what it is, the method, and the runs.
Refit = tuple[str, Method, list[xr.Dataset]]


def at_reference(
    result: xr.Dataset, symbols: Sequence[str], reference: float, missing: float
) -> tuple[Array, Array]:
    """Coefficients of the result's own model at a reference frequency (rad/s), last the asymptotic frequency.

    With their covariance; `missing` where it has no such force.
    """
    kept = [symbol for symbol in symbols if symbol in result.force and in_model(result, symbol)]
    at, count = [*map(symbols.index, kept), len(symbols)], len(symbols) + 1
    values, covariance = np.full(count, missing), np.full((count, count), missing)
    values[at] = comparison_values(result, kept, reference)
    covariance[np.ix_(at, at)] = comparison_covariance(result, kept, reference)
    return values, covariance


@in_units_of_the_motion
def run_agreement(decays: Sequence[xr.Dataset], together: xr.Dataset) -> xr.Dataset:
    """Test whether the runs of one experiment have the same forces.

    Parameters
    ----------
    decays : sequence of Dataset
        The runs.
    together : Dataset
        The identification of all of them, whose method is run on each alone.

    Returns
    -------
    Dataset. Over `run` and `quantity` (each force, and the asymptotic frequency where it was fitted) the
    `value` from that run alone at the common reference frequency, with its `standard_error`; over `quantity`
    `chi_square` of the values about their weighted mean, `degrees_of_freedom`, `p_value`; and the same of all
    quantities with their covariances (`total_...`). nan for a run that alone cannot decide: `reason(run)`.
    attrs: `verdict` agree, disagree or unknown. With a random force in the common identification also what
    `density_agreement` says of its size in each run, and the attr `density_verdict`.

    Notes
    -----
    A random force is estimated in each run alone, so that its errors stand for that run.

    Cochran's Q. Large where a force changes from run to run (wear), or is of another form than the model's:
    then it changes with amplitude.
    """
    method, library = method_of(together), library_of(together, whole=True)
    kept, frequency = comparable(together), together.reference_frequency.item()
    free = together.reference_frequency_standard_error.item() > 0.0
    names = [*kept, ASYMPTOTIC_FREQUENCY] if free else kept
    values = np.full((len(decays), len(names)), np.nan)
    covariances = np.full((len(decays), len(names), len(names)), np.nan)
    results, reasons = list[xr.Dataset | None](), [""] * len(decays)
    for at, decay in enumerate(decays):
        try:
            result = method.identify(decay, library)
        except SysidTribError as error:
            reasons[at] = str(error)
            results.append(None)
            continue
        results.append(result)
        of_run, covariance = at_reference(result, kept, frequency, np.nan)
        # A free motion has a frequency so precise that a coefficient's error does not know it.
        if not random_force_of(together):
            covariance = stated_covariance(result, kept)
        values[at], covariances[at] = of_run[: len(names)], covariance[: len(names), : len(names)]
    usable = np.isfinite(values).all(axis=1)
    v, c, text = values[usable], covariances[usable], "chi-square about the weighted mean"
    one_by_one = [_homogeneity(v[:, [j]], c[:, [j]][:, :, [j]]) for j in range(len(names))]
    statistics, counts = np.array(one_by_one).T
    total = chi_square_test((), *_homogeneity(v, c), text)
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    dims, unit = ("run", "quantity"), MIXED_UNITS
    variables: Variables = {
        "value": variable(dims, values, "value from this run alone", unit),
        "standard_error": variable(dims, errors, "standard error of the value from this run alone", unit),
        "reason": variable("run", reasons, "why this run alone decides nothing"),
        **chi_square_test("quantity", statistics, counts, text),
        **{f"total_{name}": values_of_test for name, values_of_test in total.items()},
    }
    attrs = {"verdict": verdict_of(float(total["p_value"][1]))}
    if random_force_of(together):
        variables |= density_agreement(results, together)
        attrs["density_verdict"] = verdict_of(float(variables["density_p_value"][1]))
    return xr.Dataset(variables, {"quantity": names}, attrs)


def verdict_of(p_value: float) -> str:
    """`disagree` where the p-value is below `HOMOGENEITY_LEVEL`, else `agree`."""
    return "unknown" if np.isnan(p_value) else "agree" if p_value >= HOMOGENEITY_LEVEL else "disagree"


def _homogeneity(values: Array, covariances: Array) -> tuple[float, float]:
    """Chi-square of (run, quantity) about their weighted mean, and degrees of freedom."""
    if len(values) < 2:
        return np.nan, 0.0
    return weighted_mean(values, covariances)[2], float((len(values) - 1) * values.shape[1])


def weighted_mean(values: Array, covariances: Array) -> tuple[Array, Array, float]:
    """Mean of runs with correlated errors, its covariance, and chi-square about it.

    Parameters
    ----------
    values : (run, quantity) array of float
    covariances : (run, quantity, quantity) array of float
    """
    # Coefficients differ by orders of magnitude: in units of their errors the matrices are well conditioned.
    unit = np.sqrt(np.mean(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    unit[unit == 0.0] = 1.0
    values, scale = values / unit, np.outer(unit, unit)
    weights = np.linalg.pinv(covariances / scale, hermitian=True)
    inverse = np.linalg.pinv(weights.sum(axis=0), hermitian=True)
    mean = inverse @ np.einsum("rij,rj->i", weights, values)
    deviation = values - mean
    statistic = float(np.einsum("ri,rij,rj->", deviation, weights, deviation))
    return unit * mean, scale * inverse, statistic


def density_agreement(results: Sequence[xr.Dataset | None], together: xr.Dataset) -> Variables:
    """Test whether the densities of the random force are the same in all runs.

    Parameters
    ----------
    results : sequence of Dataset or None
        Of each run by itself; None of a run that alone decides nothing.
    together : Dataset
        The identification of all of them.

    Returns
    -------
    dict of variables
        Over `run` the `random_force_density` with its error ((rad/s^2)^2/Hz); `density_chi_square`,
        `density_degrees_of_freedom` and `density_p_value`, nan where fewer than two runs tell a density.

    Notes
    -----
    A ratio of variances is tested by its logarithm: a density has the relative error e, its logarithm the
    standard error e. Where the most likely density is zero the deviance rises from there by one within the
    standard error u, as S/u; that of the common identification is taken, as such a run says no more. The
    statistic is the least sum of the runs' deviances at one common density.
    """
    densities, errors = np.full((2, len(results)), np.nan)
    for at, result in enumerate(results):
        if result is not None:
            force = random_force_of(result)
            densities[at] = force.density
            errors[at] = (force if force else random_force_of(together, at)).standard_error
    known = np.isfinite(densities) & np.isfinite(errors) & (errors > 0.0)
    zero, some = known & (densities == 0.0), known & (densities > 0.0)
    statistic, count = np.nan, max(0, int(known.sum()) - 1)
    if count and some.any():
        logs, relative = np.log(densities[some]), errors[some] / densities[some]

        def deviance(log_density: float) -> float:
            of_some = np.sum(((log_density - logs) / relative) ** 2)
            return float(of_some + np.sum(np.exp(log_density) / errors[zero]))

        statistic = minimize_scalar(deviance, bracket=(logs.min() - 1.0, logs.max())).fun
    text = "density of the random force by this run alone"
    tested = chi_square_test((), statistic, count, "deviance of one density for all runs")
    return {
        **with_error("random_force_density", "run", (densities, errors), text, DENSITY_UNITS),
        **{f"density_{name}": values for name, values in tested.items()},
    }


@in_units_of_the_motion
def sensitivity(decay: Decays, result: xr.Dataset, *, tell: Tell = silent) -> xr.Dataset:
    """The coefficients of an identification by the same forces, fitted in every other defensible way.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        The identification that is asked about: its forces, constraints and method.
    tell : callable
        Called with the name of each fit.

    Returns
    -------
    Dataset
        Over `fit` and `force` the `coefficient` at the reference frequency of the result, with its
        `standard_error` (nan where a fit fails, `reason(fit)` says why), and its `change` from the result
        over the fit's own error; over `fit` its `kind`: window, start, sampling, noise or method. Over
        `force` the result's own `estimate` and `stated_error`, the least and the largest of all fits, `low`
        and `high`.

    Notes
    -----
    Windows are the first, the middle and the last part of each run that errors of the model are from; starts
    leave out one and three periods; sampling takes every second sample, with either first; noises are the
    sensor's alone and a random force with it.
    """
    runs, library = as_runs(decay, driven=True), library_of(result)
    symbols = [symbol for symbol in result.force.values.tolist() if in_model(result, symbol)]
    reference = result.reference_frequency.item()
    fits = list(_fits(method_of(result), runs, reference))
    reasons = [""] * len(fits)
    values, errors = np.full((2, len(fits), len(symbols)), np.nan)
    for at, (label, method, parts) in enumerate(fits):
        tell(label, at / len(fits))
        later = float(parts[0].time.values[0] - runs[0].time.values[0])
        try:
            refit = method.identify(one_or_all(parts), counted_from(library, later))
            of_fit, covariance = at_reference(refit, symbols, reference, np.nan)
            values[at], errors[at] = of_fit[:-1], np.sqrt(np.diag(covariance))[:-1]
        except (SysidTribError, np.linalg.LinAlgError) as error:
            reasons[at] = str(error)
    result = result.sel(force=symbols)
    estimate, unit, dims = result.coefficient.values, PER_FORCE_UNIT, ("fit", "force")
    everything = np.vstack([estimate, values])
    change = np.divide(values - estimate, errors, out=np.full_like(values, np.nan), where=errors > 0.0)
    kinds, labels = zip(*(label.split(": ", 1) for label, *_ in fits), strict=True)
    variables: Variables = {
        "coefficient": variable(dims, values, "coefficient of the fit", unit),
        "standard_error": variable(dims, errors, "standard error of the fit", unit),
        "change": variable(dims, change, "change over the error of the fit", "1"),
        "reason": variable("fit", reasons, "why a fit failed"),
        "kind": variable("fit", list(kinds), "what was changed"),
        "estimate": variable("force", estimate, "coefficient of the result", unit),
        "stated_error": variable("force", result.standard_error.values, "standard error of the result", unit),
        "low": variable("force", np.nanmin(everything, axis=0), "least of all fits", unit),
        "high": variable("force", np.nanmax(everything, axis=0), "largest of all fits", unit),
    }
    return xr.Dataset(variables, {"fit": list(labels), "force": result.force.values, "unit": result.unit})


def _fits(method: Method, runs: Sequence[xr.Dataset], reference: float) -> Iterator[Refit]:
    """Every fit: what it is, and how it is made."""
    whole = list(runs)
    for name, limits in RECORD_PARTS.items():
        yield f"window: {name}", method, [run.isel(time=between(run, limits)) for run in runs]
    # Starts: so many periods of the record are left out before it.
    for periods in (1.0, 3.0):
        later = 2.0 * np.pi * periods / reference
        parts = [run.isel(time=run.time.values >= run.time.values[0] + later) for run in runs]
        yield f"start: {periods:g} periods later", method, parts
    for first, label in enumerate(("first", "second")):
        parts = [run.isel(time=slice(first, None, 2)) for run in runs]
        yield f"sampling: every other, {label} on", method, parts
    for noise in NOISES if hasattr(method, "random_force") else ():
        yield f"noise: random force {noise}", with_random_force(method, noise), whole
    common = ("reference_frequency", "shapes", "random_force")
    options = {name: getattr(method, name) for name in common if hasattr(method, name)}
    constraints = Constraints(getattr(method, "constraints", {}))
    # The other methods of all forces, with the options that the method has.
    kinds: tuple[Callable[..., Method], ...] = (Averaging, Direct, Trajectory)
    for kind in kinds:
        if kind is not type(method):
            other = constrained(kind(**options), constraints)
            yield f"method: {type(other).__name__.lower()}", other, whole
