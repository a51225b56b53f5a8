"""What comes of several methods on the same runs, and its numbers as one table at one reference frequency."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, log10

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.methods.scope import ForceScope, MethodScope
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.references import in_model, reference_factors
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable, with_error
from sysid_trib.validation.cross_check import LARGE
from sysid_trib.validation.holdout import diebold_mariano
from sysid_trib.validation.residuals import ModelResiduals

# Name of a column, the attribute of a trial, and what it is of.
PARTS = (
    ("residual", "whole", "on the whole record"),
    ("train", "train", "on the first two thirds, from which it is identified"),
    ("holdout", "holdout", "on the last third, held out"),
)
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


@dataclass(frozen=True)
class Trial:
    """What came of one method.

    Attributes
    ----------
    label : str
        Its name in the table.
    scope : MethodScope
        What it says of itself.
    forces : ForceScope
        What it makes of the forces offered.
    result : Dataset, or None
        Its identification.
    seconds : float, s
        The time that took.
    whole, train, holdout : ModelResiduals
        Of its model on the whole record; of the model of the first two thirds on these, and on the last
        third. Without runs where there is no motion.
    reason : str
        Why there are none, or why they are not to be trusted.
    failure : str
        Why its model says nothing of the record although it neglects no force; empty if it does.
    """

    label: str
    scope: MethodScope
    forces: ForceScope
    result: xr.Dataset | None
    seconds: float
    whole: ModelResiduals
    train: ModelResiduals
    holdout: ModelResiduals
    reason: str = ""
    failure: str = ""


def method_table(trials: Sequence[Trial], noises: Sequence[float], blocks: Sequence[int]) -> xr.Dataset:
    """The group `comparison` (see `compare`).

    Parameters
    ----------
    trials : sequence of Trial
        What came of each method.
    noises : sequence of float, rad
        Of each run, the same for all methods.
    blocks : sequence of int
        Samples of a period of each run.
    """
    best = best_of(trials)
    at = [trial.label for trial in trials].index(best.label)
    reference, referred = _common_frequency(trials, best)
    forces = _forces(trials)
    values, errors = _coefficients(trials, list(forces.force.values), reference)
    dims, noise = ("method", "force"), root_mean_square(noises)
    variables: Variables = {
        "coefficient": variable(dims, values, "coefficient at the common frequency", PER_FORCE_UNIT),
        "standard_error": variable(dims, errors, "standard error of the coefficient", PER_FORCE_UNIT),
        "z": variable(dims, contrast(values, errors, at), CONTRAST, "1"),
        "common_frequency": variable((), reference, "frequency to which coefficients refer", "rad/s"),
        "noise": variable((), noise, "standard deviation of the sensor's noise", "rad"),
    }
    variables |= _frequencies(trials, at) | _residuals(trials, at, blocks)
    texts = [_texts(trial) for trial in trials]
    variables |= {k: variable("method", [text[k] for text in texts], name) for k, name in TEXTS.items()}
    if len(noises) > 1:
        variables |= _each_run(trials, noises)
    table = forces.assign_coords(method=[trial.label for trial in trials]).assign(variables)
    errors_of_z = "taken as independent; the methods saw the same noise, so that z is rather too small"
    return table.assign_attrs(best=best.label, common_frequency_of=referred, errors_of_z=errors_of_z)


def best_of(trials: Sequence[Trial]) -> Trial:
    """The method with the smallest RMS over the noise on the part held out; if none has any, on the whole."""
    held_out = [trial for trial in trials if trial.holdout.runs]
    if held_out:
        return min(held_out, key=lambda trial: trial.holdout.over_noise)
    return min((trial for trial in trials if trial.result is not None), key=_whole)


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


def _common_frequency(trials: Sequence[Trial], best: Trial) -> tuple[float, str]:
    """A frequency that was given to a method, else that of the best, rad/s; and whose it is.

    Where the best predicts by accident, as its model misses the record as a whole, it is that of the model
    that misses it least: its own may be far off.
    """
    for trial in trials:
        if trial.result is not None and trial.result.reference_frequency_standard_error == 0.0:
            return trial.result.reference_frequency.item(), "given"
    least = min((t for t in trials if t.result is not None), key=_whole)
    owner = least if _whole(best) > LARGE * _whole(least) else best
    assert owner.result is not None
    return owner.result.reference_frequency.item(), owner.label


def _whole(trial: Trial) -> float:
    """Residual of the whole record over the noise, infinite without a motion."""
    return float(np.nan_to_num(trial.whole.over_noise, nan=np.inf))


def _forces(trials: Sequence[Trial]) -> xr.Dataset:
    """The forces that any method found, in the order of the result with most of them."""
    results = sorted((t.result for t in trials if t.result is not None), key=lambda r: -r.sizes["force"])
    labels: dict[str, list[str]] = {}
    for result in results:
        for symbol in result.force.values.tolist():
            force = result.sel(force=symbol)
            labels.setdefault(symbol, [force[k].item() for k in ("name", "formula", "unit")])
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
        converted = reference_factors(trial.result, symbols, reference)
        in_own_model = np.array([in_model(trial.result, symbol) for symbol in symbols])
        at = [list(forces).index(symbol) for symbol in symbols]
        converted = np.where(in_own_model, converted, 1.0)
        values[row, at] = trial.result.coefficient.values * converted
        errors[row, at] = trial.result.standard_error.values * converted
    return values, errors


def contrast(values: Array, errors: Array, best: int) -> Array:
    """Differences from the best method's row over the root of the sum of both variances."""
    both = np.sqrt(errors**2 + errors[best] ** 2)
    z = np.divide(values - values[best], both, out=np.full_like(values, np.nan), where=both > 0.0)
    z[best, np.isfinite(values[best])] = 0.0
    return z


