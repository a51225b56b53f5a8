"""Methods side by side, as sentences and tables: the best prediction, differences, and probable causes."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from rich.table import Table

from sysid_trib.printing import ALWAYS, USUALLY, Block, Layer, layout
from sysid_trib.printing.verdict import EFFECTIVE, constraint_sentences, identifiability_warnings
from sysid_trib.results.judged import LARGE, applied_methods, column_power, comparison_of, given_results
from sysid_trib.results.random_force import is_found, random_force_of
from sysid_trib.results.variables import record_groups, signal_units, small_units

FREQUENCY_SYMBOL = "w_inf"
# A difference is mentioned if it is larger than this number of standard errors of both methods.
APART = 3.0
# Predictions are equally good if their RMS differs by less than this factor, or not at this level.
ALIKE = 1.01
ALIKE_LEVEL = 0.01
BY_METHOD = "Coefficients by method"
HELD_OUT = "Prediction of the held-out part"
DIFFERENCES = "Difference from the method that predicts best, in combined standard errors"
QUALITY = (
    "RMS of record minus simulated motion, for the whole record (all). For a model identified from the first "
    "two thirds: on these (train) and on the last third (held out)"
)
STOCHASTIC_METHODS = (
    "These methods found a random force in addition to the noise, and their errors include it: {}. "
    "`sysid-trib identify` tests whether it is a true random force, or stands for a missing force."
)
# In the order of the search for causes.
CAUSES = {
    "neglect": "These methods neglect forces, which biases the others (see remarks)",
    "lacking": "The probable cause: {} neglects forces, which biases the others (see remarks)",
    "bias": "The probable cause is a bias of these methods (see remarks)",
    "biased": "The probable cause is a bias of {} (see remarks)",
    "form": "They have the same forces, so the form of a force is probably wrong: each method weighs the "
    "residual differently",
}


def _coefficient_table(table: xr.Dataset) -> Table:
    """Return coefficients with errors: one row per method, one column per force, with its power of ten.

    A method that does not apply or that failed has no row here; `_quality_table` states the reason.
    """
    columns = {}
    applied = applied_methods(table)
    for symbol, row in layout.by_label(applied, "force").items():
        power = column_power(row)
        unit = row.unit.item()
        parts = " ".join([f"1e{power:+03d}"] * bool(power) + [unit] * (unit != "1"))
        numbers = (row.coefficient / 10.0**power, row.standard_error / 10.0**power)
        columns[f"{symbol} ({parts})" if parts else symbol] = layout.values_with_errors(*numbers)
    frequency = (applied.asymptotic_frequency, applied.asymptotic_frequency_standard_error)
    columns[f"{FREQUENCY_SYMBOL} (rad/s)"] = layout.values_with_errors(*frequency)
    return _method_table(pd.DataFrame(columns, applied.model.values))


def _difference_table(table: xr.Dataset) -> Table:
    """Return differences from the method that predicts best, over the errors of both."""
    z = _differences_of(table)
    best = table.attrs["best"]
    texts = z.map(_signed)
    texts.loc[best] = np.where(np.isfinite(z.loc[best]), "best", "-")
    return _method_table(texts)


def _differences_of(table: xr.Dataset) -> pd.DataFrame:
    """Return differences from the best method over their errors, a row for each method that applies."""
    applied = applied_methods(table)
    of_forces = applied.z.transpose("model", "force").to_pandas()
    return of_forces.assign(**{FREQUENCY_SYMBOL: applied.asymptotic_frequency_z.values})


def _quality_table(table: xr.Dataset, units: str) -> Table:
    """Return residuals of simulated models inside and outside of the fitted part, and remarks on methods."""
    factor, unit = small_units(units)
    numbered: dict[str, tuple[xr.DataArray, Callable[[float], str]]] = {
        "all/noise": (table.residual_over_noise, _ratio),
        f"train ({unit})": (factor * table.train_rms, _ratio),
        f"held out ({unit})": (factor * table.holdout_rms, _ratio),
        "held out/noise": (table.holdout_over_noise, _ratio),
        "phase (periods)": (table.phase_error / (2.0 * np.pi), "{:.2f}".format),
        "time (s)": (table.time_taken, "{:#.2g}".format),
    }
    applied = table.model.isin(applied_methods(table).model.values).values
    given = applied | (table.failure == "").values
    columns = {}
    for head, (values, as_text) in numbered.items():
        known = np.where(given, values.values, np.nan)
        columns[head] = [as_text(x) if np.isfinite(x) else "-" for x in known.tolist()]
    remarks = {"failure": "failed: {}", "reason": "{}", "bias": "{}", "neglects": "neglects {}"}
    columns["remarks"] = []
    for row in layout.by_label(table, "model").values():
        values_of = {name: row[name].item() for name in remarks}
        said = [text.format(values_of[name]) for name, text in remarks.items() if values_of[name]]
        columns["remarks"].append("; ".join(said))
    return _method_table(pd.DataFrame(columns, table.model.values))


def _method_table(texts: pd.DataFrame) -> Table:
    """Return one row per method, with its cells by column."""
    rows = [{"method": label, **row} for label, row in texts.to_dict("index").items()]
    return layout.text_table(rows, ("method", "remarks"), ("method",))


def _signed(z: float) -> str:
    if not np.isfinite(z):
        return "-"
    return "0.0" if abs(z) < 0.05 else f"{z:+.1f}" if abs(z) < 100.0 else f"{z:+.0f}"


def _ratio(value: float) -> str:
    return f"{value:#.3g}".rstrip(".") if value < 1000.0 else f"{value:.0f}"


def comparison_blocks(tree: xr.DataTree, sources: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of a result of `compare`; `sources` describe the records."""
    table = comparison_of(tree)
    details = Layer.EXPLAIN
    units = signal_units(tree)
    of_all = [*_as_good(table), _noise(table), *_by_accident(table)]
    differ = _differences(table)
    warnings = identifiability_warnings(table.attrs)
    # The first cause is stated in the remarks of the table.
    few = [said for cause, said in differ.items() if cause != "neglect"]
    return [
        Block([_prediction(tree)], ALWAYS),
        Block(sources),
        Block([*_rival(table, units), *_effective(tree, table)], ALWAYS),
        Block(title="At a glance"),
        Block((), ALWAYS, BY_METHOD, _coefficient_table(table), "Coefficients"),
        Block((), details, BY_METHOD, _difference_table(table), DIFFERENCES),
        Block((), USUALLY, HELD_OUT, _quality_table(table, units), QUALITY),
        Block([*constraint_sentences(given_results(tree).values())]),
        Block([*of_all, *few, *warnings], Layer.DEFAULT),
        Block([*of_all, *differ.values(), *_reference(table), *warnings], details),
    ]


