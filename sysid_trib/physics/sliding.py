"""Identification in sliding windows, and whether the coefficients stay the same during a decay."""

from collections.abc import Iterator

import numpy as np
import xarray as xr
from scipy.stats import chi2, norm

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SysidTribError, UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.scope import Method
from sysid_trib.physics.model_estimate import model_estimate, propagate
from sysid_trib.records.equilibrium import with_half_periods
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, text_variable, variable, with_error
from sysid_trib.simulation.model import rescaling_factors

# Periods of a window.
SHORTEST = 3.0


def sliding_coefficients(
    decay: xr.Dataset,
    library: ForceLibrary,
    method: Method,
    *,
    window_periods: float = 10.0,
    overlap: float = 0.5,
) -> xr.Dataset:
    """Identify a decay in sliding windows, and test whether its coefficients are constant.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` in rad, as `free_decay` returns it.
    library : ForceLibrary
        The forces, as for `identify`.
    method : method
        As for `identify`. With the method's `reference_frequency` the frequency is held in every window, and
        a change of the linear stiffness shows in the force of formula `x`; without it the frequency is fitted
        in every window and shows it itself.
    window_periods : float
        Length of a window in periods, at least 3.
    overlap : float
        Part of a window that the next has too, 0 to less than 1.

    Returns
    -------
    Dataset
        Over `window` (coordinates `window_time`, its centre in s, and `amplitude`, mean in rad) and `force`:
        `coefficient`, `standard_error`, all referred to the one `common_frequency` (rad/s) although each
        window's method has its own; `reference_frequency(window)` (rad/s) with its error; `decided(window)`
        and the `reason(window)` why the method could not decide, its numbers being nan; `apart(window)`, the
        windows of the tests. Tests of each force over these: `chi_square`, `degrees_of_freedom`, `p_value`
        of a constant coefficient, `trend` (per s) with its error, `trend_p_value`.

    Raises
    ------
    UsageError
        Not one decay, or a window or overlap that makes no sense.
    DecayError
        The decay is shorter than two windows, or no window can be decided.

    Notes
    -----
    Windows that overlap share their noise: only windows that do not enter the tests. In a decay, time and
    amplitude go together: a coefficient that drifts may also be a force that depends on amplitude in another
    way. `t` in a formula counts from each window's first sample.
    """
    if not isinstance(decay, xr.Dataset) or "angle" not in decay:
        raise UsageError("Windows slide over one decay, a Dataset with angle(time): free_decay(record).")
    if not (np.isfinite(window_periods) and window_periods >= SHORTEST and 0.0 <= overlap < 1.0):
        raise UsageError(
            f"window_periods={window_periods} must be at least {SHORTEST:g}, overlap={overlap} from 0 to "
            "less than 1."
        )
    time, _, halves = with_half_periods(decay)
    length = 2.0 * window_periods * float(np.median(halves.duration))
    starts = time[0] + np.arange(0.0, time[-1] - time[0] - length + 1e-9, length * (1.0 - overlap))
    if starts.size < 2 or starts[-1] - starts[0] < 0.999 * length:
        raise DecayError(
            f"Two windows of {window_periods:g} periods ({length:.3g} s) do not fit into "
            f"{time[-1] - time[0]:.3g} s; take shorter ones."
        )
    results, reasons = zip(*_identified(decay, library, method, starts, length), strict=True)
    decided = [result for result in results if result is not None]
    if not decided:
        raise DecayError(f"No window could be decided; in the first: {reasons[0]}")
    apart, end = np.zeros(starts.size, dtype=bool), -np.inf
    for i, start in enumerate(starts):
        # From the first window on those that share no sample.
        if start >= end - 1e-6 * length:
            apart[i], end = True, start + length
    middle = 0.5 * (halves.crossing[1:] + halves.crossing[:-1])
    inside = [(middle >= start) & (middle < start + length) for start in starts]
    amplitude = [np.abs(halves.peak[i]).mean() if i.any() else np.nan for i in inside]
    table = _converted(results, decided).assign(
        decided=variable("window", [not reason for reason in reasons], "whether it could be decided"),
        reason=text_variable("window", reasons, "why the window could not be decided"),
        apart=variable("window", apart, "whether it enters the tests"),
    )
    table = table.assign_coords(
        window=np.arange(starts.size),
        window_time=variable("window", starts + 0.5 * length, "centre of the window", "s"),
        amplitude=variable("window", amplitude, "mean amplitude in the window", "rad"),
    )
    return table.assign(_constancy(table)).assign_attrs(decided[0].attrs)


