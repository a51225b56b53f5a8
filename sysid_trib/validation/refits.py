"""Sensitivity: the same fit over windows, starts, sampling, noise models and methods."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError, Tell, silent
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.library import counted_from
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.methods import Averaging, Direct, Trajectory, method_of
from sysid_trib.methods.scope import Method, constrained, with_random_force
from sysid_trib.records.decay import RECORD_PARTS, Decays, as_runs, one_or_all
from sysid_trib.results.references import comparison_covariance, comparison_values, in_model
from sysid_trib.results.schema import library_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable
from sysid_trib.validation.model_error import between

# The noise that a fit of the motion may allow for.
NOISES: tuple[RandomForceOption, ...] = ("off", "estimated")
# One fit: what it is, the method, and the runs.
Refit = tuple[str, Method, list[xr.Dataset]]


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
            common = [symbol for symbol in symbols if symbol in refit.force and in_model(refit, symbol)]
            places = [symbols.index(symbol) for symbol in common]
            values[at, places] = comparison_values(refit, common, reference)[:-1]
            covariance = comparison_covariance(refit, common, reference)
            errors[at, places] = np.sqrt(np.diag(covariance))[:-1]
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
    for name, (low, high) in RECORD_PARTS.items():
        yield f"window: {name}", method, [run.isel(time=between(run, low, high)) for run in runs]
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