def _prediction(tree: xr.DataTree) -> str:
    """Describe which method predicts the held-out part best, and whether the forces explain it."""
    table = comparison_of(tree)
    groups = record_groups(tree)
    starts = " and ".join(f"{tree[group].holdout_start.item():.4g} s" for group in groups)
    third = "the last third" if len(groups) == 1 else "the last third of each run"
    best = table.sel(model=table.attrs["best"])
    if np.isnan(best.holdout_rms.item()):
        return f"No method could be tested on the held-out part ({third})."
    ratio = best.holdout_over_noise.item()
    explains = ratio <= LARGE and bool(best.get("white_residual", True))
    explain = "explain" if explains else "do not explain"
    if ratio > LARGE and _with_random_force(tree):
        explain = "without a random force do not explain"
    # Capitals are kept in the names of inventors.
    first, others = table.attrs["best"][:1].upper(), table.attrs["best"][1:]
    return (
        f"{first}{others} predicts the held-out part best ({third}, from {starts} on): "
        f"RMS residual {layout.in_small_units(best.holdout_rms.item(), signal_units(tree))}, "
        f"{ratio:.3g} times the noise. These forces {explain} it."
    )


def _rival(table: xr.Dataset, units: str) -> Iterator[str]:
    """Compare the prediction of laws without a formula with that of the named forces."""
    laws = _of_curves(table)
    if not np.any(np.isfinite(laws.holdout_rms.values)):
        return
    nearest = laws.isel(model=int(np.nanargmin(laws.holdout_over_noise.values)))
    ratio = nearest.holdout_over_noise.item() / ratio_of_best(table)
    label = nearest.model.item()
    p_value = nearest.holdout_p_value.item()
    how = "about as well as these forces"
    if abs(ratio - 1.0) > ALIKE - 1.0 and not p_value > ALIKE_LEVEL:
        how = "better than these forces" if ratio < 1.0 else "less well than these forces"
    size = layout.in_small_units(nearest.holdout_rms.item(), units)
    yield (
        f"Friction and restoring force as curves ({label}) predict it {how}: RMS residual {size}, "
        f"{nearest.holdout_over_noise.item():.3g} times the noise."
    )


def _of_curves(table: xr.Dataset) -> xr.Dataset:
    """Return the rows of methods that identify curves; older results have no such rows."""
    curves = ~table.names_forces.values.astype(bool) if "names_forces" in table else np.zeros(0, dtype=int)
    return table.isel(model=np.flatnonzero(curves))


def _effective(tree: xr.DataTree, table: xr.Dataset) -> Iterator[str]:
    """Describe the meaning of the coefficients if no method explains the record."""
    stochastic = _with_random_force(tree)
    # The ratio is nan for a motion that diverges from the record.
    if not ratio_of_best(table) <= LARGE:
        effective = f"{EFFECTIVE}. Standard errors include the change between parts of the record."
        yield STOCHASTIC_METHODS.format(", ".join(stochastic)) if stochastic else effective


def ratio_of_best(table: xr.Dataset) -> float:
    """Return the held-out (or whole) residual of the best method over the noise."""
    best = table.sel(model=table.attrs["best"])
    ratio = best.holdout_over_noise.item()
    return float(best.residual_over_noise.item() if np.isnan(ratio) else ratio)


