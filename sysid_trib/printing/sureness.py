"""Uncertainty of a result: profiles, sensitivity and the random force, as sentences and tables."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import root_mean_square
from sysid_trib.printing import ALWAYS, Block, layout
from sysid_trib.results import judged
from sysid_trib.results.effects import SIGNIFICANT_ERRORS
from sysid_trib.results.random_force import DENSITY_UNITS, DEPENDENCE_LEVEL, RandomForce, random_force_of
from sysid_trib.results.variables import group_names, record_groups, signal_units

NOISE_ALONE = (
    "The model does not explain the record: quote the standard errors, which include the error of the model. "
    "These intervals include the noise alone."
)
PROFILE, SENSITIVITY = "profile", "sensitivity"
# Acceptable error of a predicted motion, as a fraction of its amplitude.
USEFUL = 0.05
NOT_FOUND = "No random force was found; the errors include {}."
TOO_SHORT = (
    "The record is too short, or too coarsely sampled, to separate a random force from the sensor's noise: "
    "a random force that changes the motion by up to {:.2g} times that noise cannot be excluded."
)
SIGN_OF_MISSING = (
    "The random force stands for a missing force: {}. The errors of the coefficients are larger than stated."
)
OF_EXPERIMENT = (
    "The random force depends on neither angle nor speed, and its size is the same at all amplitudes, "
    "speeds and times: it is a property of the experiment."
)
NOT_FOLLOWED = "The model does not explain the record, not even with a random force: {}"


def sureness_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Return the blocks of profiles and sensitivity, if the result has them."""
    if PROFILE in tree.children:
        lacking = judged.is_unexplained(tree)
        yield _profiles(tree[PROFILE].to_dataset(), lacking)
    if SENSITIVITY in tree.children:
        yield _sensitivity(tree[SENSITIVITY].to_dataset())


def _profiles(data: xr.Dataset, lacking: bool) -> Block:
    """Return a table of intervals by profile likelihood and standard error; `lacking`: missing force."""
    rows, misled = [], []
    for name, row in layout.by_label(data, "parameter").items():
        estimate, error, low, high = (row[k].item() for k in ("estimate", "standard_error", "low", "high"))
        rows.append(
            {
                "parameter": name,
                "by the motion": layout.value_with_error(estimate, error),
                **{k: f"{v:.4g}" if np.isfinite(v) else "none" for k, v in (("from", low), ("to", high))},
                "over the error": f"-{(estimate - low) / error:.2f} +{(high - estimate) / error:.2f}",
            }
        )
        misled += [name] * bool(row.asymmetric.item())
    said = [f"The standard error is misleading for {', '.join(misled)}: quote the interval."] * bool(misled)
    caption = f"Intervals of {100.0 * data.attrs['confidence']:g} % by the profile likelihood"
    table = layout.text_table(rows, ("parameter",))
    return Block([NOISE_ALONE] if lacking else said, ALWAYS, "Profiles", table, caption)


def _sensitivity(data: xr.Dataset) -> Block:
    """Return the range of each coefficient over all fits, and those that differ most."""
    change = abs(data.change.transpose("force", "fit").to_pandas()).fillna(0.0)
    largest, by = change.max(axis=1), change.idxmax(axis=1)
    rows = [
        {
            "force": symbol,
            "stated": layout.value_with_error(row.estimate.item(), row.stated_error.item()),
            "from": f"{row.low.item():.4g}",
            "to": f"{row.high.item():.4g}",
            "fits": f"{row.coefficient.count().item()} of {data.sizes['fit']}",
            "largest change / its error": f"{largest[symbol]:.1f}",
            "by": f"{data.kind.sel(fit=by[symbol]).item()}, {by[symbol]}",
        }
        for symbol, row in layout.by_label(data, "force").items()
    ]
    changed = ", ".join(largest.index[largest.round(1) > SIGNIFICANT_ERRORS])
    failed = ", ".join(data.fit.values[data.reason.values != ""])
    sentences = [
        f"In some fits these differ by more than {SIGNIFICANT_ERRORS:g} standard errors: {changed}."
    ] * bool(changed)
    sentences += [f"Failed fits: {failed}."] * bool(failed)
    caption = "Sensitivity: the same forces over windows, starts, sampling, noise models and methods"
    return Block(sentences, ALWAYS, "Sensitivity", layout.text_table(rows, ("force", "by")), caption)


