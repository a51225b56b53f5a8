"""A random force in words and as plain data: its size, what it lets be predicted, whether it is one."""

import numpy as np
import xarray as xr

from sysid_trib.likelihood.random_force import DENSITY_UNITS, RandomForce, random_force_of
from sysid_trib.printing.layout import p_value_text, value_with_error
from sysid_trib.results.variables import record_groups, signal_units
from sysid_trib.validation.findings import second_of
from sysid_trib.validation.verdict import DEPENDENCE_LEVEL, p_value_of_dependence

# Part of its amplitude by which a motion that is predicted may be wrong.
USEFUL = 0.05
NOT_FOUND = "No random force is found; the errors allow for {}."
TOO_SHORT = (
    "The record is too short, or too coarsely sampled, to tell a random force from the sensor's noise, for "
    "which all is taken: one that moves the motion by {:.2g} times that noise may hide in it."
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
    tested = tree["random_force"].to_dataset()
    return [reason for reason in tested.reason.values.tolist() if reason]


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
    force, frequency = random_force_of(result), float(result.reference_frequency)
    if "random_force" not in tree.children:
        return _not_found(tree, result) if "random_force_density" in result else []
    if not_followed(tree):
        # Nothing is known of what is left: not even with such a force does the model follow the record.
        return []
    noise, units = float(result.noise), signal_units(result)
    size = value_with_error(force.density, force.standard_error) if force.standard_error > 0.0 else ""
    given = "" if size else ", as given"
    lasts = _periods_of_record(tree, frequency)
    periods = [_periods(force.periods_to(limit, frequency), lasts) for limit in (noise, USEFUL * amplitude)]
    missing = not tree["comparison"].attrs["verdict_on_record"].startswith("explained")
    is_one = ", taken for a random force, has" if missing else " is a random force with"
    return [
        f"What is left{is_one} a density of {size or f'{force.density:.3g}'} "
        f"{_density_units(units)}{given}; its root is {force.relative(frequency):.1e} w^2 per root hertz.",
        f"From a known state the motion can be predicted to the sensor's noise ({noise:.2g} {units}) for "
        f"{periods[0]}, and to {100.0 * USEFUL:g} % of its amplitude ({amplitude:.2g} {units}) for "
        f"{periods[1]}.",
        *_whose(tree, bool(contradiction := _contradiction(tree, not size))),
        *contradiction,
    ]


def _density_units(units: str) -> str:
    """Unit of a density beside a signal in these units."""
    return DENSITY_UNITS.replace("rad", units)


def _not_found(tree: xr.DataTree, result: xr.Dataset) -> list[str]:
    """That no random force is found; and whether one that moves it by more than the noise may hide."""
    force = random_force_of(result)
    sentences = [NOT_FOUND.format(allowed_for(force, signal_units(tree)))]
    allowed = RandomForce(force.density + float(np.nan_to_num(force.standard_error)))
    frequency, noise = float(result.reference_frequency), float(result.noise)
    periods = _periods_of_record(tree, frequency)
    # The random walk grows with the root of the time.
    random_walk = float(np.sqrt(periods / allowed.periods_to(noise, frequency)))
    return [*sentences, TOO_SHORT.format(random_walk)] if random_walk > 1.0 else sentences


def allowed_for(force: RandomForce, units: str) -> str:
    """What the errors allow for where no random force is found."""
    if not np.isfinite(force.standard_error):
        return "none"
    if not force:
        return f"a density of up to {force.standard_error:.1e} {_density_units(units)} (one standard error)"
    size = value_with_error(force.density, force.standard_error)
    return f"a density of {size} {_density_units(units)}"


def _periods_of_record(tree: xr.DataTree, frequency: float) -> float:
    """Number of periods of the longest record."""
    longest = max(float(np.ptp(tree[name].time.values)) for name in record_groups(tree))
    return longest * frequency / (2.0 * np.pi)


def _periods(count: float, lasts: float) -> str:
    """A number of periods; of no more than the record has anything is known."""
    if count < 0.1:
        return "less than a tenth of a period"
    if count >= lasts:
        return f"longer than the record lasts ({lasts:.0f} periods)"
    return f"{count:.2g} periods" if count < 10.0 else f"{count:.0f} periods"


def _dependences(tested: xr.Dataset) -> str:
    """What the random force depends on: `it depends on the speed, and its size on the time`."""
    level = DEPENDENCE_LEVEL / tested.sizes["run"]
    least = tested.dependence_p_value.min("run")
    on = {}
    for aspect in ("force", "size"):
        below = [name for name in least.on.values.tolist() if least.sel(aspect=aspect, on=name) < level]
        if "any" in below:
            on[aspect] = _listed([f"the {name}" for name in below if name != "any"] or ["the motion"])
    if "force" not in on:
        return f"its size depends on {on['size']}"
    return f"it depends on {on['force']}" + (f", and its size on {on['size']}" if "size" in on else "")


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def _whose(tree: xr.DataTree, contradicted: bool) -> list[str]:
    """Sentences on whether the random force is the experiment's, or stands for something that is missing."""
    tested = tree["random_force"].to_dataset()
    p_value = p_value_of_dependence(tested)
    if p_value < DEPENDENCE_LEVEL:
        return [
            f"This random force is the sign of something missing: {_dependences(tested)}. The "
            "coefficients are off by more than their errors."
        ]
    if not tree["comparison"].attrs["verdict_on_record"].startswith("explained") or contradicted:
        return []
    return [
        "The random force goes with neither angle nor speed, and its size is the same at all amplitudes, "
        "speeds and times: it is a property of the experiment."
    ]


def _contradiction(tree: xr.DataTree, given: bool) -> list[str]:
    """That the record contradicts a density that was given."""
    tested = tree["random_force"].to_dataset()
    p_value = float(tested.density_p_value.min())
    if not given or not p_value < DEPENDENCE_LEVEL:
        return []
    run = int(np.argmin(tested.density_p_value.values))
    return [
        f"The record contradicts the density that was given: its most likely "
        f"one is {tested.likely_density.values[run]:.2g} {_density_units(signal_units(tree))}. Take "
        "--random-force auto."
    ]