def _with_random_force(tree: xr.DataTree) -> list[str]:
    """Return methods of all forces with a random force, if the method of best prediction is one of them."""
    table = comparison_of(tree)
    stochastic = [
        label
        for label, result in given_results(tree).items()
        if not table.neglects.sel(model=label).item() and is_found(random_force_of(result))
    ]
    return stochastic if table.attrs["best"] in stochastic else []


def _as_good(table: xr.Dataset) -> Iterator[str]:
    """List the methods that predict as well as the best."""
    best = {"model": table.attrs["best"]}
    others = table.drop_sel(model=table.attrs["best"])
    as_small = others.holdout_over_noise <= ALIKE * table.sel(best).holdout_over_noise
    good = (others.failure == "") & (as_small | (others.holdout_p_value > ALIKE_LEVEL))
    if labels := others.model.values[good].tolist():
        yield f"Equally good (at most 1 % worse, or p > {ALIKE_LEVEL:g}): {', '.join(labels)}."


def _noise(table: xr.Dataset) -> str:
    """Describe the noise, and the consequence if the forces do not explain the record."""
    levels = np.atleast_1d(table.run_noise.values if "run_noise" in table else table.noise.values)
    whose = "the record" if len(levels) == 1 else "each run"
    factor, unit = small_units(signal_units(table))
    sizes = " and ".join(f"{factor * level:.2g}" for level in levels.tolist())
    noise = f"The sensor noise of {whose} is {sizes} {unit} per sample, from {table.attrs['noise_from']}."
    ratio = ratio_of_best(table)
    kept = applied_methods(table)
    if ratio <= LARGE:
        return noise
    if np.isnan(ratio):
        return f"{noise} The motion of the best model diverges from the record."
    labels = " and ".join(kept.model.values[kept.white_noise.values.astype(bool)].tolist())
    errors = f" Errors stated by {labels} are too small: they assume white noise." if labels else ""
    return (
        f"{noise} The residual is {ratio:.3g} times as large: a force is missing or has a different form, or "
        f"the record contains slow disturbances.{errors}"
    )


def _by_accident(table: xr.Dataset) -> Iterator[str]:
    """Warn that a poor model may still follow the last swings, and that errors can be large."""
    of_names = table.drop_sel(model=_of_curves(table).model.values)
    ratios = of_names.residual_over_noise.fillna(np.inf)
    best = table.attrs["best"]
    least = ratios.idxmin("model").item()
    ratio = (ratios.sel(model=best) / ratios.min()).item()
    if ratio > LARGE:
        yield (
            f"But on the whole record, the residual of {best} is {ratio:.2g} times that of {least}: its good "
            "prediction is a coincidence, and differences from it mean little."
        )


def _differences(table: xr.Dataset) -> dict[str, str]:
    """Return a sentence for each probable cause of significant differences from the best method."""
    best = table.attrs["best"]
    # Forces that the best method lacks would appear in each difference from it.
    lacks = table.sel(model=best)
    by_cause: dict[str, list[str]] = {cause: [] for cause in CAUSES}
    for label, z in _differences_of(table).iterrows():
        if far := ", ".join(z.index[abs(z) > APART]):
            row = table.sel(model=label)
            reasons = (row.neglects, lacks.neglects, row.bias, lacks.bias)
            cause = next((name for name, text in zip(CAUSES, reasons, strict=False) if text.item()), "form")
            by_cause[cause].append(f"{label} ({far})")
    if not any(by_cause.values()):
        return {"": f"No coefficient differs from those of {best} by more than {APART:g} standard errors."}
    more = f"More than {APART:g} standard errors from {best}:"
    return {
        cause: f"{more} {'; '.join(labels)}. {CAUSES[cause].format(best)}."
        for cause, labels in by_cause.items()
        if labels
    }


def _reference(table: xr.Dataset) -> Iterator[str]:
    """Describe the frequency to which coefficients refer, and that stiffness cannot be separated from it."""
    owner = table.attrs["common_frequency_of"]
    symbol = table.attrs["exchangeable_with_the_frequency"]
    origin = "given" if owner == "given" else f"w of {owner}"
    yield (
        f"Coefficients refer to {table.common_frequency.item():.6g} rad/s ({origin}). Differences are "
        "divided by the errors of both methods, taken as independent. All methods see the same noise, so "
        "these ratios are too small rather than too large."
    )
    if symbol:
        yield (
            f"No method can identify {symbol}: in a single record, it cannot be separated from the "
            "frequency. Give --omega0 (frequency without contact) to identify it."
        )


def comparison_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return a result of `compare` as plain data."""
    table = comparison_of(tree)
    several = len(record_groups(tree)) > 1
    starts = [tree[group].holdout_start for group in record_groups(tree)]
    keys = layout.KEYS["compare"] | (layout.KEYS["compare_runs"] if several else {})
    data = {
        **layout.records_json(tree),
        "holdout_start": starts[0],
        **{name: table[name] for name in ("common_frequency", "noise")},
        **table.attrs,
        "methods": layout.mapped(table, keys),
        **layout.judged_json(tree),
    }
    if several:
        data |= {"holdout_starts": starts, "run_noises": table.run_noise}
    return data