def sureness_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return profiles and sensitivity as plain data; nothing if they were not requested."""
    tables = {name: {"of": name, "as": name} for name in (PROFILE, SENSITIVITY) if name in tree.children}
    return layout.mapped(tree, tables)


def not_followed(tree: xr.DataTree) -> list[str]:
    """Return the reason why the fit with a random force failed, by run; empty if it did not."""
    return [reason for reason in tree["random_force"].reason.values.tolist() if reason]


def random_force_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe the size of a random force, the horizon of predictions with it, and whether it is physical.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`.
    """
    result, amplitude = judged.last_of(tree), float(judged.amplitudes(tree).max())
    force, frequency, noise = random_force_of(result), float(result.reference_frequency), float(result.noise)
    units = signal_units(result)
    of_density = DENSITY_UNITS.replace("rad", units)
    longest = max(float(np.ptp(tree[name].time.values)) for name in record_groups(tree))
    lasts = longest * frequency / (2.0 * np.pi)
    if judged.judged_of(tree).model.values[-1] in judged.failures(tree):
        return
    if "random_force" not in tree.children:
        if "random_force_density" in result:
            allowed = RandomForce(force.density + float(np.nan_to_num(force.standard_error)))
            # The amplitude of the random walk grows with the square root of the time.
            walk = float(np.sqrt(lasts / allowed.periods_to(noise, frequency)))
            yield NOT_FOUND.format(_allowed_for(force, of_density))
            if walk > 1.0:
                yield TOO_SHORT.format(walk)
    # If the model does not follow the record even with such a force, the residual is not interpreted.
    elif not not_followed(tree):
        given, explained = not force.standard_error > 0.0, judged.is_explained(tree)
        size = (
            f"{force.density:.3g}" if given else layout.value_with_error(force.density, force.standard_error)
        )
        periods = [
            _periods(force.periods_to(limit, frequency), lasts) for limit in (noise, USEFUL * amplitude)
        ]
        what = "The residual is a random force with" if explained else "As a random force, the residual has"
        yield (
            f"{what} a density of {size} {of_density}{', as given' if given else ''}; the root of the "
            f"density is {force.relative(frequency):.1e} w^2 per root hertz."
        )
        yield (
            f"From a known state the motion can be predicted within the sensor's noise ({noise:.2g} {units}) "
            f"for {periods[0]}, and within {100.0 * USEFUL:g} % of its amplitude ({amplitude:.2g} {units}) "
            f"for {periods[1]}."
        )
        tested, p_value = tree["random_force"].to_dataset(), float(tree["judged"].random_force_p[-1])
        yield from _whose(tested, p_value, explained, of_density if given else "")


def _allowed_for(force: RandomForce, units: str) -> str:
    """Describe the random force that the errors include if none was detected."""
    if not np.isfinite(force.standard_error):
        return "none"
    if not force:
        return f"a density of up to {force.standard_error:.1e} {units} (one standard error)"
    return f"a density of {layout.value_with_error(force.density, force.standard_error)} {units}"


def _periods(count: float, lasts: float) -> str:
    """Write a number of periods; it is limited by the length of the record."""
    if count < 0.1:
        return "less than a tenth of a period"
    if count >= lasts:
        return f"longer than the record lasts ({lasts:.0f} periods)"
    return f"{count:.2g} periods" if count < 10.0 else f"{count:.0f} periods"


def _whose(tested: xr.Dataset, p_value: float, explained: bool, units: str) -> Iterator[str]:
    """Describe whether the random force is physical or stands for a missing force.

    Also states that the record contradicts a density given in these units.
    """
    against, run = tested.density_p_value.min().item(), int(np.argmin(tested.density_p_value.values))
    contradicted = bool(units and against < DEPENDENCE_LEVEL)
    if p_value < DEPENDENCE_LEVEL:
        yield SIGN_OF_MISSING.format(_dependences(tested))
    elif explained and not contradicted:
        yield OF_EXPERIMENT
    if contradicted:
        yield (
            "The record contradicts the given density: the most likely density is "
            f"{tested.likely_density.values[run]:.2g} {units}. Use --random-force auto."
        )


def _dependences(tested: xr.Dataset) -> str:
    """Describe the dependences of the random force: `it depends on the speed, and its size on the time`."""
    least, on = tested.dependence_p_value.min("run"), {}
    for aspect in ("force", "size"):
        p_values = least.sel(aspect=aspect).to_series()
        below = p_values.index[p_values < DEPENDENCE_LEVEL / tested.sizes["run"]].tolist()
        if "any" in below:
            names = [f"the {name}" for name in below if name != "any"] or ["the motion"]
            on[aspect] = " and ".join(", ".join(names).rsplit(", ", 1))
    if "force" not in on:
        return f"its size depends on {on['size']}"
    return f"it depends on {on['force']}" + (f", and its size on {on['size']}" if "size" in on else "")


def random_force_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return `verdict`, `random_force` and `innovations` as plain data; None without a random force."""
    result = judged.last_of(tree)
    data: dict[str, Any] = {"verdict": judged.verdict_of(tree), "random_force": None, "innovations": None}
    force = random_force_of(result)
    if not force:
        return data
    tested = tree["random_force"].to_dataset() if "random_force" in tree.children else None
    data["random_force"] = {
        "density": force.density,
        "standard_error": force.standard_error,
        "relative": force.relative(float(result.reference_frequency)),
        "p_value": force.p_value,
        "dependence_p_value": None if tested is None else tree["judged"].random_force_p[-1],
        "density_p_value": None if tested is None else tested.density_p_value.min(),
    }
    groups = group_names("innovations", len(record_groups(tree)))
    if followed := [tree[group].to_dataset() for group in groups if group in tree.children]:
        # Records that are too short for all lags have fewer.
        lags = min(run.sizes["lag"] for run in followed)
        correlations = [run.autocorrelation.values[:lags] for run in followed]
        data["innovations"] = {
            "rms": root_mean_square([run.innovation_rms.item() for run in followed]),
            "autocorrelation": np.mean(correlations, axis=0),
        }
    return data
