"""Prediction of held-out data, and the table of all methods."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.records.smoothing import least_squares_spline
from sysid_trib.results import judged, schema, variables
from sysid_trib.results.models import in_model, library_of
from sysid_trib.simulation import internal_states
from sysid_trib.simulation.initial_conditions import FittedMotion
from sysid_trib.validation import common_reference, judge, refits
from sysid_trib.validation.residuals import FollowedRuns, fitted_motion, motion_residual

# Fraction of a decay's duration from which a model is identified if the rest is to be predicted.
TRAINING = 2.0 / 3.0


def first_held_out(time: Array) -> int:
    """Return the index of the first sample of the last third of a record, by time.

    Parameters
    ----------
    time : (sample,) array of float, s
        Times of the record.
    """
    return int(np.searchsorted(time, time[0] + TRAINING * (time[-1] - time[0])))


def split(decay: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the first two thirds of a decay by time, and the last third."""
    first = first_held_out(decay.time.values.astype(float))
    return decay.isel(time=slice(0, first)), decay.isel(time=slice(first, None))


def up_to_held_out(decay: xr.Dataset) -> xr.Dataset:
    """Return the first two thirds of a decay, plus the first sample of the last third."""
    return decay.isel(time=slice(0, first_held_out(decay.time.values.astype(float)) + 1))


def motions_held_out(result: xr.Dataset, runs: Sequence[xr.Dataset]) -> list[FittedMotion | None]:
    """Return the motion, in the last third of each run, of a model identified from the rest."""
    library = library_of(result, whole=True)
    pairs = [(split(run)[1], carried_on(result, library, up_to_held_out(run))) for run in runs]
    return [fitted_motion(rest, later, at) for at, (rest, later) in enumerate(pairs)]


def in_all_runs(
    runs: Sequence[xr.Dataset], motions: Sequence[FittedMotion | None], envelopes: Sequence[xr.Dataset]
) -> list[xr.Dataset]:
    """Return `motion_residual` of a model in each run, or part of it; empty if it diverges in one.

    `envelopes` : envelopes of the whole runs.
    """
    triples = zip(runs, motions, envelopes, strict=True)
    of_runs = [motion_residual(run, motion, whole) for run, motion, whole in triples if motion is not None]
    moving = len(of_runs) == len(runs) and all(np.all(np.isfinite(of_run.residual)) for of_run in of_runs)
    return of_runs if moving else []


def failure_of(runs: Sequence[xr.Dataset], motions: Sequence[xr.Dataset]) -> str:
    """Return the reason why a complete model fails on the records (`in_all_runs`); else empty."""
    if not motions:
        return judge.DIVERGES
    for at, (run, motion) in enumerate(zip(runs, motions, strict=True)):
        of_run = f" of run {at + 1}" if len(runs) > 1 else ""
        thirds = (np.array_split(values, 3) for values in (run.angle.values, motion.residual.values))
        for name, angle, missed in zip(("first", "second", "last"), *thirds, strict=True):
            if np.sum(missed**2) >= np.sum(angle**2):
                return f"over the {name} third{of_run} its motion is no nearer to the record than rest"
    return ""


def carried_on(result: xr.Dataset, library: ForceLibrary, before: xr.Dataset) -> xr.Dataset:
    """Return the identification for a motion that continues at the last sample of `before`.

    Parameters
    ----------
    result : Dataset
        The identification of the model.
    library : ForceLibrary
        Forces of the model, with `t` counted from the first sample of `before`.
    before : Dataset
        `angle(time)` up to the start of the motion.
    """
    model = schema.model_of(result)
    time = before.time.values.astype(float)
    elapsed = time - time[0]
    tau = model.reference_frequency * elapsed
    if len(time) > 1 and not all(force.memoryless for force in library):
        spline, x = least_squares_spline(tau, before.angle.values.astype(float))
        motion = tau, x, spline(tau, 1)
        forces = [internal_states.begun_after(force, *motion, model.shapes, elapsed) for force in library]
        library = replace(library, forces=tuple(forces))
    later = result.assign_attrs(library=library.counted_from(float(elapsed[-1])).to_toml())
    return later.drop_vars(["start_angle", "start_rate"], errors="ignore")


