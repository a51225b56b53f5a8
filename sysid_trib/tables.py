"""Results as tables for a terminal, and as plain data for JSON."""

from fractions import Fraction
from math import floor, log10, pi
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.forces import Force, ForceLibrary
from sysid_trib.results import library_of
from sysid_trib.signatures import averages, lost_power

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

if TYPE_CHECKING:
    from rich.table import Table


def value_with_error(value: float, error: float) -> str:
    """`0.0097 ± 0.0002`: two digits of the error, the value to the same place, one power of ten for both."""
    if not (np.isfinite(value) and np.isfinite(error)):
        return (
            f"{value:.5g} ± {'?' if not np.isfinite(error) else f'{error:.2g}'}"
            if np.isfinite(value)
            else "-"
        )
    if error <= 0.0:
        return f"{value:.6g}"
    size = max(abs(value), error)
    power = floor(log10(size))
    power = power if power < -3 or power > 4 else 0
    digits = max(0, 1 - floor(log10(error)) + power)
    text = f"{value / 10.0**power:.{digits}f} ± {error / 10.0**power:.{digits}f}"
    return text if power == 0 else f"({text})e{power:+03d}"


def identification_table(tree: xr.DataTree) -> "Table":
    """Coefficients by both methods with errors, and how many errors apart they are."""
    checked = tree["comparison"].ds
    methods = [checked.attrs["first"], checked.attrs["second"]]
    results = [tree[m].ds for m in methods]
    rows = []
    for symbol in _symbols(tree, methods):
        named = next(r for r in results if symbol in r.force).sel(force=symbol)
        row = [f"{symbol:8} {named['name'].item()}", named["formula"].item()]
        row += [_cell(result, symbol) for result in results]
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
    return _table(["force", "formula", *methods, "difference / error"], rows, numbers=(2, 3, 4))


def verdict(tree: xr.DataTree) -> list[str]:
    """The cross-check in plain sentences: is the record explained, then do the methods agree."""
    checked = tree["comparison"].ds
    names = [checked.attrs["first"], checked.attrs["second"]]
    results = [tree[name].ds for name in names]
    rolling = tree["record"].attrs.get("signal") == "rate"
    told = [
        EXPLAINED_BY_RATE
        if rolling and checked.attrs["explained"] != "yes"
        else EXPLAINED[checked.attrs["explained"]]
    ]
    told.append(_agreement(checked, results))
    for name in names:
        told.append(_gap(name, checked.sel(model=name)))
    for name, result in zip(names, results, strict=True):
        told += _remarks(name, result)
    told += _held(results[1])
    stiffness = library_of(results[1], whole=True).role("x")
    if stiffness is not None and stiffness.symbol not in results[1].force:
        told.append(
            f"{stiffness.symbol} and the frequency are one unknown in a single record: give --omega0 "
            f"(frequency without contact) to have {stiffness.symbol}."
        )
    for key, sentence in (
        ("averaging_cannot_tell_apart", "Averaging cannot tell apart by principle: {}."),
        ("averaging_cannot_see", "Averaging cannot see: {}."),
        ("no_method_can_tell_apart", "No method can tell apart: {}."),
    ):
        if checked.attrs[key]:
            told.append(sentence.format(checked.attrs[key]))
    return told


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


def identification_json(tree: xr.DataTree) -> dict[str, Any]:
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
        values = {k: number(result[k].item()) for k in (*scalars, "noise", "misfit")}
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
    record = {k: v for k, v in tree["record"].attrs.items() if isinstance(v, str | int | float)}
    return {"record": record, "methods": methods, "cross_check": check}


def force_table(library: ForceLibrary) -> "Table":
    """Forces of a library with what is derived from their formulas."""
    heads = ["symbol", "name", "formula", "parity", "type", "unit"]
    heads += ["<h sin phi>", "<h cos phi>", "loses power"]
    rows = []
    for force in library:
        power = "-" if force.kind == "sensor" else _loses_power(force)
        unit = "" if force.units == "1" else force.units
        words = [force.symbol, force.name, force.formula.text, force.parity, force.character, unit]
        rows.append([*words, *_signature_text(force), power])
    return _table(heads, rows, whole=(0, 6, 7))


def number(value: float) -> float | int | None:
    """A number that JSON can hold."""
    return value if np.isfinite(value) else None


def _table(
    heads: list[str], rows: list[list[str]], *, whole: tuple[int, ...] = (), numbers: tuple[int, ...] = ()
) -> "Table":
    """A table whose words a narrow terminal may fold, but not the columns `whole` nor the `numbers`."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for at, head in enumerate(heads):
        longest = max(len(row[at]) for row in rows)
        table.add_column(
            head,
            justify="right" if at in numbers else "left",
            min_width=longest if at in (*whole, *numbers) else min(longest, 12),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*row)
    return table


def _times(ratio: float) -> str:
    return f"{ratio:.3g} x noise" if np.isfinite(ratio) else "diverges"


def _symbols(tree: xr.DataTree, methods: list[str]) -> list[str]:
    return list(dict.fromkeys(s for m in methods for s in tree[m].ds.force.values.tolist()))


def _cell(result: xr.Dataset, symbol: str) -> str:
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


def _signature_text(force: Force) -> tuple[str, str]:
    """The signature as a closed form where it is one term, else its values at two amplitudes."""
    if force.degree is not None:
        parts = [float(part[0]) for part in averages(force, np.ones(1))]
        power = "" if force.degree == 0 else " a" if force.degree == 1 else f" a^{force.degree:g}"
        return tuple(f"{_closed(p)}{power}" if abs(p) > 1e-13 else "0" for p in parts)  # type: ignore[return-value]
    amplitudes = np.array([0.1, 1.0])
    time = 1.0 if force.holds_time else 0.0
    sine, cosine = averages(force, amplitudes, None, time)
    return tuple(  # type: ignore[return-value]
        "0" if np.max(np.abs(part)) < 1e-13 else f"{part[0]:.3g}, {part[1]:.3g} (a = 0.1, 1)"
        for part in (sine, cosine)
    )


def _closed(value: float) -> str:
    for unit, name in ((1.0, ""), (1.0 / pi, "/pi")):
        fraction = Fraction(value / unit).limit_denominator(64)
        if fraction and abs(float(fraction) - value / unit) < 1e-12 * abs(value / unit):
            over = fraction.denominator
            if not name:
                return str(fraction)
            return f"{fraction.numerator}/pi" if over == 1 else f"{fraction.numerator}/({over} pi)"
    return f"{value:.4g}"


def _loses_power(force: Force) -> str:
    power = lost_power(force, np.array([0.05, 0.3, 1.0]), None, time=1.0)
    if np.all(np.abs(power) < 1e-13):
        return "no"
    return "yes" if np.all(power > -1e-13) else "gains power" if np.all(power < 1e-13) else "by amplitude"
