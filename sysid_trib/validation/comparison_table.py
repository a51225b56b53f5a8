"""What comes of several methods on the same runs, and its numbers as one table at one reference frequency."""

from collections.abc import Mapping, Sequence
from math import floor, log10
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.references import in_model, reference_factors
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable, with_error
from sysid_trib.validation.cross_check import LARGE
from sysid_trib.validation.holdout import diebold_mariano

# Of each part of the runs: the first word of its columns, and what they are of.
PARTS = {
    "residual": "on the whole record",
    "train": "on the first two thirds, from which it is identified",
    "holdout": "on the last third, held out",
}
# Of several texts or truths of a method: name of the variable, and what it says.
TEXTS = {
    "reason": "why numbers are missing, or not to be trusted",
    "failure": "why its model says nothing of the record, though it neglects no force",
    "bias": "known bias that is left in",
    "identifies": "forces identified, and by what",
    "neglects": "forces offered that are left out",
    "cannot_tell_apart": "forces that are the same to it",
    "assumes": "what the method assumes",
    "family": "kind of method, for figures",
    "white_noise": "its errors hold in white noise only",
}
CONTRAST = "difference from the best method over the errors of both"


# What came of one method: its identification; what it says of itself and of that, by the name of the column;
# and of each of `PARTS` the `motion_residual` in each run, none where there is no motion.
Results: TypeAlias = Sequence[xr.Dataset | None]
Trial: TypeAlias = tuple[xr.Dataset | None, dict[str, Any], dict[str, list[xr.Dataset]]]


def method_table(trials: Mapping[str, Trial], noises: Sequence[float], blocks: Sequence[int]) -> xr.Dataset:
    """The group `comparison` (see `compare`).

    Parameters
    ----------
    trials : mapping of str to Trial
        What came of each method, by its label.
    noises : sequence of float, rad
        Of each run, the same for all methods.
    blocks : sequence of int
        Samples of a period of each run.
    """
    labels = list(trials)
    results, rows, motions = zip(*trials.values(), strict=True)
    variables = _residuals(motions, noises)
    ratio, held_out = (variables[f"{part}_over_noise"][1] for part in ("residual", "holdout"))
    # The smallest RMS over the noise on the part held out; if no method has any, on the whole.
    whole = np.where([result is None for result in results], np.nan, np.nan_to_num(ratio, nan=np.inf))
    best = int(np.nanargmin(held_out if np.isfinite(held_out).any() else whole))
    reference, referred = _common_frequency(results, whole, best)
    forces = _forces(results)
    values, errors = _coefficients(results, list(forces.force.values), reference)
    dims = ("method", "force")
    variables |= {
        "coefficient": variable(dims, values, "coefficient at the common frequency", PER_FORCE_UNIT),
        "standard_error": variable(dims, errors, "standard error of the coefficient", PER_FORCE_UNIT),
        "z": variable(dims, contrast(values, errors, best), CONTRAST, "1"),
        "common_frequency": variable((), reference, "frequency to which coefficients refer", "rad/s"),
        "noise": variable((), root_mean_square(noises), "standard deviation of the sensor's noise", "rad"),
    }
    variables |= _frequencies(results, best)
    residuals = [[of_run.residual.values for of_run in of.get("holdout", [])] for of in motions]
    p_values = [diebold_mariano(some, residuals[best], blocks) if some else np.nan for some in residuals]
    text = "p-value of the difference from the best on the part held out"
    variables["holdout_p_value"] = variable("method", p_values, text, "1")
    seconds = [row["time_taken"] for row in rows]
    variables["time_taken"] = variable("method", seconds, "time of the whole identification", "s")
    biases = [{"bias": _bias(result)} | row for result, row in zip(results, rows, strict=True)]
    variables |= {k: variable("method", [row[k] for row in biases], text) for k, text in TEXTS.items()}
    errors_of_z = "taken as independent; the methods saw the same noise, so that z is rather too small"
    attrs = {
        "best": labels[best],
        "common_frequency_of": labels[referred] if isinstance(referred, int) else referred,
        "errors_of_z": errors_of_z,
    }
    return forces.assign_coords(method=labels).assign(variables).assign_attrs(attrs)


def applied_methods(table: xr.Dataset) -> xr.Dataset:
    """The methods of a comparison that gave a coefficient or a frequency, and whose models did not fail.

    The one that predicts best stays, whatever it does on the whole: the others are held against it.
    """
    applied = table.coefficient.notnull().any("force") | table.asymptotic_frequency.notnull()
    failed = (table.failure != "") & (table.method != table.attrs["best"])
    return table.isel(method=np.flatnonzero((applied & ~failed).values))


def column_power(column: xr.Dataset) -> int:
    """Power of ten of a column: of the best method's value or error, of all if it has none."""
    best = column.sel({"method": column.attrs["best"]})
    size = max(abs(best.coefficient.item()), best.standard_error.item())
    if not (np.isfinite(size) and size > 0.0):
        size = float(np.nanmedian(np.abs(column.coefficient.values)))
    power = floor(log10(size)) if np.isfinite(size) and size > 0.0 else 0
    return 0 if -2 < power < 4 else power


