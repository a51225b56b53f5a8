"""Methods side by side: tables, plain sentences, and plain data for JSON."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.layers import ALWAYS, USUALLY, Block, Layer
from sysid_trib.printing.layout import (
    by_label,
    constraint_sentences,
    identifiability_warnings,
    number,
    numbers,
    quantity,
    quantity_json,
    records_json,
    text_table,
    value_with_error,
)
from sysid_trib.results.per_run import record_groups
from sysid_trib.validation.comparison_table import column_power
from sysid_trib.validation.cross_check import LARGE

if TYPE_CHECKING:
    from rich.table import Table

FREQUENCY_SYMBOL = "w_inf"
# A difference is mentioned if it is larger than so many standard errors of both methods.
APART = 3.0
# A prediction is as good if its RMS is larger by less than this, or not significantly at this level.
ALIKE, ALIKE_LEVEL = 1.01, 0.01
JSON_SCALARS = (
    *("reference_frequency", "asymptotic_frequency", "reference_frequency_standard_error"),
    *("asymptotic_frequency_standard_error", "asymptotic_frequency_z", "residual_rms"),
    *("residual_over_noise", "train_rms", "train_over_noise", "holdout_rms", "holdout_over_noise"),
    *("holdout_p_value", "phase_error", "time_taken"),
)
RUN_RMS = ("run_residual_rms", "run_train_rms", "run_holdout_rms")
COEFFICIENTS = "Coefficients"
DIFFERENCES = "Difference from the method that predicts best, in standard errors of both"
QUALITY = (
    "RMS residual (record minus simulated model) of the whole record (all); of a model identified from the "
    "first two thirds, on these (train) and on the last third (held out)"
)
JSON_TEXTS = ("reason", "bias", "identifies", "neglects", "cannot_tell_apart", "assumes")
# Keys of the JSON where they differ from the names of the variables.
SCOPE_KEYS = {"identifies": "sees", "neglects": "blind_to"}
CAUSES = {
    "neglect": "These methods neglect forces, and the forces that they know take their place (see remarks)",
    "bias": "The probable cause is a bias that these methods leave in (see remarks)",
    "form": "They know the same forces: probably these do not have the form of what acts, and each method "
    "weighs the residual in its own way",
}


def comparison_blocks(tree: xr.DataTree, sources: Sequence[str]) -> list[Block]:
    """What the command `compare` prints, in layers.

    Parameters
    ----------
    tree : DataTree
        Result of `compare`.
    sources : sequence of str
        What each record is.

    Returns
    -------
    list of Block
    """
    table = tree["comparison"].ds
    layers = {COEFFICIENTS: ALWAYS, DIFFERENCES: Layer.EXPLAIN, QUALITY: Layer.DEFAULT | Layer.EXPLAIN}
    verdict, *sentences = comparison_sentences(tree)
    return [
        Block([verdict], ALWAYS),
        Block(sources),
        *(Block(content, layers[title], title) for title, content in comparison_tables(tree).items()),
        Block(
            constraint_sentences(tree[label].ds for label in _applied(tree).method.values.tolist()), USUALLY
        ),
        Block([*_explained(table, ("bias", "form")), *identifiability_warnings(table.attrs)], Layer.DEFAULT),
        Block(sentences, Layer.EXPLAIN),
    ]


def comparison_tables(tree: xr.DataTree) -> dict[str, "Table"]:
    """Coefficients, how far apart they are, and how well each method predicts, by title."""
    return {
        COEFFICIENTS: coefficient_table(tree),
        DIFFERENCES: difference_table(tree),
        QUALITY: quality_table(tree),
    }


def coefficient_table(tree: xr.DataTree) -> "Table":
    """Coefficients with errors: a row a method, a column a force with its power of ten in the head.

    A method that does not apply has no row here; `quality_table` says why.
    """
    table = _applied(tree)
    columns = {}
    for symbol, row in by_label(table, "force").items():
        power = column_power(row)
        scale = 10.0**power
        pairs = zip(row.coefficient.values / scale, row.standard_error.values / scale, strict=True)
        unit = [row.unit.item()] if row.unit.item() != "1" else []
        parts = " ".join([*([f"1e{power:+03d}"] if power else []), *unit])
        head = f"{symbol} ({parts})" if parts else symbol
        columns[head] = [value_with_error(float(value), float(error)) for value, error in pairs]
    frequencies = [quantity(row, "asymptotic_frequency") for row in by_label(table, "method").values()]
    return _method_table(table, columns | {f"{FREQUENCY_SYMBOL} (rad/s)": frequencies})


def difference_table(tree: xr.DataTree) -> "Table":
    """Differences from the method that predicts best, over the errors of both."""
    table = _applied(tree)
    best = table.method.values == table.attrs["best"]
    values = dict(zip(table.force.values.tolist(), table.z.values.T, strict=True))
    values[FREQUENCY_SYMBOL] = table.asymptotic_frequency_z.values
    columns = {head: [_signed(*pair) for pair in zip(z, best, strict=True)] for head, z in values.items()}
    return _method_table(table, columns)


def quality_table(tree: xr.DataTree) -> "Table":
    """Residuals of simulated models, on the record and out of it, and what to mind of each method."""
    table = tree["comparison"].ds
    numbered: dict[str, tuple[xr.DataArray, Callable[[float], str]]] = {
        "all/noise": (table.residual_over_noise, _ratio),
        "train (mrad)": (1e3 * table.train_rms, _ratio),
        "held out (mrad)": (1e3 * table.holdout_rms, _ratio),
        "held out/noise": (table.holdout_over_noise, _ratio),
        "phase (periods)": (table.phase_error / (2.0 * np.pi), "{:.2f}".format),
        "time (s)": (table.time_taken, "{:#.2g}".format),
    }
    columns = {
        head: [as_text(value) if np.isfinite(value) else "-" for value in values.values.tolist()]
        for head, (values, as_text) in numbered.items()
    }
    neglected = [f"neglects {text}" if text else "" for text in table.neglects.values.tolist()]
    remarks = zip(table.reason.values.tolist(), table.bias.values.tolist(), neglected, strict=True)
    columns["remarks"] = ["; ".join(filter(None, texts)) for texts in remarks]
    return _method_table(table, columns, words=["remarks"])


def comparison_sentences(tree: xr.DataTree) -> list[str]:
    """The comparison in plain sentences: which method predicts best, which differ and probably why."""
    table = tree["comparison"].ds
    sentences = [_prediction(tree), *_explained(table, tuple(CAUSES))]
    owner = table.attrs["common_frequency_of"]
    origin = "given" if owner == "given" else f"w of {owner}"
    sentences.append(
        f"Coefficients refer to {table.common_frequency.item():.6g} rad/s ({origin}). Their differences are "
        "over the errors of both methods, taken as independent. All methods saw the same noise: these "
        "numbers are rather too small."
    )
    if symbol := table.attrs["exchangeable_with_the_frequency"]:
        sentences.append(
            f"No method can identify {symbol}: in a single record, it cannot be separated from the "
            "frequency. Give --omega0 (frequency without contact) to identify it."
        )
    return sentences + identifiability_warnings(table.attrs)


def _explained(table: xr.Dataset, causes: Sequence[str]) -> list[str]:
    """What the verdict and the tables do not say: what predicts as well, the noise, what differs and why."""
    return [*_as_good(table), _explanation(table), *_by_accident(table), *_differences(table, causes)]


def comparison_json(tree: xr.DataTree) -> dict[str, Any]:
    """The comparison as plain data; non-finite numbers are None."""
    table, groups = tree["comparison"].ds, record_groups(tree)
    methods: dict[str, Any] = {}
    for label, row in by_label(table, "method").items():
        coefficients = {
            symbol: quantity_json(force, "coefficient") | numbers(force, ["z"]) | {"unit": force.unit.item()}
            for symbol, force in by_label(row, "force").items()
        }
        texts = {SCOPE_KEYS.get(name, name): row[name].item() for name in JSON_TEXTS}
        methods[label] = {"coefficients": coefficients, **numbers(row, JSON_SCALARS), **texts}
        if len(groups) > 1:
            methods[label] |= numbers(row, RUN_RMS)
    starts = [number(tree[group].holdout_start.item()) for group in groups]
    data = {
        **records_json(tree),
        "holdout_start": starts[0],
        **numbers(table, ("common_frequency", "noise")),
        **table.attrs,
        "methods": methods,
    }
    if len(groups) > 1:
        data |= {"holdout_starts": starts, "run_noises": numbers(table, ["run_noise"])["run_noise"]}
    return data


def _applied(tree: xr.DataTree) -> xr.Dataset:
    """The comparison, of methods that gave a coefficient or a frequency."""
    table = tree["comparison"].ds
    applied = table.coefficient.notnull().any("force") | table.asymptotic_frequency.notnull()
    return table.isel(method=np.flatnonzero(applied.values))


def _method_table(table: xr.Dataset, columns: dict[str, list[str]], words: Sequence[str] = ()) -> "Table":
    """A row a method; columns of numbers, and of words."""
    rows = [list(row) for row in zip(table.method.values.tolist(), *columns.values(), strict=True)]
    right = tuple(at for at, head in enumerate(columns, 1) if head not in words)
    return text_table(["method", *columns], rows, whole=(0,), numbers=right)


def _signed(z: float, best: bool) -> str:
    if not np.isfinite(z):
        return "-"
    return "best" if best else "0.0" if abs(z) < 0.05 else f"{z:+.1f}" if abs(z) < 100.0 else f"{z:+.0f}"


def _ratio(value: float) -> str:
    return f"{value:#.3g}".rstrip(".") if value < 1000.0 else f"{value:.0f}"


def _prediction(tree: xr.DataTree) -> str:
    table, groups = tree["comparison"].ds, record_groups(tree)
    starts = " and ".join(f"{tree[group].holdout_start.item():.4g} s" for group in groups)
    third = "The last third" if len(groups) == 1 else "The last third of each run"
    best = by_label(table, "method")[table.attrs["best"]]
    if np.isnan(best.holdout_rms.item()):
        return f"No method could be tested on {third.lower()}, held out."
    ratio = best.holdout_over_noise.item()
    explain = "explain" if ratio <= LARGE else "do not explain"
    return (
        f"{third}, held out from {starts} on, is predicted best by {table.attrs['best']}: RMS residual "
        f"{1e3 * best.holdout_rms.item():.3g} mrad, {ratio:.3g} times the noise. These forces {explain} it."
    )


def _as_good(table: xr.Dataset) -> list[str]:
    methods = by_label(table, "method")
    best = methods.pop(table.attrs["best"])
    limit = ALIKE * best.holdout_over_noise.item()
    labels = [
        label
        for label, row in methods.items()
        if row.holdout_over_noise.item() <= limit or row.holdout_p_value.item() > ALIKE_LEVEL
    ]
    if not labels:
        return []
    return [f"These predict as well (at most 1 % worse, or p > {ALIKE_LEVEL:g}): {', '.join(labels)}."]


def _by_accident(table: xr.Dataset) -> list[str]:
    """A model that is poor on the whole record may still follow its last swings, and errors be wide."""
    ratios = table.residual_over_noise.fillna(np.inf)
    best, least = table.attrs["best"], table.method.values[int(np.argmin(ratios.values))].item()
    ratio = ratios.sel({"method": best}).item() / ratios.min().item()
    if not ratio > LARGE:
        return []
    return [
        f"But on the whole record, the residual of {best} is {ratio:.2g} times that of {least}: its "
        "prediction is good by accident, and differences from it say little."
    ]


def _explanation(table: xr.Dataset) -> str:
    """What the noise is, and what it means that the forces do not explain the record."""
    best = by_label(table, "method")[table.attrs["best"]]
    levels = np.atleast_1d(table.run_noise.values if "run_noise" in table else table.noise.values)
    whose = "the record" if len(levels) == 1 else "each run"
    sizes = " and ".join(f"{1e3 * level:.2g}" for level in levels.tolist())
    noise = f"The noise is that of {whose}: {sizes} mrad a sample, from {table.attrs['noise_from']}."
    ratio = best.holdout_over_noise.item()
    if np.isnan(ratio):
        ratio = best.residual_over_noise.item()
    if ratio <= LARGE:
        return noise
    labels = [label for label, row in by_label(table, "method").items() if row.white_noise.item()]
    errors = f" Errors stated by {' and '.join(labels)} are too small: they assume white noise."
    return (
        f"{noise} The residual is {ratio:.3g} times as large: a force is missing or has another form, or the "
        f"record holds slower disturbances.{errors if labels else ''}"
    )


def _differences(table: xr.Dataset, causes: Sequence[str]) -> list[str]:
    """Methods that differ from the best by more than the errors, by the probable cause."""
    best = table.attrs["best"]
    by_cause: dict[str, list[str]] = {cause: [] for cause in CAUSES}
    for label, row in by_label(table, "method").items():
        z = dict(zip(table.force.values.tolist(), row.z.values.tolist(), strict=True))
        z[FREQUENCY_SYMBOL] = row.asymptotic_frequency_z.item()
        far = ", ".join(name for name, value in z.items() if abs(value) > APART)
        if far:
            cause = "neglect" if row.neglects.item() else "bias" if row.bias.item() else "form"
            by_cause[cause].append(f"{label} ({far})")
    if not any(by_cause.values()):
        return [f"No coefficient differs from those of {best} by more than {APART:g} standard errors."]
    return [
        f"More than {APART:g} standard errors from {best}: {'; '.join(by_cause[cause])}. {CAUSES[cause]}."
        for cause in causes
        if by_cause[cause]
    ]
