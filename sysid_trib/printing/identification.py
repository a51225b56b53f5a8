"""A cross-checked identification as a table, in sentences, and as plain data for JSON."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.printing.layout import number, text_table, value_with_error
from sysid_trib.printing.physics import physics_json, physics_sentences
from sysid_trib.printing.runs import runs_json
from sysid_trib.records.runs import group_names, record_groups
from sysid_trib.results.schema import library_of

if TYPE_CHECKING:
    from rich.table import Table

# Between the level at which methods disagree and this one they agree, but barely.
BARELY = 0.05
EXPLAINED = {
    "yes": "The record is explained: what is left is white noise.",
    "partly": "The model leaves a small gap, but more than white noise: the noise is coloured, or a force is "
    "missing or of another form, and then coefficients are off by more than their errors.",
    "no": "The model does not explain the record: a force is missing, or one is of another form.",
}
EXPLAINED_BY_RATE = (
    "What the model leaves is more than white noise, as it must be in the integral of a measured rate: "
    "whether a force is missing cannot be told from it."
)


def identification_table(tree: xr.DataTree) -> "Table":
    """Coefficients by both methods with errors, and how many errors apart they are."""
    checked = tree["comparison"].ds
    methods = [checked.attrs["first"], checked.attrs["second"]]
    results = [tree[m].ds for m in methods]
    rows = []
    for symbol in _symbols(tree, methods):
        named = next(r for r in results if symbol in r.force).sel(force=symbol)
        row = [f"{symbol:8} {named['name'].item()}", named["formula"].item()]
        row += [coefficient_cell(result, symbol) for result in results]
        z = checked.z.sel(quantity=symbol).item() if symbol in checked.quantity else np.nan
        rows.append([*row, f"{z:+.1f}" if np.isfinite(z) else ""])
    for name, title in (("reference_frequency", "w (rad/s)"), ("asymptotic_frequency", "w_inf (rad/s)")):
        cells = [value_with_error(r[name].item(), r[f"{name}_standard_error"].item()) for r in results]
        z = checked.z.sel(quantity="asymptotic frequency").item()
        shown = name.startswith("asym") and np.isfinite(z)
        rows.append([title, name.replace("_", " "), *cells, f"{z:+.1f}" if shown else ""])
    rows.append(["noise (rad)", "", *(f"{r.noise.item():.2g}" for r in results), ""])
    gap = [_times(checked.residual_over_noise.sel(model=m).item()) for m in methods]
    rows.append(["gap of the simulated model (RMS)", "", *gap, ""])
    return text_table(["force", "formula", *methods, "difference / error"], rows, numbers=(2, 3, 4))


def identification_sentences(tree: xr.DataTree) -> list[str]:
    """The cross-check in plain sentences: is the record explained, then do the methods agree."""
    checked = tree["comparison"].ds
    names = [checked.attrs["first"], checked.attrs["second"]]
    results = [tree[name].ds for name in names]
    rolling = tree[record_groups(tree)[0]].attrs.get("signal") == "rate"
    said = [
        EXPLAINED_BY_RATE
        if rolling and checked.attrs["explained"] != "yes"
        else EXPLAINED[checked.attrs["explained"]]
    ]
    said.append(_agreement(checked, results))
    for name in names:
        said.append(_gap(name, checked.sel(model=name)))
    for name, result in zip(names, results, strict=True):
        said += _remarks(name, result)
    said += _held(results[1])
    stiffness = library_of(results[1], whole=True).role("x")
    if stiffness is not None and stiffness.symbol not in results[1].force:
        said.append(
            f"{stiffness.symbol} and the frequency are one unknown in a single record: give --omega0 "
            f"(frequency without contact) to have {stiffness.symbol}."
        )
    for key, sentence in (
        ("averaging_cannot_tell_apart", "Averaging cannot tell apart by principle: {}."),
        ("averaging_cannot_see", "Averaging cannot see: {}."),
        ("no_method_can_tell_apart", "No method can tell apart: {}."),
    ):
        if checked.attrs[key]:
            said.append(sentence.format(checked.attrs[key]))
    return said


def _agreement(checked: xr.Dataset, results: list[xr.Dataset]) -> str:
    first, second = checked.attrs["first"], checked.attrs["second"]
    if checked.attrs["verdict"] == "unknown":
        return f"{first.capitalize()} and {second} cannot be compared: see below."
    found = (
        f"chi-square {checked.chi_square.item():.3g} for {checked.degrees_of_freedom.item()} differences, "
        f"p = {checked.p_value.item():.2g} (Hotelling, {checked.attrs['draws']} simulated records)."
    )
    if checked.attrs["verdict"] == "disagree":
        return f"{first.capitalize()} and {second} disagree: {found}"
    if checked.p_value.item() < BARELY:
        return f"{first.capitalize()} and {second} agree but barely: {found}"
    if checked.attrs["explained"] == "yes":
        return f"{first.capitalize()} and {second} agree: {found}"
    return f"{first.capitalize()} and {second} differ by no more than their errors: {found}"


def _gap(name: str, checked: xr.Dataset) -> str:
    rms, noise = checked.residual_rms.item(), checked.residual_over_noise.item()
    if np.isnan(rms):
        return f"The model from {name} has no motion from this start: it diverges."
    left = checked.departure_time.item()
    where = "never leaves the noise" if np.isnan(left) else f"leaves the noise at {left:.3g} s"
    return f"The model from {name} {where}: RMS {rms:.3g} rad, {noise:.3g} times the noise."


def _held(result: xr.Dataset) -> list[str]:
    if "shape" not in result:
        return []
    pairs = zip(result.shape_parameter.values.tolist(), result.shape.values.tolist(), strict=True)
    held = ", ".join(f"{name} = {value:g}" for name, value in pairs)
    return [f"Held, not fitted: {held} (--set to change)."]


def consequences(tree: xr.DataTree, inertia: float | None) -> list[str]:
    """What follows from the second identification, in sentences; with an inertia (kg m^2) in SI units too."""
    return physics_sentences(
        tree[tree["comparison"].attrs["second"]].to_dataset(), _amplitudes(tree), inertia
    )


def _amplitudes(tree: xr.DataTree) -> NDArray[np.float64]:
    """Amplitudes of the half periods of all runs, rad."""
    groups = group_names("envelope", len(record_groups(tree)))
    return np.concatenate([tree[group].amplitude.values for group in groups])


def identification_json(tree: xr.DataTree, inertia: float | None = None) -> dict[str, Any]:
    """The result as plain data; non-finite numbers are None."""
    checked = tree["comparison"].ds
    methods = {}
    for name in (checked.attrs["first"], checked.attrs["second"]):
        result = tree[name].ds
        coefficients = {
            symbol: {
                "value": number(result.coefficient.sel(force=symbol).item()),
                "standard_error": number(result.standard_error.sel(force=symbol).item()),
                "active": bool(result.active.sel(force=symbol).item()),
                "refers_to": number(result.refers_to.sel(force=symbol).item()),
                "unit": result.unit.sel(force=symbol).item(),
            }
            for symbol in result.force.values.tolist()
        }
        scalars = ("reference_frequency", "asymptotic_frequency")
        errors = {f"{k}_standard_error": number(result[f"{k}_standard_error"].item()) for k in scalars}
        values = {k: number(result[k].item()) for k in (*scalars, "noise")}
        values["misfit"] = number(result.birge_ratio.item())
        methods[name] = {"coefficients": coefficients, **values, **errors}
    per_force = {
        quantity: {
            k: number(checked[k].sel(quantity=quantity).item())
            for k in ("difference", "expected_difference", "standard_error", "z")
        }
        for quantity in checked.quantity.values.tolist()
    }
    per_method = {
        name: {
            k: number(checked[k].sel(model=name).item())
            for k in ("residual_rms", "residual_over_noise", "departure_time", "residual_p_value")
        }
        for name in methods
    }
    whole = {k: number(checked[k].item()) for k in ("chi_square", "degrees_of_freedom", "p_value")}
    check = {**whole, "differences": per_force, "models": per_method, **checked.attrs}
    records = [
        {k: v for k, v in tree[group].attrs.items() if isinstance(v, str | int | float)}
        for group in record_groups(tree)
    ]
    second = tree[checked.attrs["second"]].to_dataset()
    found = {"record": records[0], "methods": methods, "cross_check": check}
    found["consequences"] = physics_json(second, _amplitudes(tree), inertia)
    if len(records) > 1:
        found |= {"records": records, "runs": runs_json(tree["runs"].to_dataset())}
    return found


def _times(ratio: float) -> str:
    return f"{ratio:.3g} x noise" if np.isfinite(ratio) else "diverges"


def _symbols(tree: xr.DataTree, methods: list[str]) -> list[str]:
    return list(dict.fromkeys(s for m in methods for s in tree[m].ds.force.values.tolist()))


def coefficient_cell(result: xr.Dataset, symbol: str) -> str:
    """A coefficient with its error, or why there is none."""
    if symbol not in result.force:
        return "-"
    one = result.sel(force=symbol)
    if not one.active.item():
        return f"dropped (± {one.standard_error.item():.2g})"
    return value_with_error(one.coefficient.item(), one.standard_error.item())


def _remarks(method: str, result: xr.Dataset) -> list[str]:
    told = []
    corrected = result.attrs.get("first_order_bias_removed", "yes")
    if corrected != "yes":
        told.append(f"First-order bias of {method} not removed: {corrected[2:].strip(': .') or 'as asked'}.")
    if result.attrs.get("refined", "True") != "True":
        told.append(
            f"The columns of {method} are from the smoothed record: its model's motion does not follow it."
        )
    if int(result.attrs.get("correlation_lags", 0)):
        told.append(f"Residuals of {method} are correlated; its errors allow for it (Newey and West).")
    return told