def _common_frequency(results: Results, whole: Array, best: int) -> tuple[float, int | str]:
    """A frequency that was given to a method, else that of the best, rad/s; and whose it is.

    Where the best predicts by accident, as its model misses the record as a whole, it is that of the model
    that misses it least: its own may be far off. `whole` : residual of the whole record over the noise.
    """
    for result in results:
        if result is not None and result.reference_frequency_standard_error == 0.0:
            return result.reference_frequency.item(), "given"
    least = int(np.nanargmin(whole))
    owner = least if whole[best] > LARGE * whole[least] else best
    return results[owner].reference_frequency.item(), owner  # type: ignore[union-attr]


def _forces(results: Results) -> xr.Dataset:
    """The forces that any method found, in the order of the result with most of them."""
    labels: dict[str, list[str]] = {}
    for result in sorted((r for r in results if r is not None), key=lambda r: -r.sizes["force"]):
        for symbol in result.force.values.tolist():
            force = result.sel(force=symbol)
            labels.setdefault(symbol, [force[k].item() for k in ("name", "formula", "unit")])
    named = zip(("name", "formula", "unit"), zip(*labels.values(), strict=True), strict=True)
    return xr.Dataset(coords={"force": list(labels)} | {k: ("force", list(v)) for k, v in named})


def _coefficients(results: Results, forces: Sequence[str], reference: float) -> tuple[Array, Array]:
    """Coefficients and errors, (method, force), nan where a method has none.

    Those that refer to another frequency by their definition, or cannot be converted, keep theirs.
    """
    values, errors = np.full((2, len(results), len(forces)), np.nan)
    for row, result in enumerate(results):
        if result is None:
            continue
        symbols = result.force.values.tolist()
        in_own_model = np.array([in_model(result, symbol) for symbol in symbols])
        converted = np.where(in_own_model, reference_factors(result, symbols, reference), 1.0)
        at = [forces.index(symbol) for symbol in symbols]
        values[row, at] = result.coefficient.values * converted
        errors[row, at] = result.standard_error.values * converted
    return values, errors


def contrast(values: Array, errors: Array, best: int) -> Array:
    """Differences from the best method's row over the root of the sum of both variances."""
    both = np.sqrt(errors**2 + errors[best] ** 2)
    z = np.divide(values - values[best], both, out=np.full_like(values, np.nan), where=both > 0.0)
    z[best, np.isfinite(values[best])] = 0.0
    return z


def _frequencies(results: Results, best: int) -> Variables:
    """Reference and asymptotic frequencies with errors, and the difference of the latter from the best."""
    variables: Variables = {}
    for name in ("reference_frequency", "asymptotic_frequency"):
        limit, error = (
            np.array([np.nan if result is None else result[column].item() for result in results])
            for column in (name, f"{name}_standard_error")
        )
        variables |= with_error(name, "method", (limit, error), name.replace("_", " "), "rad/s")
    z = contrast(limit[:, None], error[:, None], best)[:, 0]
    return variables | {"asymptotic_frequency_z": variable("method", z, CONTRAST, "1")}


def _residuals(motions: Sequence[Mapping[str, Sequence[xr.Dataset]]], noises: Sequence[float]) -> Variables:
    """RMS of the simulated models' residuals, of several runs of each too, and their largest phase."""
    variables: Variables = {}
    nothing = np.full(len(noises), np.nan)
    for name, of in PARTS.items():
        of_runs = [[root_mean_square(of_run.residual) for of_run in part.get(name, [])] for part in motions]
        rms, long_name = np.array([row or nothing for row in of_runs]), f"RMS of record minus model {of}"
        whole, ratio = ([root_mean_square(row) for row in rows] for rows in (rms, rms / np.array(noises)))
        variables[f"{name}_rms"] = variable("method", whole, long_name, "rad")
        variables[f"{name}_over_noise"] = variable("method", ratio, f"{long_name}, over the noise", "1")
        if len(noises) > 1:
            text = f"{long_name}, of each run"
            variables[f"run_{name}_rms"] = variable(("method", "run"), rms, text, "rad")
    if len(noises) > 1:
        variables["run_noise"] = variable("run", list(noises), "noise of one sample of the run", "rad")
    slips = [[of_run.phase_error.item() for of_run in part.get("residual", [])] for part in motions]
    phases = [float(np.max(phase or [np.nan])) for phase in slips]
    text = "largest phase between model and record, nan if it stops"
    return variables | {"phase_error": variable("method", phases, text, "rad")}


def _bias(result: xr.Dataset | None) -> str:
    """A bias of its own that a method says it has left in."""
    if result is None:
        return ""
    removed = str(result.attrs.get("first_order_bias_removed", "yes"))
    if removed == "no" or removed.startswith("no:"):
        why = removed[2:].strip(" :.")
        return f"first-order bias not removed{': ' + why if why else ''}"
    if result.attrs.get("refined", "True") != "True":
        return "columns from the smoothed record, whose noise biases them"
    return ""
