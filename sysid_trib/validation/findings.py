"""Properties of a result: stored when it is made, and read from its tree."""

import json
from collections.abc import Sequence
from math import floor, log10

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.records import inputs, smoothing
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.effects import significant, sufficient_forces
from sysid_trib.results.files import identifications_of, kind_of
from sysid_trib.results.variables import Variables, described, group_names, record_groups

# Beyond so many noise levels (RMS) a residual is large.
LARGE = 1.5
DIVERGES = "its motion diverges"
# Default held-out part of `discover`.
LAST_THIRD = "the last third"


def with_noise_and_models(decay: xr.Dataset, names: Sequence[str], simulated: Array) -> xr.Dataset:
    """Return a record with `simulated_angle(model, time)`, `residual(model, time)` and its `noise`, rad.

    Tables, sentences and figures show residuals over this noise, whatever the model. Of a driven record,
    whose motion no spline follows, it is no more than the residual of a model.
    """
    noise = smoothing.sensor_noise(decay)
    if inputs.inputs_of(decay):
        remains = np.std(decay.angle.values - simulated, axis=1)
        noise = float(np.nanmin(remains, initial=noise))
    values = {"simulated_angle": simulated, "residual": decay.angle.values - simulated, "noise": noise}
    return decay.assign_coords(model=list(names)).assign(described("record", values))


def failure_of_models(records: Sequence[xr.Dataset]) -> Variables:
    """Return why a model has no motion, in a few words; empty if it has one."""
    reasons = []
    largest = [np.abs(run.simulated_angle).max("time", skipna=False) for run in records]
    # Of the largest angle of the record; a motion that grows beyond is none of it.
    limits = [3.0 * np.abs(run.angle).max() for run in records]
    failed = [~(size <= limit).values for size, limit in zip(largest, limits, strict=True)]
    for of_model in np.transpose(failed):
        of_run = f" in run {np.argmax(of_model) + 1}" if len(records) > 1 else ""
        reasons.append(f"{DIVERGES}{of_run}" if of_model.any() else "")
    return described("cross_check", {"failure": reasons})


def residual_of(tree: xr.DataTree, model: str) -> float:
    """RMS of record minus model over all runs, rad; of an integrated signal that of `comparison`.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check` or `discover`.
    model : str
        Which of its models.

    Returns
    -------
    float
        nan of a model that diverges.
    """
    groups = record_groups(tree)
    if "comparison" in tree and int(tree[groups[0]].attrs.get("integrations", 0)):
        return float(tree["comparison"].residual_rms.sel(model=model).item())
    residuals = [(tree[g].angle - tree[g].simulated_angle.sel(model=model)).values for g in groups]
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))


def record_noise(tree: xr.DataTree) -> float:
    """The sensor's noise of the records in a result, rad: RMS over the runs."""
    return root_mean_square([tree[group].noise.item() for group in record_groups(tree)])


def residual_over_noise(tree: xr.DataTree, model: str) -> float:
    """Residual of a model over the sensor's noise of the record."""
    return residual_of(tree, model) / record_noise(tree)


def held_out_excess(tree: xr.DataTree) -> float:
    """Return the held-out residual of the final model of a discovery over the sensor noise.

    Zero where that is hardly more than what it leaves of the rest, where it was fitted to all in the end, and
    of driven records, whose noise no spline tells.
    """
    if is_refitted(tree) or inputs.inputs_of(tree[record_groups(tree)[0]].to_dataset()):
        return 0.0
    ratio = float(tree["holdout"].rms[-1]) / record_noise(tree)
    return ratio if ratio > LARGE * max(1.0, residual_over_noise(tree, "after")) else 0.0


def is_refitted(tree: xr.DataTree) -> bool:
    """True if the models of a discovery were fitted to the whole records in the end."""
    return bool(json.loads(tree.attrs["options"])["refit"]) and tree.attrs["held_out"].startswith(LAST_THIRD)


def verdict_of(tree: xr.DataTree) -> str:
    """The verdict of a cross-check on the record, one of `VERDICTS`."""
    return str(tree["comparison"].attrs["verdict_on_record"])


def holds(tree: xr.DataTree) -> bool:
    """Return true if the model of a cross-check is adequate: then its consequences are given."""
    return verdict_of(tree).startswith("explained") or verdict_of(tree) == "approximate"


def answer_of(tree: xr.DataTree) -> str:
    """Return the preferred method of a cross-check."""
    return str(tree["comparison"].attrs["answer"])


def second_of(tree: xr.DataTree) -> xr.Dataset:
    """The second identification of a cross-check."""
    return tree[str(tree["comparison"].attrs["second"])].to_dataset()


def failures(tree: xr.DataTree) -> dict[str, str]:
    """Return the methods of a cross-check whose models failed, and why."""
    reasons = tree["comparison"].failure
    return {name: why for name, why in zip(reasons.model.values, reasons.values.tolist(), strict=True) if why}


