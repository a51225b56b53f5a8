"""A cross-checked identification as a table, in sentences, and as plain data for JSON."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.printing.layers import ALWAYS, USUALLY, Block, Layer
from sysid_trib.printing.layout import (
    by_label,
    constraint_sentences,
    identifiability_warnings,
    number,
    numbers,
    p_value_text,
    quantity,
    quantity_json,
    records_json,
    text_table,
)
from sysid_trib.printing.physics import physics_json, physics_sentences, weight_sentences
from sysid_trib.printing.random_force import (
    random_force_json,
    random_force_sentences,
    random_force_verdict,
)
from sysid_trib.printing.runs import runs_json, runs_sentences, runs_table
from sysid_trib.results.per_run import group_names, record_groups
from sysid_trib.results.schema import library_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

# Between the level at which methods disagree and this one they agree, but barely.
BARELY = 0.05
EXPLAINED = {
    "yes": "The record is explained: no departure from white noise was found in the residual ({}).",
    "partly": "The residual is small, but it is not white noise ({}). Either the noise is coloured, or a "
    "force is missing or has another form. In the second case the coefficients are off by more than their "
    "errors.",
    "no": "The model does not explain the record ({}). A force is missing, or one has another form.",
}
EXPLAINED_BY_RATE = (
    "The residual is not white noise ({}). The integral of a measured rate always has such a residual: it "
    "does not show whether a force is missing."
)
FREQUENCIES = ("reference_frequency", "asymptotic_frequency")


def identification_blocks(
    tree: xr.DataTree, sources: "Sequence[str]", inertia: float | None = None
) -> list[Block]:
    """What the command `identify` prints, in layers.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`, with the group `runs` if there are several.
    sources : sequence of str
        What each record is.
    inertia : float, kg m^2, optional
        Adds SI units.

    Returns
    -------
    list of Block
    """
    result = tree[tree["comparison"].attrs["second"]].to_dataset()
    matters = [*_key_sentences(tree), *weight_sentences(result, float(amplitudes(tree).max()))]
    blocks = [
        Block([verdict_sentence(tree)], ALWAYS),
        Block(sources),
        Block(identification_table(tree), ALWAYS),
        Block(matters, Layer.DEFAULT),
        Block(identification_sentences(tree)[1:], Layer.EXPLAIN),
        Block(consequences(tree, inertia), Layer.EXPLAIN),
    ]
    if "runs" in tree:
        runs = tree["runs"].to_dataset()
        blocks += [Block(runs_table(runs), Layer.EXPLAIN), Block(runs_sentences(runs), USUALLY)]
    return blocks


def identification_table(tree: xr.DataTree) -> "Table":
    """Coefficients by both methods with errors, and how many errors apart they are."""
    checked, results = tree["comparison"].ds, _results(tree)
    rows = []
    symbols = list(dict.fromkeys(s for r in results.values() for s in r.force.values.tolist()))
    width = max(8, *map(len, symbols))
    for symbol in symbols:
        named = next(r for r in results.values() if symbol in r.force).sel(force=symbol)
        cells = [coefficient_cell(result, symbol) for result in results.values()]
        difference = _difference(checked, symbol)
        rows.append([f"{symbol:{width}} {named['name'].item()}", named["formula"].item(), *cells, difference])
    for name, title in zip(FREQUENCIES, ("w (rad/s)", "w_inf (rad/s)"), strict=True):
        label = name.replace("_", " ")
        cells = [quantity(result, name) for result in results.values()]
        rows.append([title, label, *cells, _difference(checked, label)])
    rows.append(["noise (rad)", "", *(f"{r.noise.item():.2g}" for r in results.values()), ""])
    ratios = [checked.residual_over_noise.sel(model=name).item() for name in results]
    cells = [f"{ratio:.3g} x noise" if np.isfinite(ratio) else "diverges" for ratio in ratios]
    rows.append(["residual (RMS)", "", *cells, ""])
    return text_table(["force", "formula", *results, "difference / error"], rows, numbers=(2, 3, 4))


def verdict_sentence(tree: xr.DataTree) -> str:
    """Whether the record is explained."""
    if sentence := random_force_verdict(tree):
        return sentence
    checked = tree["comparison"].ds
    explained = checked.attrs["explained"]
    measured_rate = tree[record_groups(tree)[0]].attrs.get("signal") == "rate"
    sentence = EXPLAINED_BY_RATE if measured_rate and explained != "yes" else EXPLAINED[explained]
    return sentence.format(f"p {p_value_text(float(checked.residual_p_value.max()))}")


def identification_sentences(tree: xr.DataTree) -> list[str]:
    """The cross-check in plain sentences: is the record explained, do the methods agree, what to mind."""
    checked, results = tree["comparison"].ds, _results(tree)
    comparison, *warnings = _key_sentences(tree)
    residuals = [_residual_sentence(name, checked.sel(model=name)) for name in results]
    second = results[checked.attrs["second"]]
    stiffness = library_of(second, whole=True).role("x")
    if stiffness is not None and stiffness.symbol not in second.force:
        symbol = stiffness.symbol
        warnings.append(
            f"In a single record, {symbol} cannot be separated from the frequency: give --omega0 (frequency "
            f"without contact) to identify {symbol}."
        )
    warnings = [sentence for sentence in warnings if sentence not in residuals]
    return [verdict_sentence(tree), comparison, *residuals, *warnings]


def _key_sentences(tree: xr.DataTree) -> list[str]:
    """Whether the methods agree, and all that warns."""
    checked, results = tree["comparison"].ds, _results(tree)
    sentences = [_agreement_sentence(checked), *random_force_sentences(tree, float(amplitudes(tree).max()))]
    for name, result in results.items():
        if np.isnan(checked.residual_rms.sel(model=name).item()):
            sentences.append(_residual_sentence(name, checked.sel(model=name)))
        sentences += _remarks(name, result)
    sentences += constraint_sentences(results.values())
    sentences += _held_shapes(results[checked.attrs["second"]])
    return sentences + identifiability_warnings(checked.attrs)


def _results(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """Both identifications by the name of their method."""
    checked = tree["comparison"].attrs
    return {name: tree[name].to_dataset() for name in (checked["first"], checked["second"])}


def _difference(checked: xr.Dataset, label: str) -> str:
    z = checked.z.sel(quantity=label).item() if label in checked.quantity else np.nan
    return f"{z:+.1f}" if np.isfinite(z) else ""


def _agreement_sentence(checked: xr.Dataset) -> str:
    pair = f"{checked.attrs['first'].capitalize()} and {checked.attrs['second']}{_part(checked)}"
    if checked.attrs["verdict"] == "unknown":
        return (
            f"{pair} cannot be compared: the error of their difference could not be computed{_few(checked)}."
        )
    # The records that count are fewer than were drawn where the motion is pushed and one was not identified.
    records = checked.attrs.get("simulated_records", checked.attrs["draws"])
    stated = checked.attrs.get("errors") == "stated"
    errors = "stated errors" if stated else f"Hotelling, {records} simulated records"
    test = (
        f"chi-square {checked.chi_square.item():.3g} for {checked.degrees_of_freedom.item()} differences, "
        f"p = {checked.p_value.item():.2g} ({errors})."
    )
    if checked.attrs["verdict"] == "disagree":
        return f"{pair} disagree: {test}"
    if checked.p_value.item() < BARELY:
        return f"{pair} agree, but barely: {test}"
    if checked.attrs["explained"] == "yes":
        return f"{pair} agree within their errors: {test}"
    return f"{pair} differ by no more than their errors: {test}"


def _part(checked: xr.Dataset) -> str:
    """On which part of a long record the methods are compared."""
    duration = checked.attrs.get("compared_stretch")
    return "" if duration is None else f", compared on stretches of {duration:.3g} s,"


def _few(checked: xr.Dataset) -> str:
    """That too few simulated records were identified, where these are counted."""
    if "simulated_records" not in checked.attrs:
        return ""
    records, draws = checked.attrs["simulated_records"], checked.attrs["draws"]
    return f" (both methods identified {records} of {draws} simulated records)"


def _residual_sentence(name: str, checked: xr.Dataset) -> str:
    rms, noise = checked.residual_rms.item(), checked.residual_over_noise.item()
    if np.isnan(rms):
        return f"The model from {name} has no motion from this start: it diverges."
    start = checked.departure_time.item()
    when = "never exceeds the noise" if np.isnan(start) else f"exceeds the noise from {start:.3g} s on"
    return f"The residual of the model from {name} {when}: RMS {rms:.3g} rad, {noise:.3g} times the noise."


def _held_shapes(result: xr.Dataset) -> list[str]:
    if "shape" not in result:
        return []
    held = ", ".join(f"{name} = {value:g}" for name, value in result["shape"].to_series().items())
    return [f"Held, not fitted: {held} (--set to change)."]


def consequences(tree: xr.DataTree, inertia: float | None) -> list[str]:
    """What follows from the second identification, in sentences; with an inertia (kg m^2) in SI units too."""
    result = tree[tree["comparison"].attrs["second"]].to_dataset()
    return physics_sentences(result, amplitudes(tree), inertia)


def amplitudes(tree: xr.DataTree) -> NDArray[np.float64]:
    """Amplitudes of the half periods of all runs, rad."""
    groups = group_names("envelope", len(record_groups(tree)))
    return np.concatenate([tree[group].amplitude.values for group in groups])


def identification_json(tree: xr.DataTree, inertia: float | None = None) -> dict[str, Any]:
    """The result as plain data; non-finite numbers are None."""
    checked, results = tree["comparison"].ds, _results(tree)
    methods = {name: _method_json(result) for name, result in results.items()}
    differences = ("difference", "expected_difference", "standard_error", "z")
    residuals = ("residual_rms", "residual_over_noise", "departure_time", "residual_p_value")
    check = {
        **numbers(checked, ("chi_square", "degrees_of_freedom", "p_value")),
        "differences": {
            q: numbers(checked.sel(quantity=q), differences) for q in checked.quantity.values.tolist()
        },
        "models": {name: numbers(checked.sel(model=name), residuals) for name in methods},
        **checked.attrs,
    }
    data = {**records_json(tree), **random_force_json(tree), "methods": methods, "cross_check": check}
    data["consequences"] = physics_json(results[checked.attrs["second"]], amplitudes(tree), inertia)
    if "runs" in tree:
        data["runs"] = runs_json(tree["runs"].to_dataset())
    return data


def _method_json(result: xr.Dataset) -> dict[str, Any]:
    coefficients = {
        symbol: {
            **quantity_json(force, "coefficient"),
            "active": bool(force.active.item()),
            "refers_to": number(force.refers_to.item()),
            "unit": force.unit.item(),
            **({"constraint": force.constraint.item()} if "constraint" in force.coords else {}),
        }
        for symbol, force in by_label(result, "force").items()
    }
    names = (*FREQUENCIES, "noise", *(f"{name}_standard_error" for name in FREQUENCIES))
    return {
        "coefficients": coefficients,
        **numbers(result, names),
        "misfit": number(result.birge_ratio.item()),
    }


def coefficient_cell(result: xr.Dataset, symbol: str) -> str:
    """A coefficient with its error, or why there is none."""
    if symbol not in result.force:
        return "-"
    force = result.sel(force=symbol)
    if not force.active.item():
        return f"dropped (± {force.standard_error.item():.2g})"
    kind = force.constraint.item() if "constraint" in force.coords else ""
    mark = {"": "", "fixed": " (fixed)", "at its bound": " (bound)"}.get(kind, " (tied)")
    return f"{quantity(force, 'coefficient')}{mark}"


def _remarks(method: str, result: xr.Dataset) -> list[str]:
    """What to mind of a method's result."""
    sentences = []
    corrected = result.attrs.get("first_order_bias_removed", "yes")
    if corrected != "yes":
        reason = corrected[2:].strip(": .") or "as asked"
        sentences.append(f"The first-order bias of {method} was not removed: {reason}.")
    if result.attrs.get("refined", "True") != "True":
        sentences.append(
            f"The columns of {method} come from the smoothed record: the motion of its model does not follow "
            "the record."
        )
    if int(result.attrs.get("correlation_lags", 0)):
        sentences.append(
            f"The residuals of {method} are correlated; its errors take that into account (Newey and West)."
        )
    return sentences