def _identified(
    decay: xr.Dataset, library: ForceLibrary, method: Method, starts: Array, length: float
) -> Iterator[tuple[xr.Dataset | None, str]]:
    time = decay.time.values
    for start in starts:
        first, last = np.searchsorted(time, (start - 1e-9, start + length + 1e-9))
        try:
            yield method.identify(decay.isel(time=slice(int(first), int(last))), library), ""
        except SysidTribError as error:
            yield None, str(error)


def _converted(results: tuple[xr.Dataset | None, ...], decided: list[xr.Dataset]) -> xr.Dataset:
    """Coefficients and errors of every window at the mean of the windows' reference frequencies."""
    w = np.array([result.reference_frequency.item() for result in decided])
    w_errors = np.array([result.reference_frequency_standard_error.item() for result in decided])
    # By their precision.
    common = float(np.average(w, weights=w_errors**-2.0 if np.all(w_errors > 0) else None))
    symbols = decided[0].force.values.tolist()
    values = np.full((2, len(results), len(symbols)), np.nan)
    frequency = np.full((2, len(results)), np.nan)
    for i, result in enumerate(results):
        if result is None:
            continue
        estimate = model_estimate(result)

        def at_common(z: Array, forces: tuple[Force, ...] = estimate.forces) -> Array:
            factors = rescaling_factors(forces, float(z[-1]), common)
            # A force that cannot be converted keeps the window's own frequency.
            return np.asarray(z[:-1] * np.where(np.isfinite(factors), factors, 1.0))

        values[:, i] = propagate(at_common, estimate.values, estimate.covariance)
        frequency[:, i] = estimate.frequency, np.sqrt(estimate.covariance[-1, -1])
    dims, of_window = ("window", "force"), "frequency of the window"
    data = {
        "coefficient": variable(dims, values[0], "coefficient", PER_FORCE_UNIT),
        "standard_error": variable(dims, values[1], "standard error of the coefficient", PER_FORCE_UNIT),
        "common_frequency": variable((), common, "frequency they all refer to", "rad/s"),
        **with_error("reference_frequency", "window", (frequency[0], frequency[1]), of_window, "rad/s"),
    }
    return xr.Dataset(data, {"force": symbols, "unit": ("force", decided[0]["unit"].values)})


def _constancy(table: xr.Dataset) -> Variables:
    """Tests of a constant coefficient over the windows that share no sample: chi-square, slope in time."""
    usable = table.apart.values & table.decided.values
    c, error = table.coefficient.values[usable], table.standard_error.values[usable]
    count, t = int(usable.sum()), table.window_time.values[usable, None]
    with np.errstate(all="ignore"):
        weight = 1.0 / error**2
        mean, centre = ((weight * part).sum(axis=0) / weight.sum(axis=0) for part in (c, t))
        square, moment = ((weight * part**2).sum(axis=0) for part in (c - mean, t - centre))
        trend, trend_error = (weight * (t - centre) * c).sum(axis=0) / moment, 1.0 / np.sqrt(moment)
        p_value, trend_p = chi2.sf(square, count - 1), 2.0 * norm.sf(np.abs(trend / trend_error))
    if count < 2:
        p_value, trend_p = np.full((2, len(square)), np.nan)
    return {
        "mean_coefficient": variable("force", mean, "weighted mean of the coefficient", PER_FORCE_UNIT),
        "chi_square": variable("force", square, "chi-square of a constant coefficient", "1"),
        "p_value": variable("force", p_value, "p-value of a constant coefficient", "1"),
        **with_error("trend", "force", (trend, trend_error), "slope of the coefficient in time", "per s"),
        "trend_p_value": variable("force", trend_p, "p-value of no slope", "1"),
        "degrees_of_freedom": variable((), max(count - 1, 0), "degrees of freedom of each chi-square", "1"),
    }