def diebold_mariano(first: Sequence[Array], second: Sequence[Array], blocks: Sequence[int]) -> float:
    """Return the p-value of equal squared residuals of two models (Diebold-Mariano test, two-sided).

    Parameters
    ----------
    first, second : sequence of (sample,) array of float, rad
        Residuals of each model in the same runs.
    blocks : sequence of int
        Number of samples in each run over which residuals may be correlated: a period.

    Returns
    -------
    float
        P-value of equal predictions; nan with fewer than three blocks.

    Notes
    -----
    Diebold and Mariano 1995, with the log mean square over a block as the loss, so that the last swings of a
    decay count as much as its first. Blocks are taken as independent, so Student's t-test applies.
    """
    of_runs = zip(first, second, blocks, strict=True)
    losses = [_block_losses(own, block) - _block_losses(other, block) for own, other, block in of_runs]
    difference = np.concatenate(losses)
    if len(difference) >= 3 and np.ptp(difference) == 0.0:
        return float(difference[0] == 0.0)
    return float(2.0 * scipy.stats.t.sf(abs(mean_over_error(difference)), len(difference) - 1))


def mean_over_error(difference: Array) -> float:
    """Return the mean difference of two predictions over its standard error (Diebold-Mariano).

    Parameters
    ----------
    difference : (period,) array of float
        Differences of a loss or a score in each period; periods are taken as independent.

    Returns
    -------
    float
        Student's t, with the number of periods minus 1 as degrees of freedom; nan with fewer than three or
        with equal ones.
    """
    if len(difference) < 3 or np.ptp(difference) == 0.0:
        return float("nan")
    return float(difference.mean() / (difference.std(ddof=1) / np.sqrt(len(difference))))


def _block_losses(residual: Array, block: int) -> Array:
    """Return the logarithm of the mean square of a residual over each whole block."""
    count = len(residual) // block
    squares = np.mean(residual[: count * block].reshape(count, block) ** 2, axis=1)
    return np.asarray(np.log(np.maximum(squares, 1e-300)))


# Parts of the runs that have residuals, and text or true-or-false columns of a method.
PARTS = ("residual", "train", "holdout")
TEXTS = (
    *("reason", "failure", "bias", "identifies", "neglects", "cannot_tell_apart", "assumes", "family"),
    "white_noise",
)

Results: TypeAlias = Sequence[xr.Dataset | None]


class MethodResult(NamedTuple):
    """Result of one method.

    Attributes
    ----------
    result : Dataset or None
        Identification by the method.
    row : dict
        Texts of the method on itself and its result, by the name of the column.
    motions : dict of str to list of Dataset
        For each of `PARTS`, the `motion_residual` in each run; empty without a motion.
    followed : FollowedRuns or None
        The runs with this identification.
    """

    result: xr.Dataset | None
    row: dict[str, Any]
    motions: dict[str, list[xr.Dataset]]
    followed: FollowedRuns | None = None


def method_table(
    by_label: Mapping[str, MethodResult], noises: Sequence[float], blocks: Sequence[int]
) -> xr.Dataset:
    """Return the group `comparison` (see `compare`).

    Parameters
    ----------
    by_label : mapping of str to MethodResult
        Result of each method, by its label.
    noises : sequence of float, rad
        Noise of each run, the same for all methods.
    blocks : sequence of int
        Samples per period of each run.
    """
    labels, (results, rows, motions, _) = list(by_label), zip(*by_label.values(), strict=True)
    values: dict[str, Any] = {name: [row[name] for row in rows] for name in ("time_taken", *TEXTS)}
    values |= _residuals(motions, noises)
    ratio, held_out = (values[f"{part}_over_noise"] for part in ("residual", "holdout"))
    # Best is the smallest RMS over the noise on the held-out part; if no method has one, on the whole.
    whole = np.where([result is None for result in results], np.nan, np.nan_to_num(ratio, nan=np.inf))
    # Compare the coefficients with those of the best method that has some.
    names_forces = np.array([row["names_forces"] for row in rows])
    values["names_forces"] = names_forces
    if any(result is not None for result, named in zip(results, names_forces, strict=True) if named):
        pairs = zip(results, names_forces, strict=True)
        results = tuple(result if named else None for result, named in pairs)
        held_out, whole = (np.where(names_forces, ratios, np.nan) for ratios in (held_out, whole))
    best = int(np.nanargmin(held_out if np.isfinite(held_out).any() else whole))
    reference, of_reference = _common_frequency(results, labels, whole, best)
    forces = _forces(results)
    values |= {"common_frequency": reference, "noise": root_mean_square(noises)}
    values["coefficient"], values["standard_error"] = _coefficients(results, forces, reference)
    values["z"] = contrast(values["coefficient"], values["standard_error"], best)
    for name in ("reference_frequency", "asymptotic_frequency"):
        values[name] = tuple(refits.scalars_of(results, name))
    limit, error = values["asymptotic_frequency"]
    values["asymptotic_frequency_z"] = contrast(limit[:, None], error[:, None], best)[:, 0]
    residuals = [[of_run.residual.values for of_run in of.get("holdout", [])] for of in motions]
    values["holdout_p_value"] = [
        diebold_mariano(some, residuals[best], blocks) if some else np.nan for some in residuals
    ]
    attrs = {
        "best": labels[best],
        "common_frequency_of": of_reference,
        "errors_of_z": "taken as independent; the methods saw the same noise, so that z is rather too small",
    }
    return xr.Dataset(variables.described("comparison", values), {**forces.coords, "model": labels}, attrs)


