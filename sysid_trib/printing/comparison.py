"""Methods side by side: tables, plain sentences, and plain data for JSON."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.layout import number, text_table, value_with_error
from sysid_trib.records.runs import record_groups
from sysid_trib.validation.comparison_table import column_power
from sysid_trib.validation.cross_check import LARGE

if TYPE_CHECKING:
    from rich.table import Table

FREQUENCY = "w_inf"
# Errors of both methods beyond which a difference is told.
APART = 3.0
# A prediction that is worse by less (RMS), or with more chance, is as good.
ALIKE, CHANCE = 1.01, 0.01
PER_METHOD = (
    *("residual_rms", "residual_over_noise", "train_rms", "train_over_noise", "holdout_rms"),
    *("holdout_over_noise", "holdout_p_value", "phase_error", "time_taken"),
)
RUN_RMS = ("run_residual_rms", "run_train_rms", "run_holdout_rms")
QUALITY = (
    "RMS of record minus simulated model: of the whole record; identified from its first two thirds (train), "
    "of these and of the last third (held out)"
)
# Keys of the JSON, and the variables of the comparison.
TEXTS = {
    "reason": "reason",
    "bias": "bias",
    "sees": "identifies",
    "blind_to": "neglects",
    "cannot_tell_apart": "cannot_tell_apart",
    "assumes": "assumes",
}


def comparison_tables(tree: xr.DataTree) -> dict[str, "Table"]:
    """Coefficients, how far apart they are, and how well each method predicts, by title."""
    return {
        "Coefficients": coefficient_table(tree),
        "Difference from the method that predicts best, over the errors of both": difference_table(tree),
        QUALITY: quality_table(tree),
    }


def coefficient_table(tree: xr.DataTree) -> "Table":
    """Coefficients with errors: a row a method, a column a force with its power of ten in the head.

    A method that does not apply has no row here; `quality_table` says why.
    """
    found = _applied(tree)
    heads, columns = [], []
    for symbol in found.force.values.tolist():
        one = found.sel(force=symbol)
        power = column_power(one)
        scale = 10.0**power
        pairs = zip(one.coefficient.values / scale, one.standard_error.values / scale, strict=True)
        unit = "" if one.unit.item() == "1" else f" {one.unit.item()}"
        heads.append(f"{symbol}{f' (1e{power:+03d}{unit})' if power else unit and f' ({unit.strip()})'}")
        columns.append([value_with_error(float(value), float(error)) for value, error in pairs])
    limits = zip(
        found.asymptotic_frequency.values, found.asymptotic_frequency_standard_error.values, strict=True
    )
    columns.append([value_with_error(float(value), float(error)) for value, error in limits])
    return _method_table(found, [*heads, f"{FREQUENCY} (rad/s)"], columns)


def difference_table(tree: xr.DataTree) -> "Table":
    """Differences from the method that predicts best, over the errors of both."""
    found = _applied(tree)
    columns = [
        [
            _signed(z, label == found.attrs["best"])
            for z, label in zip(values, found.method.values, strict=True)
        ]
        for values in (*found.z.values.T, found.asymptotic_frequency_z.values)
    ]
    return _method_table(found, [*found.force.values.tolist(), FREQUENCY], columns)


def quality_table(tree: xr.DataTree) -> "Table":
    """What simulated models leave of the record, in time and out of it; what a method is blind to."""
    found = tree["comparison"].ds
    remarks = []
    for label in found.method.values.tolist():
        one = found.sel({"method": label})
        blind = f"blind to {one.neglects.item()}" if one.neglects.item() else ""
        remarks.append("; ".join(filter(None, (one.reason.item(), one.bias.item(), blind))))
    numbers = {
        "all/noise": (found.residual_over_noise, _ratio),
        "train (mrad)": (1e3 * found.train_rms, _ratio),
        "held out (mrad)": (1e3 * found.holdout_rms, _ratio),
        "held out/noise": (found.holdout_over_noise, _ratio),
        "phase (periods)": (found.phase_error / (2.0 * np.pi), lambda value: f"{value:.2f}"),
        "time (s)": (found.time_taken, lambda value: f"{value:#.2g}"),
    }
    columns = [_column(values, told) for values, told in numbers.values()]
    return _method_table(found, [*numbers, "remarks"], [*columns, remarks], words=1)


def comparison_sentences(tree: xr.DataTree) -> list[str]:
    """The comparison in plain sentences: who predicts, who disagrees and probably why, what nobody sees."""
    found = tree["comparison"].ds
    told = [_prediction(tree), _explanation(found), *_by_accident(found), *_disagreements(found)]
    told.append(
        f"Coefficients refer to {found.common_frequency.item():.6g} rad/s ({_whose(found)}); differences are "
        "over the errors of both methods, taken as independent: the same noise was seen by all, so that they "
        "are rather too small."
    )
    attrs = found.attrs
    if alone := attrs["exchangeable_with_the_frequency"]:
        told.append(
            f"Nobody can see {alone}: it and the frequency are one unknown in a single record; give --omega0 "
            "(frequency without contact) to have it."
        )
    for key, sentence in (
        ("no_method_identifies", "No method here identifies: {}."),
        ("no_method_can_tell_apart", "No method can tell apart: {}."),
        ("averaging_cannot_tell_apart", "Methods of the envelope and the frequency cannot tell apart: {}."),
        ("averaging_cannot_see", "Methods of the envelope and the frequency cannot see: {}."),
    ):
        if attrs[key]:
            told.append(sentence.format(attrs[key]))
    return told


def comparison_json(tree: xr.DataTree) -> dict[str, Any]:
    """The comparison as plain data; non-finite numbers are None."""
    found = tree["comparison"].ds
    methods = {}
    for label in found.method.values.tolist():
        one = found.sel({"method": label})
        coefficients = {
            symbol: {
                "value": number(one.coefficient.sel(force=symbol).item()),
                "standard_error": number(one.standard_error.sel(force=symbol).item()),
                "z": number(one.z.sel(force=symbol).item()),
                "unit": one.unit.sel(force=symbol).item(),
            }
            for symbol in found.force.values.tolist()
        }
        frequencies = ("reference_frequency", "asymptotic_frequency")
        names = [*frequencies, *(f"{k}_standard_error" for k in frequencies), "asymptotic_frequency_z"]
        numbers = {name: number(one[name].item()) for name in (*names, *PER_METHOD)}
        methods[label] = {
            "coefficients": coefficients,
            **numbers,
            **{k: one[name].item() for k, name in TEXTS.items()},
        }
    records = [
        {k: v for k, v in tree[group].attrs.items() if isinstance(v, str | int | float)}
        for group in record_groups(tree)
    ]
    starts = [number(tree[group].holdout_start.item()) for group in record_groups(tree)]
    whole = {
        "holdout_start": starts[0],
        "common_frequency": number(found.common_frequency.item()),
        "noise": number(found.noise.item()),
    }
    told = {"record": records[0], **whole, **found.attrs, "methods": methods}
    if len(records) > 1:
        noises = [number(noise) for noise in found.run_noise.values.tolist()]
        told |= {"records": records, "holdout_starts": starts, "run_noises": noises}
        for name in RUN_RMS:
            for label, row in zip(found.method.values.tolist(), found[name].values.tolist(), strict=True):
                methods[label][name] = [number(rms) for rms in row]
    return told


def _applied(tree: xr.DataTree) -> xr.Dataset:
    """The comparison, of methods that found a coefficient or a frequency."""
    found = tree["comparison"].ds
    told = found.coefficient.notnull().any("force") | found.asymptotic_frequency.notnull()
    return found.isel(method=np.flatnonzero(told.values))


def _method_table(found: xr.Dataset, heads: list[str], columns: list[list[str]], words: int = 0) -> "Table":
    # As wide as a word of the head: a narrow terminal would break it.
    widths = [max(len(word) for word in head.split()) for head in heads[: len(heads) - words]]
    padded = [[cell.rjust(width) for cell in column] for column, width in zip(columns, widths, strict=False)]
    texts = columns[len(padded) :]
    rows = [list(row) for row in zip(found.method.values.tolist(), *padded, *texts, strict=True)]
    numbers = tuple(range(1, len(heads) + 1 - words))
    return text_table(["method", *heads], rows, whole=(0,), numbers=numbers)


def _signed(z: float, best: bool) -> str:
    if not np.isfinite(z):
        return "-"
    return "best" if best else "0.0" if abs(z) < 0.05 else f"{z:+.1f}" if abs(z) < 100.0 else f"{z:+.0f}"


def _ratio(value: float) -> str:
    return f"{value:#.3g}".rstrip(".") if value < 1000.0 else f"{value:.0f}"


def _column(values: xr.DataArray, told: Callable[[float], str]) -> list[str]:
    return [told(value) if np.isfinite(value) else "-" for value in values.values.tolist()]


def _prediction(tree: xr.DataTree) -> str:
    found, groups = tree["comparison"].ds, record_groups(tree)
    starts = " and ".join(f"{tree[group].holdout_start.item():.4g} s" for group in groups)
    third = "The last third" if len(groups) == 1 else "The last third of each run"
    best = found.sel({"method": found.attrs["best"]})
    if np.isnan(best.holdout_rms.item()):
        return f"No method could be tested on {third.lower()}, held out."
    as_good = [
        label
        for label in found.method.values.tolist()
        if label != found.attrs["best"] and _as_good(found.sel({"method": label}), best)
    ]
    others = f"; as well as that (within 1 %, or by chance): {', '.join(as_good)}" if as_good else ""
    return (
        f"{third}, held out from {starts} on, is predicted best by {found.attrs['best']}: RMS "
        f"{1e3 * best.holdout_rms.item():.3g} mrad{others}."
    )


def _by_accident(found: xr.Dataset) -> list[str]:
    """A model that is poor on the whole record may still follow its last swings, and errors be wide."""
    gaps = found.residual_over_noise.fillna(np.inf)
    best, least = found.attrs["best"], found.method.values[int(np.argmin(gaps.values))].item()
    ratio = gaps.sel({"method": best}).item() / gaps.min().item()
    if not ratio > LARGE:
        return []
    return [
        f"But of the whole record {best} leaves {ratio:.2g} times as much as {least}: its prediction is good "
        "by accident, and differences from it say little."
    ]


def _as_good(one: xr.Dataset, best: xr.Dataset) -> bool:
    close = one.holdout_over_noise.item() <= ALIKE * best.holdout_over_noise.item()
    return close or one.holdout_p_value.item() > CHANCE


def _explanation(found: xr.Dataset) -> str:
    best = found.sel({"method": found.attrs["best"]})
    source = found.attrs["noise_from"]
    levels = found.run_noise.values if "run_noise" in found else found.noise.values[None]
    whose = "the record's noise" if len(levels) == 1 else "each run's noise"
    sizes = " and ".join(f"{1e3 * level:.2g}" for level in levels.tolist())
    noise = f"{whose} ({sizes} mrad a sample, from {source})"
    ratio = best.holdout_over_noise.item()
    if np.isnan(ratio):
        ratio = best.residual_over_noise.item()
    if ratio <= LARGE:
        return f"That is {ratio:.3g} times {noise}: these forces explain what was held out."
    told = (
        f"That is still {ratio:.3g} times {noise}: a force is missing or of another form, or slower "
        "disturbances are in the record."
    )
    labels = found.method.values[["white noise" in text for text in found.assumes.values]].tolist()
    return (
        f"{told} Errors stated by {' and '.join(labels)} take it for white noise: too small."
        if labels
        else told
    )


def _disagreements(found: xr.Dataset) -> list[str]:
    """Who differs from the best by more than the errors, by the probable cause."""
    causes: dict[str, list[str]] = {"neglect": [], "bias": [], "form": []}
    for label in found.method.values.tolist():
        one = found.sel({"method": label})
        z = dict(zip(found.force.values.tolist(), one.z.values.tolist(), strict=True))
        z[FREQUENCY] = one.asymptotic_frequency_z.item()
        far = ", ".join(k for k, value in z.items() if abs(value) > APART)
        if far:
            cause = "neglect" if one.neglects.item() else "bias" if one.bias.item() else "form"
            causes[cause].append(f"{label} ({far})")
    sentences = {
        "neglect": "probably because they neglect forces, which others then stand for (see remarks)",
        "bias": "probably by the bias that they leave in (see remarks)",
        "form": "although they know the same forces: probably these do not have the form of what acts, and "
        "each method weighs what is left in its own way",
    }
    if not any(causes.values()):
        return [f"No coefficient differs from those of {found.attrs['best']} by more than {APART:g} errors."]
    best = found.attrs["best"]
    return [
        f"More than {APART:g} errors from {best}, {sentences[cause]}: {'; '.join(labels)}."
        for cause, labels in causes.items()
        if labels
    ]


def _whose(found: xr.Dataset) -> str:
    owner = found.attrs["common_frequency_of"]
    return "given" if owner == "given" else f"w of {owner}"
