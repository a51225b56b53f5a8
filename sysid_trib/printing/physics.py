"""What follows from an identification, in sentences for the terminal and as plain data for JSON."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Force
from sysid_trib.physics.crossing import crossovers
from sysid_trib.physics.energy import arrest_time, dissipated_energy
from sysid_trib.physics.error_propagation import amplitude_row
from sysid_trib.physics.fingerprint import SIGNIFICANT_FRICTION, slip_fingerprint, speaks_of_slip
from sysid_trib.physics.force_weights import weights
from sysid_trib.physics.units import physical_units
from sysid_trib.printing.layout import by_label, numbers, quantity, quantity_json
from sysid_trib.results.schema import library_of
from sysid_trib.results.signal_units import signal_units
from sysid_trib.results.significance import significant

# A share below this is not worth a word.
SMALL = 5e-4
WEIGHTS = ("peak_force", "decay", "frequency_shift", "decay_share", "frequency_share")
ENERGIES = ("total_energy", "lost_fraction")


def physics_sentences(
    result: xr.Dataset, amplitude: ArrayLike, inertia: float | None = None, *, time: ArrayLike = 0.0
) -> list[str]:
    """The physics of an identification in plain sentences, of the forces that are significant.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : array_like of float, rad
        Amplitudes of the motion. The sentences are about the largest and the smallest, and the motion starts
        at the largest.
    inertia : float, kg m^2, optional
        Adds energies and coefficients in SI units.
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
        Not an identification, not positive angles, or no positive inertia.
    """
    ends = _ends(amplitude, time)
    largest = ends[0][0]
    sentences = []
    try:
        for end in ends:
            sentences += _weights(result, *end)
        sentences += _energy(result, *ends[0], inertia)
        sentences += _crossovers(result, [end for end, _ in ends])
        if _arrest_is_decided(result):
            sentences.append(_arrest(arrest_time(result, largest), signal_units(result)))
    except LibraryError as error:
        sentences.append(f"Nothing more can be computed: {error}")
    if speaks_of_slip(result):
        sentences.append(_fingerprint(slip_fingerprint(result)))
    if inertia is not None:
        sentences.append(_si_units(physical_units(result, inertia)))
    return sentences


def weight_sentences(result: xr.Dataset, amplitude: ArrayLike, *, time: ArrayLike = 0.0) -> list[str]:
    """Which forces the decay and the frequency shift come from, at the largest amplitude (rad) and its time.

    Empty where no force acts, or where one is not finite.
    """
    try:
        return _weights(result, *_ends(amplitude, time)[0])
    except LibraryError:
        return []


def physics_json(
    result: xr.Dataset, amplitude: ArrayLike, inertia: float | None = None, *, time: ArrayLike = 0.0
) -> dict[str, Any]:
    """The physics of an identification as plain data; non-finite numbers are None.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : array_like of float, rad
        Amplitudes of the motion.
    inertia : float, kg m^2, optional
        Adds energies and coefficients in SI units.
    time : array_like of float, s
        `t` of the formulas at each amplitude.

    Returns
    -------
    dict
        `weights` and `energy` (lists, one entry an amplitude), `crossovers` (a list) and `arrest`, or in
        their place `refused`, why there are none; where they apply `slip_fingerprint` and `physical_units`.
        Each number is a float or has `value` and `standard_error`.

    Raises
    ------
    UsageError
        Not an identification, not positive angles, or no positive inertia.
    """
    ends = _ends(amplitude, time)
    largest = ends[0][0]
    data: dict[str, Any] = {}
    try:
        data["weights"] = [_weights_json(result, *end) for end in ends]
        data["energy"] = [_energy_json(result, *end, inertia) for end in ends]
        data["crossovers"] = _crossovers_json(crossovers(result))
        stop = arrest_time(result, largest)
        data["arrest"] = {
            "amplitude": largest,
            "arrest_time": quantity_json(stop, "arrest_time"),
            **numbers(stop, ["stop_time"]),
        }
    except LibraryError as error:
        data = {"refused": str(error)}
    if speaks_of_slip(result):
        slip = slip_fingerprint(result)
        scalars = numbers(slip, ("slip_ratio", "z", "p_value", "significance"))
        data["slip_fingerprint"] = {"ratio": quantity_json(slip, "ratio"), **scalars, **slip.attrs}
    if inertia is not None:
        data["physical_units"] = _si_units_json(physical_units(result, inertia))
    return data


def _ends(amplitude: ArrayLike, time: ArrayLike) -> list[tuple[float, float]]:
    """The largest and the smallest amplitude, or the only one, each with its time."""
    a = amplitude_row(amplitude)
    at = np.broadcast_to(np.asarray(time, float), a.shape)
    return sorted({(float(a[end]), float(at[end])) for end in (a.argmax(), a.argmin())}, reverse=True)


def _significant(result: xr.Dataset) -> list[str]:
    """Symbols of the forces that differ from zero."""
    return result.force.values[significant(result)].tolist()


def _arrest_is_decided(result: xr.Dataset) -> bool:
    """Whether what stops a motion in a finite time, a friction of degree below 1, is known to act."""
    known = dict(zip(result.force.values.tolist(), significant(result).tolist(), strict=True))
    stopping = [f.symbol for f in library_of(result) if f.character == "dissipative" and _stops(f)]
    return all(known[symbol] for symbol in stopping)


def _stops(force: Force) -> bool:
    return force.degree is not None and force.degree < 1.0


def _pairs(values: xr.Dataset) -> list[xr.Dataset]:
    return [values.isel(pair=at) for at in range(values.sizes["pair"])]


def _weights(result: xr.Dataset, amplitude: float, time: float) -> list[str]:
    by_force = by_label(weights(result, amplitude, time=time), "force")
    by_force = {symbol: by_force[symbol] for symbol in _significant(result) if symbol in by_force}
    parts = []
    for weight, what in (("decay_share", "decay"), ("frequency_share", "frequency shift")):
        # NaN, where no force acts, is not larger than anything.
        kept = [s for s, force in by_force.items() if abs(force[weight].item()) > SMALL]
        kept.sort(key=lambda s: -abs(by_force[s][weight].item()))
        if kept:
            texts = [f"{s} {quantity(by_force[s], weight, ' %', 100.0)}" for s in kept]
            parts.append(f"the {what} comes from {', '.join(texts)}")
    return [f"At {amplitude:.3g} {signal_units(result)}, {'; '.join(parts)}."] if parts else []


def _energy(result: xr.Dataset, amplitude: float, time: float, inertia: float | None) -> list[str]:
    values = dissipated_energy(result, amplitude, inertia, time=time)
    if not values.total_energy.item():
        return []
    percent = quantity(values, "lost_fraction", " %", 100.0)
    joule = "" if inertia is None else f", {quantity(values, 'total_energy', ' J')}"
    place = f"{amplitude:.3g} {signal_units(result)}"
    return [f"A cycle at {place} dissipates {percent} of the energy I w^2 a^2/2{joule}."]


def _crossovers(result: xr.Dataset, ends: list[float]) -> list[str]:
    """Where two significant forces weigh the same; what the motion does not pass is extrapolated."""
    sentences, symbols, unit = [], set(_significant(result)), signal_units(result)
    for pair in _pairs(crossovers(result)):
        if not {pair["first"].item(), pair["second"].item()} <= symbols:
            continue
        rules = [
            f"{quantity(pair.sel(rule=rule), 'amplitude', f' {unit}')} {name}"
            for rule, name in (("averaged", "on average"), ("peak force", "by peak force"))
            if np.isfinite(pair.amplitude.sel(rule=rule).item())
        ]
        if rules:
            missed = (pair.amplitude < min(ends)) | (pair.amplitude > max(ends)) | pair.amplitude.isnull()
            remarks = ["they act against each other"] * bool(pair.opposed.item())
            remarks += ["not reached by this motion"] * bool(missed.all())
            remark = f" ({'; '.join(remarks)})" if remarks else ""
            sentences.append(
                f"{pair['first'].item()} and {pair['second'].item()} weigh the same in the "
                f"{pair.acts_on.item()} at {', '.join(rules)}{remark}."
            )
    return sentences


def _arrest(values: xr.Dataset, unit: str) -> str:
    start = f"From {values.amplitude.item():.3g} {unit}, the averaged motion"
    if not np.isfinite(values.arrest_time.item()):
        return f"{start} does not stop in a finite time."
    exact = values.stop_time.item()
    simulated = f"; the simulated motion stops after {exact:.4g} s" if np.isfinite(exact) else ""
    return f"{start} stops after {quantity(values, 'arrest_time', ' s')}{simulated}."


def _fingerprint(values: xr.Dataset) -> str:
    ratio = f"{values.attrs['numerator']}/{values.attrs['denominator']} = {quantity(values, 'ratio')}"
    verdict = f"{values.attrs['verdict']}, {abs(values.z.item()):.3g} standard errors apart"
    if values.significance.item() < SIGNIFICANT_FRICTION:
        verdict += f"; {values.attrs['denominator']} itself is not significant"
    return f"{ratio}; partial slip has -3 pi/4 = {values.slip_ratio.item():.3f} within a tenth: {verdict}."


def _si_units(values: xr.Dataset) -> str:
    texts = [
        f"{s} {quantity(force, 'coefficient', ' ' + force['unit'].item())}"
        for s, force in by_label(values, "force").items()
    ]
    stiffness = quantity(values, "linear_stiffness", " N m rad-1")
    return f"In SI units: {', '.join(texts)}; linear stiffness {stiffness}."


def _weights_json(result: xr.Dataset, amplitude: float, time: float) -> dict[str, Any]:
    by_force = by_label(weights(result, amplitude, time=time), "force")
    forces = {s: {name: quantity_json(force, name) for name in WEIGHTS} for s, force in by_force.items()}
    return {"amplitude": amplitude, "forces": forces}


def _energy_json(result: xr.Dataset, amplitude: float, time: float, inertia: float | None) -> dict[str, Any]:
    values = dissipated_energy(result, amplitude, inertia, time=time)
    forces = {s: quantity_json(force, "energy") for s, force in by_label(values, "force").items()}
    whole = {name: quantity_json(values, name) for name in ENERGIES}
    return {"amplitude": amplitude, "units": values.energy.attrs["units"], "forces": forces, **whole}


def _crossovers_json(values: xr.Dataset) -> list[dict[str, Any]]:
    return [
        {
            **{name: pair[name].item() for name in ("first", "second", "acts_on")},
            "opposed": bool(pair.opposed.item()),
            **{
                rule: quantity_json(pair.sel(rule=rule), "amplitude") for rule in pair["rule"].values.tolist()
            },
        }
        for pair in _pairs(values)
    ]


def _si_units_json(values: xr.Dataset) -> dict[str, Any]:
    forces = {
        s: quantity_json(force, "coefficient") | {name: force[name].item() for name in ("unit", "multiplies")}
        for s, force in by_label(values, "force").items()
    }
    return {"coefficients": forces, **{k: quantity_json(values, k) for k in ("linear_stiffness", "inertia")}}
