"""Consequences of an identification, in sentences and as plain data for JSON."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import LibraryError
from sysid_trib.physics.contact import SIGNIFICANT_FRICTION, slip_fingerprint, speaks_of_slip
from sysid_trib.physics.force_weights import crossovers, dissipated_energy, weights
from sysid_trib.physics.model_estimate import amplitude_row, arrest_time
from sysid_trib.physics.si_units import GIVEN, MU, si_of
from sysid_trib.printing import ALWAYS, Block
from sysid_trib.printing.layout import by_label, mapped, per_label, quantity, text_table
from sysid_trib.results import effects, schema, variables

# A share below this is not worth a word.
SMALL = 5e-4
SHARES = {"decay_share": "decay", "frequency_share": "frequency shift"}
RULE_WORDS = {"averaged": "on average", "peak force": "by peak force"}


def physics_sentences(
    result: xr.Dataset, amplitude: ArrayLike, si: xr.Dataset | None = None, *, time: ArrayLike = 0.0
) -> list[str]:
    """The physics of an identification in plain sentences, of the forces that are significant.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : array_like of float, rad
        Amplitudes of the motion. The sentences are about the largest and the smallest, and the motion starts
        at the largest.
    si : Dataset, optional
        The identification in SI units, see `in_si_units`: its inertia adds energies.
    time : array_like of float, s
        `t` of the formulas at each amplitude.

    Returns
    -------
    list of str
        Short sentences, numbers with their standard errors. A force that is not finite on these cycles leaves
        out what depends on it, and is named.

    Raises
    ------
    UsageError
        Not an identification, or not positive angles.
    """
    ends = _ends(amplitude, time)
    sentences = []
    try:
        for end in ends:
            sentences += _weights(result, *end)
        sentences += _energy(result, *ends[0], si)
        sentences += _crossovers(result, [end for end, _ in ends])
        sentences += _arrest(result, ends[0][0])
    except LibraryError as error:
        sentences.append(f"Nothing more can be computed: {error}")
    if speaks_of_slip(result):
        sentences.append(_fingerprint(slip_fingerprint(result)))
    return sentences


def physics_json(
    result: xr.Dataset, amplitude: ArrayLike, si: xr.Dataset | None = None, *, time: ArrayLike = 0.0
) -> dict[str, Any]:
    """The physics of an identification as plain data, see `physics_sentences`.

    Returns
    -------
    dict
        `weights` and `energy` (lists, one entry an amplitude), `crossovers` (a list) and `arrest`, or in
        their place `refused`, why there are none; where they apply `slip_fingerprint` and `physical_units`.
        Each number is a float or has `value` and `standard_error`.
    """
    ends = _ends(amplitude, time)
    data: dict[str, Any] = {"weights": [], "energy": []}
    try:
        for a, t in ends:
            data["weights"].append({"amplitude": a} | mapped(weights(result, a, time=t), "weights"))
            energy = dissipated_energy(result, a, time=t, **_inertia(si))
            data["energy"].append({"amplitude": a} | mapped(energy, "energy"))
        data["crossovers"] = [
            mapped(pair, "crossover") | per_label(pair, "rule", "amplitude±")
            for pair in by_label(crossovers(result), "pair").values()
        ]
        largest = ends[0][0]
        data["arrest"] = {"amplitude": largest} | mapped(arrest_time(result, largest), "arrest")
    except LibraryError as error:
        data = {"refused": str(error)}
    if speaks_of_slip(result):
        slip = slip_fingerprint(result)
        data["slip_fingerprint"] = mapped(slip, "slip") | slip.attrs
    if si is not None and "inertia" in si:
        data["physical_units"] = mapped(si, "physical_units")
    return data


def weight_sentences(result: xr.Dataset, amplitude: ArrayLike, *, time: ArrayLike = 0.0) -> list[str]:
    """Describe the weights of forces at the largest amplitude (rad) and its time.

    Empty where no force acts, or where one is not finite.
    """
    try:
        return _weights(result, *_ends(amplitude, time)[0])
    except LibraryError:
        return []


def si_block(tree: xr.DataTree) -> Iterator[Block]:
    """The table of torques or forces in SI units, with errors, of a result that holds them."""
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


def _ends(amplitude: ArrayLike, time: ArrayLike) -> list[tuple[float, float]]:
    """The largest and the smallest amplitude, or the only one, each with its time."""
    a = amplitude_row(amplitude)
    at = np.broadcast_to(np.asarray(time, float), a.shape)
    return sorted({(float(a[end]), float(at[end])) for end in (a.argmax(), a.argmin())}, reverse=True)


def _significant(result: xr.Dataset) -> set[str]:
    """Symbols of the forces that differ from zero."""
    return set(result.force.values[effects.significant(result)].tolist())


def _weights(result: xr.Dataset, amplitude: float, time: float) -> list[str]:
    known, parts = _significant(result), []
    acting = [f for s, f in by_label(weights(result, amplitude, time=time), "force").items() if s in known]
    for weight, what in SHARES.items():
        # NaN, where no force acts, is not larger than anything.
        kept = [force for force in acting if abs(force[weight].item()) > SMALL]
        kept.sort(key=lambda force: -abs(force[weight].item()))
        if kept:
            texts = [f"{force.force.item()} {quantity(force, weight, ' %', 100.0)}" for force in kept]
            parts.append(f"the {what} comes from {', '.join(texts)}")
    return [f"At {amplitude:.3g} {variables.signal_units(result)}, {'; '.join(parts)}."] if parts else []


def _inertia(si: xr.Dataset | None) -> dict[str, float]:
    """The inertia of what is given in SI units with its error, as `dissipated_energy` takes it."""
    names = ("inertia", "inertia_standard_error")
    return {} if si is None or "inertia" not in si else {name: si[name].item() for name in names}


def _energy(result: xr.Dataset, amplitude: float, time: float, si: xr.Dataset | None) -> Iterator[str]:
    """The part of the energy that a cycle dissipates; nothing where there is none."""
    inertia = _inertia(si)
    values = dissipated_energy(result, amplitude, time=time, **inertia)
    percent = quantity(values, "lost_fraction", " %", 100.0)
    joule = f", {quantity(values, 'total_energy', ' J')}" if inertia else ""
    place = f"{amplitude:.3g} {variables.signal_units(result)}"
    if values.total_energy.item():
        yield f"A cycle at {place} dissipates {percent} of the energy I w^2 a^2/2{joule}."


def _crossovers(result: xr.Dataset, ends: list[float]) -> Iterator[str]:
    """Describe where two significant forces weigh the same, and whether this is an extrapolation."""
    known, unit = _significant(result), variables.signal_units(result)
    for pair in by_label(crossovers(result), "pair").values():
        first, second = pair["first"].item(), pair["second"].item()
        finite = [rule for rule in RULE_WORDS if np.isfinite(pair.amplitude.sel(rule=rule).item())]
        if not finite or not {first, second} <= known:
            continue
        places = [
            f"{quantity(pair.sel(rule=rule), 'amplitude')} {unit} {RULE_WORDS[rule]}" for rule in finite
        ]
        reached = (pair.amplitude >= min(ends)) & (pair.amplitude <= max(ends))
        remarks = ["they act against each other"] * bool(pair.opposed.item())
        remarks += ["not reached by this motion"] * (not reached.any())
        remark = f" ({'; '.join(remarks)})" if remarks else ""
        where = f"the {pair.acts_on.item()} at {', '.join(places)}{remark}"
        yield f"{first} and {second} weigh the same in {where}."


def _arrest(result: xr.Dataset, amplitude: float) -> list[str]:
    """Describe when the motion stops; nothing if the friction that stops it is not significant."""
    stopping = {
        force.symbol
        for force in schema.library_of(result)
        if force.character == "dissipative" and force.degree is not None and force.degree < 1.0
    }
    if not stopping <= _significant(result):
        return []
    values = arrest_time(result, amplitude)
    start = f"From {values.amplitude.item():.3g} {variables.signal_units(result)}, the averaged motion"
    if not np.isfinite(values.arrest_time.item()):
        return [f"{start} does not stop in a finite time."]
    exact = values.stop_time.item()
    simulated = f"; the simulated motion stops after {exact:.4g} s" if np.isfinite(exact) else ""
    return [f"{start} stops after {quantity(values, 'arrest_time', ' s')}{simulated}."]


def _fingerprint(values: xr.Dataset) -> str:
    ratio = f"{values.attrs['numerator']}/{values.attrs['denominator']} = {quantity(values, 'ratio')}"
    verdict = f"{values.attrs['verdict']}, {abs(values.z.item()):.3g} standard errors apart"
    if values.significance.item() < SIGNIFICANT_FRICTION:
        verdict += f"; {values.attrs['denominator']} itself is not significant"
    return f"{ratio}; partial slip has -3 pi/4 = {values.slip_ratio.item():.3f} within a tenth: {verdict}."
