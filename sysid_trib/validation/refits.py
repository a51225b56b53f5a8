"""Refits of the same forces in every other defensible way, compared at one reference frequency."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, Tell, silent
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.methods import Averaging, Direct, Trajectory, method_of
from sysid_trib.methods.options import constrained, with_random_force
from sysid_trib.methods.scope import Method
from sysid_trib.records.runs import Decays, as_runs, one_or_all
from sysid_trib.results import models, signal_scale, variables
from sysid_trib.results.models import forces_in_model
from sysid_trib.validation import common_reference

# Noises with which the motion may be fitted.
NOISES: tuple[RandomForceOption, ...] = ("off", "estimated")


class Refit(NamedTuple):
    """A fit of the same forces with one change.

    Attributes
    ----------
    kind : str
        Kind of the change: window, start, sampling, noise or method.
    label : str
        Difference from the original fit.
    method : Method
    parts : list of Dataset
        Runs to which the forces are fitted.
    """

    kind: str
    label: str
    method: Method
    parts: list[xr.Dataset]


def refit(
    method: Method, parts: Sequence[xr.Dataset], library: ForceLibrary, runs: Sequence[xr.Dataset] = ()
) -> tuple[xr.Dataset | None, str]:
    """Identify parts of runs; return the identification and the reason of failure.

    `t` of the formulas counts from the first sample of the `runs`, or without these from that of the parts.
    """
    later = float(parts[0].time.values[0] - runs[0].time.values[0]) if runs else 0.0
    try:
        return method.identify(one_or_all(parts), library.counted_from(later)), ""
    except (SysidTribError, np.linalg.LinAlgError) as error:
        return None, str(error)


def between(run: xr.Dataset, limits: tuple[float, float]) -> slice:
    """Return the samples of a run between two fractions of its duration."""
    time = run.time.values.astype(float)
    ends = time[0] + np.array(limits) * (time[-1] - time[0])
    return slice(int(np.searchsorted(time, ends[0])), int(np.searchsorted(time, ends[1], side="right")))


def at_reference(
    results: Sequence[xr.Dataset | None], symbols: Sequence[str], reference: float, missing: float = np.nan
) -> tuple[Array, Array]:
    """Return coefficients at a reference frequency (rad/s), with the asymptotic frequency as the last.

    Shape: (result, quantity), with their covariances; `missing` replaces values of missing forces.
    """
    count = len(symbols) + 1
    values = np.full((len(results), count), missing)
    covariances = np.full((len(results), count, count), missing)
    for row, result in enumerate(results):
        if result is not None:
            kept = [symbol for symbol in symbols if symbol in forces_in_model(result)]
            at = [*map(symbols.index, kept), len(symbols)]
            values[row, at] = common_reference.comparison_values(result, kept, reference)
            covariances[row][np.ix_(at, at)] = common_reference.comparison_covariance(result, kept, reference)
    return values, covariances


def scalars_of(results: Sequence[xr.Dataset | None], name: str) -> Array:
    """Return a scalar of each result, and its error, nan for a failed one: (2, result)."""
    names = name, f"{name}_standard_error"
    return np.array([[np.nan if of is None else of[part].item() for of in results] for part in names])


@signal_scale.in_units_of_the_motion
def sensitivity(decay: Decays, result: xr.Dataset, *, tell: Tell = silent) -> xr.Dataset:
    """Return the coefficients of an identification, with the same forces fitted in other defensible ways.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        The identification whose forces, constraints and method are used.
    tell : callable
        Called with the name of each fit.

    Returns
    -------
    Dataset
        Over `fit` and `force` the `coefficient` at the reference frequency of the result, with its
        `standard_error` (nan if a fit fails, with `reason(fit)`), and its `change` from the result over the
        fit's own error; over `fit` its `kind`: window, start, sampling, noise or method. Over `force` the
        result's own `estimate` and `stated_error`, and `low` and `high`, the smallest and the largest of all
        fits.

    Notes
    -----
    Windows are the first, the middle and the last part of each run, as for the errors of the model. Starts
    leave out one and three periods. Sampling takes every second sample, from the first or the second. Noises
    are the sensor's alone, and with a random force.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> fits = st.validation.sensitivity(decay, st.identify(decay, method="direct"))
    >>> zeta = fits.sel(force="zeta")
    >>> print(f"{zeta.sizes['fit']} fits: {zeta.low.item():.4f} to {zeta.high.item():.4f}")
    11 fits: 0.0095 to 0.0099
    """
    runs, library = as_runs(decay, driven=True), models.library_of(result)
    symbols = forces_in_model(result)
    reference, made = result.reference_frequency.item(), []
    for fit in _fits(method_of(result), runs, reference):
        tell(f"{fit.kind}: {fit.label}")
        made.append((fit.kind, fit.label, *refit(fit.method, fit.parts, library, runs)))
    kinds, labels, results, reasons = zip(*made, strict=True)
    values, covariances = at_reference(results, symbols, reference)
    values, errors = values[:, :-1], np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))[:, :-1]
    result = result.sel(force=symbols)
    estimate, held = result.coefficient.values, common_reference.held(result)
    # Held values are the same in every fit and at any reference frequency.
    values = np.where(held & np.isfinite(values), estimate, values)
    errors = np.where(held & np.isfinite(errors), 0.0, errors)
    everything = np.vstack([estimate, values])
    data = {
        "coefficient": values,
        "standard_error": errors,
        "change": np.divide(values - estimate, errors, out=np.full_like(values, np.nan), where=errors > 0.0),
        "reason": list(reasons),
        "kind": list(kinds),
        "estimate": estimate,
        "stated_error": result.standard_error.values,
        "low": np.nanmin(everything, axis=0),
        "high": np.nanmax(everything, axis=0),
    }
    coords = {"fit": list(labels), "force": result.force.values, "unit": result.unit}
    return xr.Dataset(variables.described("sensitivity", data), coords)


def _fits(method: Method, runs: Sequence[xr.Dataset], reference: float) -> Iterator[Refit]:
    """Yield every fit: its description and the function that computes it."""
    whole = list(runs)
    for name, limits in variables.PARTS_OF_RECORD.items():
        yield Refit("window", name, method, [run.isel(time=between(run, limits)) for run in runs])
    # Starts: number of periods of the record that are left out.
    for periods in (1.0, 3.0):
        later = 2.0 * np.pi * periods / reference
        parts = [run.isel(time=run.time.values >= run.time.values[0] + later) for run in runs]
        yield Refit("start", f"{periods:g} periods later", method, parts)
    for first, label in enumerate(("first", "second")):
        parts = [run.isel(time=slice(first, None, 2)) for run in runs]
        yield Refit("sampling", f"every other, {label} on", method, parts)
    for noise in NOISES if hasattr(method, "random_force") else ():
        yield Refit("noise", f"random force {noise}", with_random_force(method, noise), whole)
    common = ("reference_frequency", "shapes", "random_force")
    options = {name: getattr(method, name) for name in common if hasattr(method, name)}
    constraints = Constraints(getattr(method, "constraints", {}))
    # The other methods for all forces, with the options of this method.
    kinds: tuple[Callable[..., Method], ...] = (Averaging, Direct, Trajectory)
    for kind in kinds:
        if kind is not type(method):
            other = constrained(kind(**options), constraints)
            yield Refit("method", type(other).__name__.lower(), other, whole)