def _common_frequency(results: Results, labels: Sequence[str], whole: Array, best: int) -> tuple[float, str]:
    """Return a frequency that a method was given, else that of the best (rad/s), and its owner.

    If the best predicts well by accident, because its model does not follow the whole record, use the
    frequency of the model with the smallest residual instead, because the best's own may be wrong. `whole` :
    residual of the whole record over the noise.
    """
    known = [result for result in results if result is not None]
    given = [r for r in known if r.reference_frequency_standard_error == 0.0]
    least = int(np.nanargmin(whole))
    owner = least if whole[best] > judged.LARGE * whole[least] else best
    of = given[0] if given else results[owner]
    return of.reference_frequency.item(), "given" if given else labels[owner]  # type: ignore[union-attr]


def _forces(results: Results) -> xr.Dataset:
    """Return the forces that any method identified, in the order of the result with most of them."""
    known = sorted((result for result in results if result is not None), key=lambda r: -r.sizes["force"])
    labels = ["name", "formula", "unit"]
    of_forces = xr.concat([result.reset_coords()[labels] for result in known], "force")
    return of_forces.drop_duplicates("force").set_coords(labels)


def _coefficients(results: Results, forces: xr.Dataset, reference: float) -> tuple[Array, Array]:
    """Return coefficients and errors, (method, force), nan if a method has none.

    Coefficients that refer to another frequency by definition, cannot be converted, or are held, keep their
    reference.
    """
    values, errors = np.full((2, len(results), forces.sizes["force"]), np.nan)
    for row, result in enumerate(results):
        if result is not None:
            symbols = result.force.values.tolist()
            own = [in_model(result, symbol) for symbol in symbols] & ~common_reference.held(result)
            factors = np.where(own, common_reference.reference_factors(result, symbols, reference), 1.0)
            at = forces.indexes["force"].get_indexer(symbols)
            values[row, at] = result.coefficient.values * factors
            errors[row, at] = result.standard_error.values * factors
    return values, errors


def contrast(values: Array, errors: Array, best: int) -> Array:
    """Return differences from the best method's row over the root of the sum of both variances."""
    # For most methods of the table, the influence of the noise, which `cross_check.comparison` needs, is
    # unknown.
    both = np.sqrt(errors**2 + errors[best] ** 2)
    z = np.divide(values - values[best], both, out=np.full_like(values, np.nan), where=both > 0.0)
    z[best, np.isfinite(values[best])] = 0.0
    return z


def _residuals(
    motions: Sequence[Mapping[str, Sequence[xr.Dataset]]], noises: Sequence[float]
) -> dict[str, Any]:
    """Return RMS of the simulated models' residuals, also of each of several runs, and the largest phase."""
    values: dict[str, Any] = {}
    nothing = np.full(len(noises), np.nan)
    for name in PARTS:
        of_runs = [[root_mean_square(of_run.residual) for of_run in part.get(name, [])] for part in motions]
        rms = np.array([row or nothing for row in of_runs])
        values[f"{name}_rms"] = [root_mean_square(row) for row in rms]
        values[f"{name}_over_noise"] = np.array([root_mean_square(row) for row in rms / np.array(noises)])
        if len(noises) > 1:
            values[f"run_{name}_rms"] = rms
    if len(noises) > 1:
        values["run_noise"] = list(noises)
    slips = [[of_run.phase_error.item() for of_run in part.get("residual", [])] for part in motions]
    return values | {"phase_error": [float(np.max(phase or [np.nan])) for phase in slips]}
