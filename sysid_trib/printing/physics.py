"""Consequences of an identification, in sentences and as plain data for JSON."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.printing import ALWAYS, Block
from sysid_trib.printing.layout import by_label, mapped, per_label, quantity, text_table
from sysid_trib.results import effects, variables
from sysid_trib.results.kinds import CONSEQUENCES, GIVEN, MU, si_of
from sysid_trib.results.models import library_of

# A share below this is not mentioned.
SMALL = 5e-4
SHARES = {"decay_share": "decay", "frequency_share": "frequency shift"}
RULE_WORDS = {"averaged": "on average", "peak force": "by peak force"}
SIGNIFICANT_FORCES = effects.SIGNIFICANT_ERRORS


def physics_sentences(tree: xr.DataTree, result: xr.Dataset) -> list[str]:
    """Return the consequences of an identification for the significant forces, in plain sentences.

    Parameters
    ----------
    tree : DataTree
        With the group `consequences`, see `physics.consequences`; without it, the list is empty.
    result : Dataset
        Identification with these consequences.
    """
    if CONSEQUENCES not in tree.children:
        return []
    known = tree[CONSEQUENCES]
    sentences = list[str]()
    if refused := known.attrs["refused"]:
        sentences.append(f"Nothing more can be computed: {refused}")
    else:
        weights = known["weights"].to_dataset()
        for end in range(weights.sizes["end"]):
            sentences += _weights(result, weights.isel(end=end))
        sentences += _energy(result, known["energy"].to_dataset().isel(end=0), si_of(tree))
        if "crossovers" in known.children:
            sentences += _crossovers(result, known["crossovers"].to_dataset(), weights.amplitude.values)
        sentences += _arrest(result, known["arrest"].to_dataset())
    if "slip_fingerprint" in known.children:
        sentences.append(_fingerprint(known["slip_fingerprint"].to_dataset()))
    return sentences


def physics_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return the consequences of an identification as plain data, see `physics_sentences`.

    Returns
    -------
    dict
        `weights` and `energy` (lists, one entry per amplitude), `crossovers` (a list) and `arrest`, or
        instead of these `refused`, the reason why there are none; if applicable also `slip_fingerprint` and
        `physical_units`. Each number is a float or has `value` and `standard_error`.
    """
    if CONSEQUENCES not in tree.children:
        return {}
    known = tree[CONSEQUENCES]
    si = si_of(tree)
    data: dict[str, Any] = {}
    if refused := known.attrs["refused"]:
        data["refused"] = refused
    else:
        for name in ("weights", "energy"):
            of_ends = known[name].to_dataset()
            parts = [of_ends.isel(end=at) for at in range(of_ends.sizes["end"])]
            data[name] = [{"amplitude": part.amplitude} | mapped(part, name) for part in parts]
        pairs = known["crossovers"].to_dataset() if "crossovers" in known.children else xr.Dataset()
        data["crossovers"] = [
            mapped(pair, "crossover") | per_label(pair, "rule", "amplitude±")
            for pair in (by_label(pairs, "pair") if pairs else {}).values()
        ]
        arrest = known["arrest"].to_dataset()
        data["arrest"] = {"amplitude": arrest.amplitude} | mapped(arrest, "arrest")
    if "slip_fingerprint" in known.children:
        slip = known["slip_fingerprint"].to_dataset()
        data["slip_fingerprint"] = mapped(slip, "slip") | slip.attrs
    if si is not None and "inertia" in si:
        data["physical_units"] = mapped(si, "physical_units")
    return data


def weight_sentences(tree: xr.DataTree, result: xr.Dataset) -> list[str]:
    """Describe the weights of forces at the largest amplitude (rad) and its time.

    Empty if no force acts, or if a force is not finite.
    """
    known = tree.children.get(CONSEQUENCES)
    if known is None or "weights" not in known.children:
        return []
    return _weights(result, known["weights"].to_dataset().isel(end=0))


def si_block(tree: xr.DataTree) -> Iterator[Block]:
    """Yield the table of torques or forces in SI units, with errors, if the result contains them."""
    if (values := si_of(tree)) is None:
        return
    rows = [
        {
            "force": symbol,
            "multiplies": force["multiplies"].item(),
            "coefficient": quantity(force, "coefficient"),
            "SI unit": force["unit"].item(),
            **({"friction coefficient": quantity(force, MU)} if MU in values else {}),
        }
        for symbol, force in by_label(values, "force").items()
    ]
    given = ", ".join(
        f"{values[name].attrs['long_name']} {quantity(values, name)} {values[name].attrs['units']}"
        for name in GIVEN
        if name in values
    )
    caption = f"In SI units, by {values.attrs['of_method']}: {given}"
    table = text_table(rows, ("force", "multiplies", "SI unit"))
    yield Block((), ALWAYS, "Coefficients", table, caption)


