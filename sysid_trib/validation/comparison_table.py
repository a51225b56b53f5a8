"""What comes of several methods on the same runs, and its numbers as one table at one reference frequency."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.references import in_model, reference_factors
from sysid_trib.results.variables import described
from sysid_trib.validation import findings, holdout

# Parts of the runs on which residuals are, and texts or truths of a method.
PARTS = ("residual", "train", "holdout")
TEXTS = (
    *("reason", "failure", "bias", "identifies", "neglects", "cannot_tell_apart", "assumes", "family"),
    "white_noise",
)

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
    values = _residuals(motions, noises)
    ratio, held_out = (values[f"{part}_over_noise"] for part in ("residual", "holdout"))
    # The smallest RMS over the noise on the part held out; if no method has any, on the whole.
    whole = np.where([result is None for result in results], np.nan, np.nan_to_num(ratio, nan=np.inf))
    best = int(np.nanargmin(held_out if np.isfinite(held_out).any() else whole))
    reference, referred = _common_frequency(results, whole, best)
    forces = _forces(results)
    coefficients, errors = _coefficients(results, list(forces.force.values), reference)
    values |= {
        "coefficient": coefficients,
        "standard_error": errors,
        "z": contrast(coefficients, errors, best),
    }
    values |= {"common_frequency": reference, "noise": root_mean_square(noises)}
    for name in ("reference_frequency", "asymptotic_frequency"):
        values[name] = limit, error = tuple(
            np.array([np.nan if result is None else result[column].item() for result in results])
            for column in (name, f"{name}_standard_error")
        )
    values["asymptotic_frequency_z"] = contrast(limit[:, None], error[:, None], best)[:, 0]
    residuals = [[of_run.residual.values for of_run in of.get("holdout", [])] for of in motions]
    values["holdout_p_value"] = [
        holdout.diebold_mariano(some, residuals[best], blocks) if some else np.nan for some in residuals
    ]
    said = [{"bias": _bias(result)} | row for result, row in zip(results, rows, strict=True)]
    values |= {name: [row[name] for row in said] for name in ("time_taken", *TEXTS)}
    errors_of_z = "taken as independent; the methods saw the same noise, so that z is rather too small"
    attrs = {
        "best": labels[best],
        "common_frequency_of": labels[referred] if isinstance(referred, int) else referred,
        "errors_of_z": errors_of_z,
    }
    table = forces.assign_coords(method=labels).assign(described("comparison", values))
    return table.assign_attrs(attrs)


def _common_frequency(results: Results, whole: Array, best: int) -> tuple[float, int | str]:
    """A frequency that was given to a method, else that of the best, rad/s; and whose it is.

    Where the best predicts by accident, as its model misses the record as a whole, it is that of the model
    that misses it least: its own may be far off. `whole` : residual of the whole record over the noise.
    """
    for result in results:
        if result is not None and result.reference_frequency_standard_error == 0.0:
            return result.reference_frequency.item(), "given"
    least = int(np.nanargmin(whole))
    owner = least if whole[best] > findings.LARGE * whole[least] else best
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


def _residuals(
    motions: Sequence[Mapping[str, Sequence[xr.Dataset]]], noises: Sequence[float]
) -> dict[str, Any]:
    """RMS of the simulated models' residuals, of several runs of each too, and their largest phase."""
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