def _frequencies(trials: Sequence[Trial], best: int) -> Variables:
    """Reference and asymptotic frequencies with errors, and the difference of the latter from the best."""

    def scalars(name: str) -> Array:
        return np.array([np.nan if t.result is None else t.result[name].item() for t in trials])

    variables: Variables = {}
    for name in ("reference_frequency", "asymptotic_frequency"):
        pair = scalars(name), scalars(f"{name}_standard_error")
        variables |= with_error(name, "method", pair, name.replace("_", " "), "rad/s")
    limit, error = (column[:, None] for column in pair)
    z = contrast(limit, error, best)[:, 0]
    return variables | {"asymptotic_frequency_z": variable("method", z, CONTRAST, "1")}


def _residuals(trials: Sequence[Trial], best: int, blocks: Sequence[int]) -> Variables:
    """RMS of the simulated models' residuals, p-value of the prediction's, phase error and time."""
    variables: Variables = {}
    for name, part, of in PARTS:
        motions = [getattr(trial, part) for trial in trials]
        rms, long_name = [motion.rms for motion in motions], f"RMS of record minus model {of}"
        ratio = [motion.over_noise for motion in motions]
        variables[f"{name}_rms"] = variable("method", rms, long_name, "rad")
        variables[f"{name}_over_noise"] = variable("method", ratio, f"{long_name}, over the noise", "1")
    residuals = [[run.residual for run in trial.holdout.runs] for trial in trials]
    p_values = [diebold_mariano(some, residuals[best], blocks) if some else np.nan for some in residuals]
    long_name = "p-value of the difference from the best on the part held out"
    variables["holdout_p_value"] = variable("method", p_values, long_name, "1")
    phases, seconds = [trial.whole.phase_error for trial in trials], [trial.seconds for trial in trials]
    long_name = "largest phase between model and record, nan if it stops"
    variables["phase_error"] = variable("method", phases, long_name, "rad")
    variables["time_taken"] = variable("method", seconds, "time of the whole identification", "s")
    return variables


def _each_run(trials: Sequence[Trial], noises: Sequence[float]) -> Variables:
    """RMS of the simulated models' residuals in each of several runs, and its noise."""
    noise = variable("run", list(noises), "noise of one sample of the run", "rad")
    variables: Variables = {"run_noise": noise}
    for name, part, of in PARTS:
        rms = np.stack([getattr(trial, part).each_rms for trial in trials])
        long_name = f"RMS of record minus model {of}, of each run"
        variables[f"run_{name}_rms"] = variable(("method", "run"), rms, long_name, "rad")
    return variables


def _texts(trial: Trial) -> dict[str, str | bool]:
    """`TEXTS` of a method: those of its scope, what it makes of the forces offered, its own."""
    outcome = {"reason": trial.reason, "failure": trial.failure, "bias": _bias(trial.result)}
    return {**vars(trial.scope), **vars(trial.forces), **outcome}


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