def _significant(result: xr.Dataset) -> set[str]:
    """Return the symbols of the forces that differ from zero."""
    return set(result.force.values[effects.significant(result)].tolist())


def _weights(result: xr.Dataset, weights: xr.Dataset) -> list[str]:
    known = _significant(result)
    parts = []
    acting = [of_force for symbol, of_force in by_label(weights, "force").items() if symbol in known]
    for weight, what in SHARES.items():
        # NaN, if no force acts, compares as false.
        kept = [force for force in acting if abs(force[weight].item()) > SMALL]
        kept.sort(key=lambda force: -abs(force[weight].item()))
        if kept:
            texts = [f"{force.force.item()} {quantity(force, weight, ' %', 100.0)}" for force in kept]
            parts.append(f"the {what} comes from {', '.join(texts)}")
    return (
        [f"At {weights.amplitude.item():.3g} {variables.signal_units(result)}, {'; '.join(parts)}."]
        if parts
        else []
    )


def _energy(result: xr.Dataset, values: xr.Dataset, si: xr.Dataset | None) -> Iterator[str]:
    """Yield the fraction of the energy that a cycle dissipates; nothing if there is none."""
    percent = quantity(values, "lost_fraction", " %", 100.0)
    known = si is not None and "inertia" in si
    joule = f", {quantity(values, 'total_energy', ' J')}" if known else ""
    place = f"{values.amplitude.item():.3g} {variables.signal_units(result)}"
    if values.total_energy.item():
        yield f"A cycle at {place} dissipates {percent} of the energy I w^2 a^2/2{joule}."


def _crossovers(result: xr.Dataset, pairs: xr.Dataset, ends: Array) -> Iterator[str]:
    """Describe where two significant forces have equal weight, and whether this is an extrapolation."""
    known = _significant(result)
    unit = variables.signal_units(result)
    for pair in by_label(pairs, "pair").values():
        first = pair["first"].item()
        second = pair["second"].item()
        finite = [rule for rule in RULE_WORDS if np.isfinite(pair.amplitude.sel(rule=rule).item())]
        if not finite or not {first, second} <= known:
            continue
        places = [
            f"{quantity(pair.sel(rule=rule), 'amplitude')} {unit} {RULE_WORDS[rule]}" for rule in finite
        ]
        reached = (pair.amplitude >= ends.min()) & (pair.amplitude <= ends.max())
        remarks = ["they act against each other"] * bool(pair.opposed.item())
        remarks += ["not reached by this motion"] * (not reached.any())
        remark = f" ({'; '.join(remarks)})" if remarks else ""
        where = f"the {pair.acts_on.item()} at {', '.join(places)}{remark}"
        yield f"{first} and {second} have equal weight in {where}."


def _arrest(result: xr.Dataset, values: xr.Dataset) -> list[str]:
    """Describe when the motion stops; nothing if the friction that stops it is not significant."""
    stopping = {
        force.symbol
        for force in library_of(result)
        if force.character == "dissipative" and force.degree is not None and force.degree < 1.0
    }
    if not stopping <= _significant(result):
        return []
    start = f"From {values.amplitude.item():.3g} {variables.signal_units(result)}, the averaged motion"
    if not np.isfinite(values.arrest_time.item()):
        return [f"{start} does not stop in a finite time."]
    exact = values.stop_time.item()
    simulated = f"; the simulated motion stops after {exact:.4g} s" if np.isfinite(exact) else ""
    return [f"{start} stops after {quantity(values, 'arrest_time', ' s')}{simulated}."]


def _fingerprint(values: xr.Dataset) -> str:
    ratio = f"{values.attrs['numerator']}/{values.attrs['denominator']} = {quantity(values, 'ratio')}"
    verdict = f"{values.attrs['verdict']}, {abs(values.z.item()):.3g} standard errors apart"
    if values.significance.item() < SIGNIFICANT_FORCES:
        verdict += f"; {values.attrs['denominator']} itself is not significant"
    return f"{ratio}; for partial slip it is -3 pi/4 = {values.slip_ratio.item():.3f} within 10 %: {verdict}."
