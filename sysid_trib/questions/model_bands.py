"""Simultaneous bands of the curves of an identified model."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.cycles.smooth_curve import simultaneous_factor
from sysid_trib.errors import DecayError, SysidTribError, UsageError
from sysid_trib.motion_fit.least_squares import Fit, covariance_root
from sysid_trib.questions.averaged_motion import averaged_rates, predict_envelope
from sysid_trib.questions.profiles import free_likelihood
from sysid_trib.records.runs import Decays
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import CONFIDENCE, described

# Number of draws for a band's factor, and of points of the curves other than the motion.
CURVE_DRAWS, CURVE_GRID = 4000, 60
MODEL_CURVES = ("angle", "envelope", "frequency", "damping_ratio")


@in_units_of_the_motion
def curve_bands(decay: Decays, result: xr.Dataset, *, run: int = 0, seed: int = 0) -> xr.Dataset:
    """Return the curves of an identified model with bands that contain each whole curve in 95 % of records.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        An identification of the record, whose forces, constraints and shapes are those of the fit.
    run : int
        Index of the run for motion and envelope.
    seed : int
        Seed of the draws.

    Returns
    -------
    Dataset
        `angle(time)` as the sensor's reading, `envelope(envelope_time)`, and over `amplitude` the `frequency`
        (rad/s) and the `damping_ratio`, each with its `..._standard_error` and the ends of its band,
        `..._low` and `..._high`; attributes `factor_...`: half width over the standard error.

    Raises
    ------
    UsageError
        There is no such run.
    DecayError
        There is a random force, no motion follows the record, or a model within the errors has no motion.

    Notes
    -----
    The parameters of a fit of the motion, including the start and the sensor's zero, are drawn with their
    covariance; the curves follow from difference quotients of one standard error in each direction. A band is
    the curve ± a multiple of its pointwise standard error that 95 % of the drawn curves do not exceed
    anywhere (sup-t; Montiel Olea and Plagborg-Møller 2019). Curves other than the motion are averages over a
    cycle. The bands include the error due to noise, not that of the model: for an incomplete model they
    contain the model's curves, not the system's.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> curves = st.validation.curve_bands(decay, st.identify(decay, method="direct"))
    >>> smallest = curves.isel(amplitude=0)
    >>> print(f"{smallest.damping_ratio_low.item():.4f} to {smallest.damping_ratio_high.item():.4f}")
    0.0092 to 0.0094
    """
    likelihood = free_likelihood(decay, result)
    records = likelihood.problem.records
    if run not in range(len(records)):
        raise UsageError(f"There is no run {run}; the runs of these records are 0 to {len(records) - 1}.")
    time = records[run].time
    coarse = np.linspace(time[0], time[-1], CURVE_GRID)
    values = likelihood.values
    # Use one standard error in each direction along the axes of the covariance: a kink then has its mean
    # effect.
    root = covariance_root(likelihood.covariance)
    steps = root.T[np.any(root != 0.0, axis=0)]
    try:
        best = _curves(likelihood, values, run, coarse, None)
        up, down = (
            [_curves(likelihood, values + sign * step, run, coarse, best[-1]) for step in steps]
            for sign in (1.0, -1.0)
        )
    except SysidTribError as why:
        raise DecayError(f"For some parameters within its errors this model has no motion: {why}") from None
    coords = {"time": time, "envelope_time": coarse, **described("curve_bands", {"amplitude": best[-1]})}
    made: dict[str, Any] = {}
    attrs = {"confidence": CONFIDENCE}
    normal = np.random.default_rng(seed).standard_normal((CURVE_DRAWS, len(steps)))
    for at, name in enumerate(MODEL_CURVES):
        root = 0.5 * np.array([more[at] - less[at] for more, less in zip(up, down, strict=True)])
        error = np.linalg.norm(root, axis=0)
        unit = root / np.where(error > 0.0, error, np.inf)
        # Process draw by draw: a table of all draws of a long record would not fit into memory.
        factor = simultaneous_factor(np.array([[np.max(np.abs(draw @ unit))] for draw in normal]))
        made[name] = best[at], error
        made |= {f"{name}_low": best[at] - factor * error, f"{name}_high": best[at] + factor * error}
        attrs[f"factor_{name}"] = factor
    return xr.Dataset(described("curve_bands", made), coords, attrs)


def _curves(
    likelihood: Fit, values: Array, run: int, time: Array, amplitudes: Array | None
) -> tuple[Array, ...]:
    """Return the curves for these parameters, in the order of `MODEL_CURVES`, and the amplitudes."""
    parameters, record = likelihood.parameters, likelihood.problem.records[run]
    model, (angle, rate, _) = parameters.model(values, run), parameters.per_run(values)[run]
    motion = record.angle + record.residual(model, parameters.per_run(values)[run])
    release = float(np.hypot(angle, rate / model.reference_frequency))
    envelope = predict_envelope(model, time, release).amplitude.values
    if amplitudes is None:
        amplitudes = np.geomspace(max(envelope.min(), 1e-2 * release), release, CURVE_GRID)
    change, frequency = averaged_rates(model)(amplitudes)
    return motion, envelope, frequency, -change / (amplitudes * frequency), amplitudes
