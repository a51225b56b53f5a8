"""Comparison of the laws of two samples: places of differences, and their significance."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.forces.constraints import ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.systems import System
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.results.judged import best
from sysid_trib.results.kinds import SIDES
from sysid_trib.results.law_curves import LAW_DIFFERENCE, LAW_WORDS, VARIABLE_OF_LAW
from sysid_trib.results.variables import described, signal_units
from sysid_trib.smooth_laws import bands
from sysid_trib.smooth_laws.bands import band, interpolation
from sysid_trib.smooth_laws.laws import laws

# With fewer places that both laws visit, there is no common range.
FEWEST_PLACES = 3
# Fraction of the draws below which the p-value is computed from the length of the curve.
COUNTED_PART = 0.005


def law_difference(first: xr.Dataset | xr.DataTree, second: xr.Dataset | xr.DataTree) -> xr.Dataset:
    """Find the places at which the laws of two samples differ: two materials, or a contact and none.

    Parameters
    ----------
    first, second : Dataset or DataTree
        Results of `laws` for different records in one unit; several runs of a sample have common laws.

    Returns
    -------
    Dataset
        Over the speeds and displacements that both samples visit. For `friction(speed)`: `friction_first`,
        `friction_second` with standard errors, `friction_difference` first - second, its `_standard_error`,
        `_low`, `_high` (a simultaneous 95 % band), `_covariance`, `friction_z`, `friction_differs` (the band
        excludes zero), and the scalar `friction_p_value` of no difference anywhere. The same for
        `restoring(displacement)`. Attributes: `verdict`, one of `friction differs`,
        `restoring force differs`, `both laws differ`, `no difference`; `first_record`, `first_method`, ...

    Raises
    ------
    UsageError
        A result has no laws, the records are in different units, or no range is visited by both.

    Notes
    -----
    Forces are over the inertia, which must be the same in both samples. The samples share no noise, so their
    covariances add, including those due to errors of the models. If the second sample has no contact, the
    difference is due to the contact. The p-value is that of the largest z: from draws, or if these are too
    few, from the length of the normalised curve, which bounds it (Sun & Loader 1994).

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time, noise = np.arange(0.0, 8.0, 0.02), np.random.default_rng(0)
    >>> models = [st.Model("contact_forces", {"zeta": zeta}, 9.91) for zeta in (0.01, 0.015)]
    >>> angles = [st.simulate(model, time, 0.3).angle + noise.normal(0.0, 1e-4, 400) for model in models]
    >>> st.physics.law_difference(*[st.laws(angle) for angle in angles]).attrs["verdict"]
    'friction differs'
    """
    samples = [best(sample) for sample in (first, second)]
    if any("friction_covariance" not in sample for sample in samples):
        raise UsageError("law_difference needs two results of laws; identify the laws first (st.laws).")
    if len({signal_units(sample) for sample in samples}) > 1:
        raise UsageError("The samples are in different units; read all records in one (--units).")
    values: dict[str, Any] = {}
    places: dict[str, Any] = {}
    for law, variable in VARIABLE_OF_LAW.items():
        common = _common_places(samples, variable)
        values |= _of_law(samples, law, common)
        places |= {variable: common, f"other_{variable}": common}
    differing = [LAW_WORDS[law] for law in VARIABLE_OF_LAW if values[f"{law}_differs"].any()]
    verdict = "both laws differ" if len(differing) == 2 else f"{''.join(differing)} differs"
    attrs: dict[str, Any] = {"verdict": verdict if differing else "no difference"}
    for name, sample in zip(SIDES, samples, strict=True):
        attrs[f"{name}_record"] = list(sample.attrs["record_source"])
        attrs[f"{name}_method"] = str(sample.attrs["method"])
    data = xr.Dataset(described(LAW_DIFFERENCE, values), described("laws", places), attrs)
    return _in_units(data, signal_units(samples[0]))


def _in_units(data: xr.Dataset, unit: str) -> xr.Dataset:
    """Replace rad by the unit of the records."""
    for variable in data.variables.values():
        if "units" in variable.attrs:
            variable.attrs["units"] = str(variable.attrs["units"]).replace("rad", unit)
    return data


def _common_places(samples: list[xr.Dataset], variable: str) -> Array:
    """Return the places that both samples visit, from the sample with the coarser places."""
    sides = [sample[variable].values[sample[f"{variable}_visited"].values] for sample in samples]
    low = max(float(np.abs(side).min()) for side in sides)
    high = min(float(np.abs(side).max()) for side in sides)
    both = any(np.any(side < 0.0) for side in sides)
    coarse = np.abs(max(sides, key=lambda side: float(np.abs(side).max())))
    within = np.unique(coarse[(coarse >= low * (1.0 - 1e-9)) & (coarse <= high * (1.0 + 1e-9))])
    if len(within) < FEWEST_PLACES:
        raise UsageError(
            f"The samples have no range of {variable} in common (one begins at {low:.3g}, the other ends at "
            f"{high:.3g}); compare records of similar amplitudes."
        )
    return np.concatenate([-within[::-1], within]) if both else within


def _of_law(samples: list[xr.Dataset], law: str, common: Array) -> dict[str, Any]:
    """Return a law of both samples at common places, its difference and the tests of it."""
    laws, covariances, values = [], [], dict[str, Any]()
    for name, sample in zip(SIDES, samples, strict=True):
        weights = interpolation(sample[VARIABLE_OF_LAW[law]].values, common)
        laws.append(weights @ sample[law].values)
        covariances.append(weights @ sample[f"{law}_covariance"].values @ weights.T)
        values[f"{law}_{name}"] = laws[-1], np.sqrt(np.diag(covariances[-1]))
    difference, covariance = laws[0] - laws[1], covariances[0] + covariances[1]
    everywhere = np.ones(len(common), dtype=bool)
    of_band = band(f"{law}_difference", difference, covariance, everywhere)
    error = of_band[f"{law}_difference_standard_error"]
    z = np.divide(difference, error, out=np.zeros_like(difference), where=error > 0.0)
    low, high = of_band[f"{law}_difference_low"], of_band[f"{law}_difference_high"]
    values |= {f"{law}_difference": difference, f"{law}_difference_covariance": covariance, f"{law}_z": z}
    differs: Mask = (error > 0.0) & ((low > 0.0) | (high < 0.0))
    return values | of_band | {f"{law}_differs": differs, f"{law}_p_value": p_value(z, covariance)}


def p_value(z: Array, covariance: Array) -> float:
    """Return the probability of such a large |z| anywhere along a curve that is zero.

    Parameters
    ----------
    z : (place,) array of float
        The curve over its standard errors.
    covariance : (place, place) array of float
        Covariance of the curve.
    """
    largest, draws = float(np.max(np.abs(z))), bands.largest_of_draws(covariance)
    if not len(draws):
        return 1.0
    counted = float(np.mean(draws >= largest))
    if counted >= COUNTED_PART:
        return counted
    error = np.sqrt(np.diag(covariance))
    cosines = np.diagonal(covariance, 1) / (error[1:] * error[:-1])
    length = float(np.sum(np.arccos(np.clip(cosines, -1.0, 1.0))))
    tail = 2.0 * scipy.stats.norm.sf(largest) + length / np.pi * np.exp(-0.5 * largest**2)
    return float(min(tail, COUNTED_PART))


def laws_held_against(
    first: Sequence[xr.Dataset],
    second: Sequence[xr.Dataset],
    *,
    system: str | System | None = None,
    constraints: ConstraintTable | None = None,
    library: ForceLibrary | None = None,
    random_force: RandomForceOption = "off",
    tell: Tell = silent,
) -> dict[str, xr.Dataset]:
    """Identify the laws of two samples, and compare them.

    Parameters
    ----------
    first, second : sequence of Dataset
        Decays, the runs of each sample, which have common laws.
    system, constraints, library, random_force, tell
        See `laws`.

    Returns
    -------
    dict
        Groups of a result: `law_difference`, and the preferred laws `laws_first` and `laws_second`.
    """
    groups: dict[str, xr.Dataset] = {}
    results = []
    dimensions = [f"{other}{variable}" for variable in VARIABLE_OF_LAW.values() for other in ("", "other_")]
    for name, runs in zip(SIDES, (first, second), strict=True):
        tell(f"the laws of the {name} sample")
        tree = laws(
            list(runs),
            system,
            constraints,
            library=library,
            random_force=random_force,
        )
        results.append(best(tree))
        # The forces of the curves are not those of the result that contains the groups.
        of_forces = [dim for dim in results[-1].dims if dim not in dimensions]
        groups[f"laws_{name}"] = results[-1].drop_dims(of_forces)
    return {LAW_DIFFERENCE: law_difference(*results)} | groups
