"""What follows from an identification, in sentences for the terminal and as plain data for JSON."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import LibraryError
from sysid_trib.physics.crossing import crossovers
from sysid_trib.physics.energy import arrest_time, dissipated_energy
from sysid_trib.physics.fingerprint import SIGNIFICANT, slip_fingerprint
from sysid_trib.physics.force_weights import weights
from sysid_trib.physics.quantities import amplitudes
from sysid_trib.physics.units import physical_units
from sysid_trib.printing.layout import number, value_with_error
from sysid_trib.results.schema import library_of

# A share below this is not worth a word.
SMALL = 5e-4
WEIGHTS = ("peak_force", "decay", "frequency_shift", "decay_share", "frequency_share")
ENERGIES = ("total_energy", "lost_fraction")


def physics_sentences(result: xr.Dataset, amplitude: ArrayLike, inertia: float | None = None) -> list[str]:
    """The physics of an identification in plain sentences.

    Parameters
    ----------
    result : an identification.
    amplitude : rad; the largest and the smallest are told of, and the motion is followed from the largest.
    inertia : kg m^2; with it energies and coefficients are told in SI units.

    Returns
    -------
    Sentences, short, numbers with their standard errors. A force that is not finite on these cycles leaves
    out what it spoils, and is named.

    Raises
    ------
    UsageError
        Not an identification, not positive angles, or no positive inertia.
    """
    a = amplitudes(amplitude)
    ends = sorted({float(a.max()), float(a.min())}, reverse=True)
    sentences = []
    try:
        for end in ends:
            sentences += _weights_told(result, end)
        sentences += _energy_told(result, ends[0], inertia)
        sentences += _crossovers_told(crossovers(result), ends)
        sentences += _arrest_told(arrest_time(result, ends[0]))
    except LibraryError as error:
        sentences.append(f"The rest cannot be told: {error}")
    if _holds_fingerprint(result):
        sentences.append(_fingerprint_told(slip_fingerprint(result)))
    if inertia is not None:
        sentences.append(_units_told(physical_units(result, inertia)))
    return sentences


def physics_json(result: xr.Dataset, amplitude: ArrayLike, inertia: float | None = None) -> dict[str, Any]:
    """The physics of an identification as plain data; non-finite numbers are None.

    Parameters
    ----------
    result, amplitude, inertia : As `physics_sentences`.

    Returns
    -------
    `weights` and `energy` (lists, one entry an amplitude), `crossovers` (a list) and `arrest`, or in their
    place `refused`, why there are none; where they apply `slip_fingerprint` and `physical_units`. Each number
    is a float or has `value` and `standard_error`.

    Raises
    ------
    UsageError
        As `physics_sentences`.
    """
    a = amplitudes(amplitude)
    ends = sorted({float(a.max()), float(a.min())}, reverse=True)
    data: dict[str, Any] = {}
    try:
        data["weights"] = [_weights_data(result, end) for end in ends]
        data["energy"] = [_energy_data(result, end, inertia) for end in ends]
        data["crossovers"] = _crossovers_data(crossovers(result))
        stop = arrest_time(result, ends[0])
        data["arrest"] = {
            "amplitude": ends[0],
            "arrest_time": _pair(stop, "arrest_time"),
            "stop_time": number(stop.stop_time.item()),
        }
    except LibraryError as error:
        data = {"refused": str(error)}
    if _holds_fingerprint(result):
        slip = slip_fingerprint(result)
        scalars = {k: number(slip[k].item()) for k in ("slip_ratio", "z", "p_value", "significance")}
        data["slip_fingerprint"] = {"ratio": _pair(slip, "ratio"), **scalars, **slip.attrs}
    if inertia is not None:
        data["physical_units"] = _units_data(physical_units(result, inertia))
    return data


def _holds_fingerprint(result: xr.Dataset) -> bool:
    library = library_of(result)
    return all(library.role(formula) is not None for formula in ("x*abs(x)", "v*abs(v)"))


def _pair(found: xr.Dataset, name: str) -> dict[str, float | None]:
    error = found[f"{name}_standard_error"].item()
    return {"value": number(found[name].item()), "standard_error": number(error)}


def _with_error(found: xr.Dataset, name: str, units: str = "", factor: float = 1.0) -> str:
    value, error = factor * found[name].item(), factor * found[f"{name}_standard_error"].item()
    return f"{value_with_error(value, error)}{units}"


def _weights_told(result: xr.Dataset, amplitude: float) -> list[str]:
    found = weights(result, amplitude)
    parts = []
    for share, what in (("decay_share", "the decay is"), ("frequency_share", "the frequency shift is")):
        size = np.abs(found[share].values)
        order = found.force.values[np.argsort(-size, kind="stable")].tolist()
        # NaN, where no force acts, is not larger than anything.
        kept = [s for s in order if abs(found[share].sel(force=s).item()) > SMALL]
        each = [f"{s} {_with_error(found.sel(force=s), share, ' %', 100.0)}" for s in kept]
        if each:
            parts.append(f"{what} {', '.join(each)}")
    return [f"At {amplitude:.3g} rad {'; '.join(parts)}."] if parts else []


def _energy_told(result: xr.Dataset, amplitude: float, inertia: float | None) -> list[str]:
    found = dissipated_energy(result, amplitude, inertia)
    if not found.total_energy.item():
        return []
    lost = _with_error(found, "lost_fraction", " %", 100.0)
    joule = "" if inertia is None else f", {_with_error(found, 'total_energy', ' J')}"
    return [f"A cycle at {amplitude:.3g} rad takes {lost} of the energy I w^2 a^2/2{joule}."]


def _crossovers_told(found: xr.Dataset, ends: list[float]) -> list[str]:
    """Where two forces weigh the same; an amplitude that the motion does not pass is only extrapolated."""
    sentences = []
    for i in range(found.sizes["pair"]):
        pair = found.isel(pair=i)
        rules = [
            f"{_with_error(pair.sel(rule=rule), 'amplitude', ' rad')} {name}"
            for rule, name in (("averaged", "on average"), ("peak force", "by peak force"))
            if np.isfinite(pair.amplitude.sel(rule=rule).item())
        ]
        if rules:
            missed = (pair.amplitude < min(ends)) | (pair.amplitude > max(ends)) | pair.amplitude.isnull()
            remarks = ["they act against each other"] if pair.opposed.item() else []
            remarks += ["not reached by this motion"] if missed.all() else []
            told_too = f" ({'; '.join(remarks)})" if remarks else ""
            sentences.append(
                f"{pair['first'].item()} and {pair['second'].item()} weigh the same in the "
                f"{pair.acts_on.item()} at {', '.join(rules)}{told_too}."
            )
    return sentences


def _arrest_told(found: xr.Dataset) -> list[str]:
    start = found.amplitude.item()
    if not np.isfinite(found.arrest_time.item()):
        return [f"From {start:.3g} rad the averaged motion has no arrest: it fades, or goes on."]
    exact = found.stop_time.item()
    simulated = f"; the simulated motion after {exact:.4g} s" if np.isfinite(exact) else ""
    stops = _with_error(found, "arrest_time", " s")
    return [f"From {start:.3g} rad the averaged motion stops after {stops}{simulated}."]


def _fingerprint_told(found: xr.Dataset) -> str:
    ratio = f"{found.attrs['numerator']}/{found.attrs['denominator']} = {_with_error(found, 'ratio')}"
    slip = f"partial slip has -3 pi/4 = {found.slip_ratio.item():.3f} within a tenth"
    apart = f"{found.attrs['verdict']}, {abs(found.z.item()):.3g} errors apart"
    if found.significance.item() < SIGNIFICANT:
        apart += f"; {found.attrs['denominator']} itself is not significant"
    return f"{ratio}; {slip}: {apart}."


def _units_told(found: xr.Dataset) -> str:
    each = [
        f"{s} {value_with_error(one.coefficient.item(), one.standard_error.item())} {one['unit'].item()}"
        for s in found.force.values.tolist()
        for one in (found.sel(force=s),)
    ]
    stiffness = _with_error(found, "linear_stiffness", " N m rad-1")
    return f"In SI units: {', '.join(each)}; linear stiffness {stiffness}."


def _weights_data(result: xr.Dataset, amplitude: float) -> dict[str, Any]:
    found = weights(result, amplitude)
    forces = {
        s: {name: _pair(found.sel(force=s), name) for name in WEIGHTS} for s in found.force.values.tolist()
    }
    return {"amplitude": amplitude, "forces": forces}


def _energy_data(result: xr.Dataset, amplitude: float, inertia: float | None) -> dict[str, Any]:
    found = dissipated_energy(result, amplitude, inertia)
    forces = {s: _pair(found.sel(force=s), "energy") for s in found.force.values.tolist()}
    whole = {name: _pair(found, name) for name in ENERGIES}
    return {"amplitude": amplitude, "units": found.energy.attrs["units"], "forces": forces, **whole}


def _crossovers_data(found: xr.Dataset) -> list[dict[str, Any]]:
    rows = []
    for i in range(found.sizes["pair"]):
        pair = found.isel(pair=i)
        labels = {k: pair[k].item() for k in ("first", "second", "acts_on")}
        rules = {rule: _pair(pair.sel(rule=rule), "amplitude") for rule in pair["rule"].values.tolist()}
        rows.append({**labels, "opposed": bool(pair.opposed.item()), **rules})
    return rows


def _units_data(found: xr.Dataset) -> dict[str, Any]:
    forces = {
        s: {
            "value": number(found.coefficient.sel(force=s).item()),
            "standard_error": number(found.standard_error.sel(force=s).item()),
            "unit": found["unit"].sel(force=s).item(),
            "multiplies": found["multiplies"].sel(force=s).item(),
        }
        for s in found.force.values.tolist()
    }
    return {"coefficients": forces, **{k: _pair(found, k) for k in ("linear_stiffness", "inertia")}}
