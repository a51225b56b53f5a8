"""Consequences of a model, stored with the result: weights of forces, energy, crossovers, arrest."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError
from sysid_trib.physics.contact import slip_fingerprint, speaks_of_slip
from sysid_trib.physics.force_weights import crossovers, dissipated_energy, weights
from sysid_trib.physics.model_estimate import amplitude_row, arrest_time
from sysid_trib.physics.si_units import per_input
from sysid_trib.results import judged
from sysid_trib.results.kinds import CONSEQUENCES, PER_INPUT, kind_of, si_of
from sysid_trib.results.variables import group_names, record_groups


def with_consequences(tree: xr.DataTree) -> xr.DataTree:
    """Return a result with the consequences of its preferred model.

    Parameters
    ----------
    tree : DataTree
        Result of `identify`. Any other result, and a result that already has the groups, is returned
        unchanged.

    Returns
    -------
    DataTree
        For a free decay whose model follows the record, the group `consequences` has the groups `weights`,
        `energy` (over `end`, the largest and the smallest amplitude of the motion), `crossovers`, `arrest`
        and `slip_fingerprint`, as far as they exist. Its attr `refused` gives the reason if they could not be
        computed, for a force that is not finite on such a cycle. For a driven record with a force `-u`, the
        group `per_input` is that of `physics.per_input`.
    """
    if CONSEQUENCES in tree.children or PER_INPUT in tree.children:
        return tree
    if kind_of(tree) == "driven":
        scaled = per_input(judged.best(tree))
        return tree if scaled is None else tree.assign({PER_INPUT: xr.DataTree(scaled)})
    if kind_of(tree) == "identify":
        return _of_an_estimate(tree)
    result = judged.preferred_result(tree) if kind_of(tree) == "cross_check" else None
    if result is None or not judged.follows(tree):
        return tree
    times = times_of_amplitudes(tree)
    return tree.assign({CONSEQUENCES: _consequences(result, judged.amplitudes(tree), times, si_of(tree))})


def _of_an_estimate(tree: xr.DataTree) -> xr.DataTree:
    """Add the consequences of a single identification; its largest known amplitude is that of its start."""
    result = tree.to_dataset()
    start = np.abs(np.ravel(result.start_angle.values)) if "start_angle" in result else np.zeros(0)
    if not np.any(start > 0.0):
        return tree
    return tree.assign({CONSEQUENCES: _consequences(result, start, np.zeros(len(start)), None)})


def _consequences(result: xr.Dataset, amplitude: Array, time: Array, si: xr.Dataset | None) -> xr.DataTree:
    """Return the groups of `with_consequences`."""
    ends = _ends(amplitude, time)
    groups: dict[str, xr.Dataset] = {}
    refused = ""
    try:
        groups["weights"] = _over_ends([weights(result, a, time=t) for a, t in ends])
        groups["energy"] = _over_ends([dissipated_energy(result, a, time=t, **_inertia(si)) for a, t in ends])
        # netCDF does not store an empty dimension.
        if (pairs := crossovers(result)).sizes["pair"]:
            groups["crossovers"] = pairs
        groups["arrest"] = arrest_time(result, ends[0][0])
    except LibraryError as error:
        refused = str(error)
    if speaks_of_slip(result):
        groups["slip_fingerprint"] = slip_fingerprint(result)
    tree = xr.DataTree.from_dict(dict(groups))
    tree.attrs["refused"] = refused
    return tree


def _over_ends(parts: Sequence[xr.Dataset]) -> xr.Dataset:
    return xr.concat(parts, "end", combine_attrs="override")


def _ends(amplitude: Array, time: Array) -> list[tuple[float, float]]:
    """Return the largest and the smallest amplitude, or the only one, with the time of each."""
    a = amplitude_row(amplitude)
    return sorted({(float(a[end]), float(time[end])) for end in (a.argmax(), a.argmin())}, reverse=True)


def _inertia(si: xr.Dataset | None) -> dict[str, float]:
    """Return the inertia in SI units with its error, in the form for `dissipated_energy`."""
    names = ("inertia", "inertia_standard_error")
    return {} if si is None or "inertia" not in si else {name: si[name].item() for name in names}


def times_of_amplitudes(tree: xr.DataTree) -> Array:
    """Return the time since the first sample of its run, s: `t` of the formulas at the `amplitudes`."""
    groups = record_groups(tree)
    pairs = zip(groups, group_names("envelope", len(groups)), strict=True)
    return np.concatenate([tree[half].instant_time.values - tree[run].time.values[0] for run, half in pairs])