def kept_results(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications of a cross-check by the name of their method, without one that failed.

    Raises
    ------
    KeyError
        Two methods are not held against each other here.
    """
    checked = tree["comparison"].attrs
    names = (checked["first"], checked["second"])
    failed = failures(tree)
    return {name: tree[name].to_dataset() for name in names if name not in failed}


def given_results(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications that any result gives, by name: without methods that failed."""
    if kind_of(tree) == "discover":
        return {"start model": tree["before"].to_dataset(), "final model": tree["after"].to_dataset()}
    if kind_of(tree) == "compare":
        labels = applied_methods(tree["comparison"].to_dataset()).model.values.tolist()
        return {label: tree[label].to_dataset() for label in labels}
    return identifications_of(tree) if kind_of(tree) == "difference" else kept_results(tree)


def main_result(tree: xr.DataTree) -> xr.Dataset | None:
    """Return the main identification of a result: the best, final or preferred one; None without one."""
    if kind_of(tree) == "identify":
        return tree.to_dataset()
    if kind_of(tree) in ("", "difference"):
        return None
    named = given_results(tree)
    if kind_of(tree) == "discover":
        return named["final model"]
    best = tree["comparison"].attrs.get("best")
    return named[best] if best else named.get(answer_of(tree), next(reversed(named.values()), None))


def best(result: xr.Dataset | xr.DataTree) -> xr.Dataset:
    """Return the preferred identification of any result.

    Parameters
    ----------
    result : Dataset or DataTree
        Of `identify`, `laws`, `compare`, `discover`, or an identification itself.

    Returns
    -------
    Dataset
        The identification that the result prefers: see `identify`.

    Raises
    ------
    UsageError
        The result holds no identification, or several none of which is preferred.
    """
    if isinstance(result, xr.Dataset):
        if "coefficient" in result and "method" in result.attrs:
            return result
        preferred = None
    else:
        preferred = main_result(result)
    if preferred is None:
        raise UsageError("This result holds no preferred identification; give one of identify or laws.")
    return preferred


def fewer_forces(tree: xr.DataTree) -> list[dict[str, tuple[float, float]]]:
    """The fewest forces that suffice, see `sufficient_forces`, where no coefficient is known by itself."""
    result = kept_results(tree).get(answer_of(tree))
    if result is None or not holds(tree) or significant(result).any():
        return []
    return [forces for forces in sufficient_forces(result) if len(forces) < result.sizes["force"]]


def with_error_parts(result: xr.Dataset) -> xr.Dataset:
    """An identification with `error_of_noise` and `error_of_model`, the parts of its standard errors."""
    noise, model = error_parts(result)
    return result.assign(error_of_noise=("force", noise), error_of_model=("force", model))


def amplitudes(tree: xr.DataTree) -> Array:
    """Amplitudes of the half periods of all runs, rad."""
    groups = group_names("envelope", len(record_groups(tree)))
    return np.concatenate([tree[group].amplitude.values for group in groups])


def times_of_amplitudes(tree: xr.DataTree) -> Array:
    """Since the first sample of their run, s: `t` of the formulas at each of the `amplitudes`."""
    groups = record_groups(tree)
    pairs = zip(groups, group_names("envelope", len(groups)), strict=True)
    return np.concatenate([tree[half].instant_time.values - tree[run].time.values[0] for run, half in pairs])


def error_parts(result: xr.Dataset) -> tuple[Array, Array]:
    """Errors of the coefficients by the noise and by the model, (force,) each."""
    if "error_of_model" not in result:
        calibration = result["error_of_calibration"].values if "error_of_calibration" in result else 0.0
        stated = np.sqrt(np.maximum(result.standard_error.values**2 - calibration**2, 0.0))
        return stated, np.zeros(result.sizes["force"])
    return result.error_of_noise.values, result.error_of_model.values


def applied_methods(table: xr.Dataset) -> xr.Dataset:
    """The methods of a comparison that gave a coefficient or a frequency, and whose models did not fail.

    The one that predicts best stays, whatever it does on the whole: the others are held against it.
    """
    applied = table.coefficient.notnull().any("force") | table.asymptotic_frequency.notnull()
    failed = (table.failure != "") & (table.model != table.attrs["best"])
    return table.isel(model=np.flatnonzero((applied & ~failed).values))


def column_power(column: xr.Dataset) -> int:
    """Power of ten of a column: of the best method's value or error, of all if it has none."""
    best = column.sel(model=column.attrs["best"])
    size = max(abs(best.coefficient.item()), best.standard_error.item())
    if not (np.isfinite(size) and size > 0.0):
        size = float(np.nanmedian(np.abs(column.coefficient.values)))
    power = floor(log10(size)) if np.isfinite(size) and size > 0.0 else 0
    return 0 if -2 < power < 4 else power
