"""A random force in words and as plain data: its size, what it lets be predicted, whether it is one."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.likelihood.random_force import DENSITY_UNITS, RandomForce, random_force_of
from sysid_trib.printing.layout import number, p_value_text, value_with_error
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.variables import group_names, record_groups, signal_units
from sysid_trib.validation.findings import second_of, verdict_of
from sysid_trib.validation.verdict import DEPENDENCE_LEVEL, p_value_of_dependence

# Part of its amplitude by which a motion that is predicted may be wrong.
USEFUL = 0.05
NOT_FOUND = "No random force is found; the errors allow for {}."
TOO_SHORT = (
    "The record is too short, or too coarsely sampled, to tell a random force from the sensor's noise, for "
    "which all is taken: one that moves the motion by {:.2g} times that noise may hide in it."
)
SIGN_OF_MISSING = (
    "This random force is the sign of something missing: {}. The coefficients are off by more than their "
    "errors."
)
OF_EXPERIMENT = (
    "The random force goes with neither angle nor speed, and its size is the same at all amplitudes, "
    "speeds and times: it is a property of the experiment."
)
NOT_FOLLOWED = "The model does not explain the record, not even with a random force: {}"


def random_force_test(tree: xr.DataTree) -> list[str]:
    """The test of a random force, where one is found."""
    if "random_force" not in tree.children or not_followed(tree):
        return []
    p_value = p_value_of_dependence(tree["random_force"].to_dataset())
    return [f"A random force that depends on nothing: p {p_value_text(p_value)}."]


def not_followed(tree: xr.DataTree) -> list[str]:
    """Why the record could not be followed with a random force, by run; none where it could."""
    return [reason for reason in tree["random_force"].reason.values.tolist() if reason]


def random_force_sentences(tree: xr.DataTree, amplitude: float) -> list[str]:
    """The size of a random force, how far ahead it lets be predicted, and whether it is the experiment's.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`.
    amplitude : float, rad
        The largest.
    """
    result = second_of(tree)
    force, frequency, noise = random_force_of(result), float(result.reference_frequency), float(result.noise)
    units = signal_units(result)
    of_density = DENSITY_UNITS.replace("rad", units)
    longest = max(float(np.ptp(tree[name].time.values)) for name in record_groups(tree))
    lasts = longest * frequency / (2.0 * np.pi)
    if "random_force" not in tree.children:
        if "random_force_density" not in result:
            return []
        allowed = RandomForce(force.density + float(np.nan_to_num(force.standard_error)))
        # The random walk grows with the root of the time.
        walk = float(np.sqrt(lasts / allowed.periods_to(noise, frequency)))
        return [NOT_FOUND.format(_allowed_for(force, of_density)), *[TOO_SHORT.format(walk)] * (walk > 1.0)]
    if not_followed(tree):
        # Nothing is known of what is left: not even with such a force does the model follow the record.
        return []
    given, explained = not force.standard_error > 0.0, verdict_of(tree).startswith("explained")
    size = f"{force.density:.3g}" if given else value_with_error(force.density, force.standard_error)
    periods = [_periods(force.periods_to(limit, frequency), lasts) for limit in (noise, USEFUL * amplitude)]
    is_one = " is a random force with" if explained else ", taken for a random force, has"
    return [
        f"What is left{is_one} a density of {size} {of_density}{', as given' if given else ''}; its root is "
        f"{force.relative(frequency):.1e} w^2 per root hertz.",
        f"From a known state the motion can be predicted to the sensor's noise ({noise:.2g} {units}) for "
        f"{periods[0]}, and to {100.0 * USEFUL:g} % of its amplitude ({amplitude:.2g} {units}) for "
        f"{periods[1]}.",
        *_whose(tree["random_force"].to_dataset(), explained, of_density if given else ""),
    ]


def _allowed_for(force: RandomForce, units: str) -> str:
    """What the errors allow for where no random force is found."""
    if not np.isfinite(force.standard_error):
        return "none"
    if not force:
        return f"a density of up to {force.standard_error:.1e} {units} (one standard error)"
    return f"a density of {value_with_error(force.density, force.standard_error)} {units}"


def _periods(count: float, lasts: float) -> str:
    """A number of periods; of no more than the record has anything is known."""
    if count < 0.1:
        return "less than a tenth of a period"
    if count >= lasts:
        return f"longer than the record lasts ({lasts:.0f} periods)"
    return f"{count:.2g} periods" if count < 10.0 else f"{count:.0f} periods"


def _whose(tested: xr.Dataset, explained: bool, units: str) -> list[str]:
    """Sentences on whether the random force is the experiment's, or stands for something that is missing.

    And that the record contradicts a density that was given in these units.
    """
    against, run = tested.density_p_value.min().item(), int(np.argmin(tested.density_p_value.values))
    contradiction = [
        f"The record contradicts the density that was given: its most likely one is "
        f"{tested.likely_density.values[run]:.2g} {units}. Take --random-force auto."
    ] * bool(units and against < DEPENDENCE_LEVEL)
    if p_value_of_dependence(tested) < DEPENDENCE_LEVEL:
        return [SIGN_OF_MISSING.format(_dependences(tested)), *contradiction]
    return contradiction or [OF_EXPERIMENT] * explained


def _dependences(tested: xr.Dataset) -> str:
    """What the random force depends on: `it depends on the speed, and its size on the time`."""
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
    """`verdict`, `random_force` and `innovations` as plain data; None where there is no random force."""
    result = second_of(tree)
    data: dict[str, Any] = {"verdict": verdict_of(tree), "random_force": None, "innovations": None}
    force = random_force_of(result)
    if not force:
        return data
    tested = tree["random_force"].to_dataset() if "random_force" in tree.children else None
    data["random_force"] = {
        "density": force.density,
        "standard_error": number(force.standard_error),
        "relative": force.relative(float(result.reference_frequency)),
        "p_value": number(force.p_value),
        "dependence_p_value": None if tested is None else number(p_value_of_dependence(tested)),
        "density_p_value": None if tested is None else number(float(tested.density_p_value.min())),
    }
    groups = group_names("innovations", len(record_groups(tree)))
    if followed := [tree[group].to_dataset() for group in groups if group in tree.children]:
        # Of runs whose lengths differ, records too short for all lags have fewer.
        lags = min(run.sizes["lag"] for run in followed)
        correlations = [run.autocorrelation.values[:lags] for run in followed]
        data["innovations"] = {
            "rms": root_mean_square([run.innovation_rms.item() for run in followed]),
            "autocorrelation": np.mean(correlations, axis=0).tolist(),
        }
    return data
