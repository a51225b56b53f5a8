"""The numbers of several methods as one table, at one reference frequency."""

from collections.abc import Sequence
from math import floor, log10
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.records.runs import root_mean_square
from sysid_trib.results.common_reference import factors, in_model
from sysid_trib.validation.holdout import diebold_mariano
from sysid_trib.validation.trial import Trial

Array = NDArray[np.float64]
Columns = dict[str, tuple[Any, str, str]]

# Name of a column, the attribute of a trial, and what it is of.
PARTS = (
    ("residual", "whole", "on the whole record"),
    ("train", "train", "on the first two thirds, from which it is identified"),
    ("holdout", "holdout", "on the last third, held out"),
)


def method_table(trials: Sequence[Trial], noises: Sequence[float], blocks: Sequence[int]) -> xr.Dataset:
    """The group `comparison` (see `compare`).

    Parameters
    ----------
    noises : rad, of each run, the same for all methods; blocks : samples of a period of each run.
    """
    best = best_of(trials)
    reference, referred = _common_frequency(trials, best)
    forces = _forces(trials)
    values, errors = _coefficients(trials, list(forces.force.values), reference)
    at = [trial.label for trial in trials].index(best.label)
    own = {"units": "see the coordinate unit"}
    both = ("method", "force")
    table = forces.assign_coords(method=[trial.label for trial in trials])
    table = table.assign(
        coefficient=(both, values, own | {"long_name": "coefficient at the common frequency"}),
        standard_error=(both, errors, own | {"long_name": "standard error of the coefficient"}),
        z=(
            both,
            _apart(values, errors, at),
            {"units": "1", "long_name": "difference from the best method over the errors of both"},
        ),
        common_frequency=(
            (),
            reference,
            {"units": "rad/s", "long_name": "frequency to which coefficients refer"},
        ),
        noise=(
            (),
            root_mean_square(noises),
            {"units": "rad", "long_name": "noise of one sample, the record's"},
        ),
    )
    columns = _frequencies(trials, at) | _residuals(trials, best, blocks) | _texts(trials)
    for name, (column, units, long_name) in columns.items():
        attrs = {"long_name": long_name} | ({"units": units} if units else {})
        table[name] = ("method", column, attrs)
    if len(noises) > 1:
        table = table.assign(_each_run(trials, noises))
    return table.assign_attrs(
        best=best.label,
        common_frequency_of=referred,
        errors_of_z="taken as independent; the methods saw the same noise, so that z is rather too small",
    )


def best_of(trials: Sequence[Trial]) -> Trial:
    """The method with the smallest RMS over the noise on the part held out; if none has any, on the whole."""
    held_out = [trial for trial in trials if trial.holdout is not None]
    if held_out:
        return min(held_out, key=lambda trial: trial.holdout.over_noise if trial.holdout else np.inf)
    decided = [trial for trial in trials if trial.result is not None]
    return min(decided, key=lambda trial: trial.whole.over_noise if trial.whole else np.inf)


def column_power(one: xr.Dataset) -> int:
    """Power of ten of a column: of the best method's value or error, of all if it has none."""
    best = one.sel({"method": one.attrs["best"]})
    size = max(abs(best.coefficient.item()), best.standard_error.item())
    if not (np.isfinite(size) and size > 0.0):
        size = float(np.nanmedian(np.abs(one.coefficient.values)))
    power = floor(log10(size)) if np.isfinite(size) and size > 0.0 else 0
    return 0 if -2 < power < 4 else power


def _common_frequency(trials: Sequence[Trial], best: Trial) -> tuple[float, str]:
    """A frequency that was given to a method, else that of the best, rad/s; and whose it is."""
    for trial in trials:
        if trial.result is not None and trial.result.reference_frequency_standard_error == 0.0:
            return trial.result.reference_frequency.item(), "given"
    assert best.result is not None
    return best.result.reference_frequency.item(), best.label


def _forces(trials: Sequence[Trial]) -> xr.Dataset:
    """The forces that any method found, in the order of the result with most of them."""
    results = sorted((t.result for t in trials if t.result is not None), key=lambda r: -r.sizes["force"])
    labels: dict[str, list[str]] = {}
    for result in results:
        for symbol in result.force.values.tolist():
            one = result.sel(force=symbol)
            labels.setdefault(symbol, [one[k].item() for k in ("name", "formula", "unit")])
    named = zip(("name", "formula", "unit"), zip(*labels.values(), strict=True), strict=True)
    return xr.Dataset(coords={"force": list(labels)} | {k: ("force", list(v)) for k, v in named})


def _coefficients(trials: Sequence[Trial], forces: Sequence[str], reference: float) -> tuple[Array, Array]:
    """Coefficients and errors, (method, force), nan where a method has none.

    Those that refer to another frequency by their definition, or cannot be converted, keep theirs.
    """
    values, errors = np.full((2, len(trials), len(forces)), np.nan)
    for row, trial in enumerate(trials):
        if trial.result is None:
            continue
        symbols = trial.result.force.values.tolist()
        converted = factors(trial.result, symbols, reference)
        own = np.array([in_model(trial.result, symbol) for symbol in symbols])
        at = [list(forces).index(symbol) for symbol in symbols]
        converted = np.where(own, converted, 1.0)
        values[row, at] = trial.result.coefficient.values * converted
        errors[row, at] = trial.result.standard_error.values * converted
    return values, errors


def _apart(values: Array, errors: Array, best: int) -> Array:
    """Differences from the best method's row over the root of the sum of both variances."""
    both = np.sqrt(errors**2 + errors[best] ** 2)
    apart = np.divide(values - values[best], both, out=np.full_like(values, np.nan), where=both > 0.0)
    apart[best, np.isfinite(values[best])] = 0.0
    return apart


def _frequencies(trials: Sequence[Trial], best: int) -> Columns:
    names = ("reference_frequency", "asymptotic_frequency")
    columns: Columns = {}
    for name in names:
        told = name.replace("_", " ")
        columns[name] = (_scalars(trials, name), "rad/s", told)
        error = f"{name}_standard_error"
        columns[error] = (_scalars(trials, error), "rad/s", f"standard error of the {told}")
    limit, error = columns[names[1]][0], columns[f"{names[1]}_standard_error"][0]
    apart = _apart(limit[:, None], error[:, None], best)[:, 0]
    columns[f"{names[1]}_z"] = (apart, "1", "difference from the best method over the errors of both")
    return columns


def _scalars(trials: Sequence[Trial], name: str) -> Array:
    return np.array([np.nan if t.result is None else t.result[name].item() for t in trials])


def _residuals(trials: Sequence[Trial], best: Trial, blocks: Sequence[int]) -> Columns:
    """RMS of the simulated models' residuals, p-value of the prediction's, phase error and time."""
    columns: Columns = {}
    for name, attribute, told in PARTS:
        motions = [getattr(trial, attribute) for trial in trials]
        rms = [np.nan if motion is None else motion.rms for motion in motions]
        ratio = [np.nan if motion is None else motion.over_noise for motion in motions]
        told = f"RMS of record minus model {told}"
        columns[f"{name}_rms"] = (np.array(rms), "rad", told)
        columns[f"{name}_over_noise"] = (np.array(ratio), "1", f"{told}, over the noise")
    nothing = float("nan")
    each = [None if t.holdout is None else [run.residual for run in t.holdout.runs] for t in trials]
    least = each[[t.label for t in trials].index(best.label)]
    p_values = [diebold_mariano(some, least, blocks) if some and least else nothing for some in each]
    phases = [t.whole.phase_error if t.whole else nothing for t in trials]
    name = "p-value of the difference from the best on the part held out"
    columns["holdout_p_value"] = (np.array(p_values), "1", name)
    columns["phase_error"] = (
        np.array(phases),
        "rad",
        "largest phase between model and record, nan if it stops",
    )
    columns["time_taken"] = (np.array([t.seconds for t in trials]), "s", "time of the whole identification")
    return columns


def _each_run(trials: Sequence[Trial], noises: Sequence[float]) -> dict[str, Any]:
    """RMS of the simulated models' residuals in each of several runs, and its noise."""
    variables: dict[str, Any] = {
        "run_noise": ("run", list(noises), {"units": "rad", "long_name": "noise of one sample of the run"})
    }
    lost = np.full(len(noises), np.nan)
    for name, attribute, told in PARTS:
        motions = [getattr(trial, attribute) for trial in trials]
        rms = np.stack([lost if motion is None else motion.each_rms for motion in motions])
        attrs = {"units": "rad", "long_name": f"RMS of record minus model {told}, of each run"}
        variables[f"run_{name}_rms"] = (("method", "run"), rms, attrs)
    return variables


def _texts(trials: Sequence[Trial]) -> Columns:
    return {
        "reason": ([t.reason for t in trials], "", "why numbers are missing, or not to be trusted"),
        "bias": ([_bias(t.result) for t in trials], "", "known bias that is left in"),
        "identifies": ([t.forces.identifies for t in trials], "", "forces identified, and by what"),
        "neglects": ([t.forces.neglects for t in trials], "", "forces offered that are left out"),
        "cannot_tell_apart": (
            [t.forces.cannot_tell_apart for t in trials],
            "",
            "forces that are the same to it",
        ),
        "assumes": ([t.scope.assumes for t in trials], "", "what the method assumes"),
        "family": ([t.scope.family for t in trials], "", "kind of method, for figures"),
        "white_noise": (
            [t.scope.white_noise for t in trials],
            "",
            "its errors hold in white noise only",
        ),
    }


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
