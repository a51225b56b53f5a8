"""Blocks without a fit: forces of a library, contents of a record, and its backbone."""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from math import pi
from textwrap import fill
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.printing import Block, layout
from sysid_trib.records.roles import input_label, input_names
from sysid_trib.results.backbone_rows import round_rows
from sysid_trib.results.variables import frequency_unit_of

# Explanations for the table of a library, and the number of characters in its text columns (100 columns).
NORMALISED = (
    "theta'' + w^2 (theta + sum of c h) = 0 with x = theta, v = theta'/w, tau = w t.\n"
    "Averages are over x = a cos phi, at a = 0.1 and 1 where there are two numbers.\n"
    "A coefficient c without a unit is dimensionless."
)
FORCE_HEADS = ("symbol", "force", "kind", "<h sin phi>", "<h cos phi>")
WORDS, AT_TWO = 34, " (a = 0.1, 1)"


def force_table(library: ForceLibrary, averages: xr.Dataset) -> Table:
    """Return the forces of a library with their equations and derived properties.

    Parameters
    ----------
    library : ForceLibrary
    averages : Dataset
        Result of `signatures_of`.
    """
    rows = []
    for force in library:
        of_force = averages.sel(force=force.symbol)
        power = of_force.power.item()
        kinds = (force.parity, force.character, POWER_WORDS.get(power, power), force.units)
        kind = (word for word in kinds if word not in ("", "1"))
        words = "\n".join(fill(line, WORDS) for line in (force.name, *equations_of(force)))
        averaged = (text.removesuffix(AT_TWO).replace(", ", "\n") for text in signature_text(force, of_force))
        cells = (force.symbol, words, "\n".join(kind), *averaged)
        rows.append(dict(zip(FORCE_HEADS, cells, strict=True)))
    return layout.text_table(rows, FORCE_HEADS, (FORCE_HEADS[0], *FORCE_HEADS[3:]))


def equations_of(force: Force) -> list[str]:
    """Return a force, its states and memory, and its shape parameters with their ranges, one per line."""
    return [
        f"h = {force.formula.text}",
        *(f"d{name}/dtau = {formula.text}" for name, formula in force.state.items()),
        *(f"{name} := {formula.text} where v = 0" for name, formula in force.memory.items()),
        *(
            f"{name} = {s.default:g} ({s.low:g} to {s.high:g}): {s.meaning}"
            for name, s in force.shape.items()
        ),
    ]


def signature_text(force: Force, averages: xr.Dataset) -> tuple[str, str]:
    """Return the signature in closed form if it is one term, otherwise its values at two amplitudes.

    Parameters
    ----------
    force : Force
    averages : Dataset
        Averages of the force, see `signatures_of`.
    """
    return (
        _average_text(averages.sine.values, force.degree),
        _average_text(averages.cosine.values, force.degree),
    )


def _average_text(average: Array, degree: float | None) -> str:
    small, unit = average.tolist()
    if np.max(np.abs(average)) < 1e-13:
        return "0"
    return f"{small:.3g}, {unit:.3g}{AT_TWO}" if degree is None else _term(unit, degree)


def _term(value: float, degree: float) -> str:
    number = _closed(value)
    if degree == 0:
        return number
    power = "a" if degree == 1 else f"a^{degree:g}"
    return number.replace("1", power) if number in ("1", "-1") else f"{number} {power}"


def _closed(value: float) -> str:
    for unit, name in ((1.0, ""), (1.0 / pi, "/pi")):
        fraction = Fraction(value / unit).limit_denominator(64)
        if fraction and abs(float(fraction) - value / unit) < 1e-12 * abs(value / unit):
            over = fraction.denominator
            if not name:
                return str(fraction)
            return f"{fraction.numerator}/pi" if over == 1 else f"{fraction.numerator}/({over} pi)"
    return f"{value:.4g}"


POWER_WORDS = {"yes": "loses power", "no": "no power", "by amplitude": "loses or gains"}


# Below this number of samples per period, the weak form has few equations, and half-sines few samples.
FEW_SAMPLES = 20.0
# A drift is reported above this fraction of the last amplitude.
DRIFTS = 0.1
FACTS = (
    *("period", "periods", "first_amplitude", "last_amplitude", "first_damping_ratio", "last_damping_ratio"),
    *("drift", "noise", "sensor_step", "samples_per_period"),
)
EXPLANATION = (
    "±: half the width of the simultaneous 95 % band, for sensor noise and a random walk of amplitude and "
    "phase. The band contains the whole curve in 95 % of records."
)


def look_blocks(tree: xr.DataTree, sources: Sequence[str] = (), next_command: str = "") -> Iterator[Block]:
    """Return the blocks of the command `look`.

    Parameters
    ----------
    tree : DataTree
        Result of `look`.
    sources : sequence of str
        Descriptions of the records.
    next_command : str
        Command to copy; may be empty.
    """
    decays = _decays(tree)
    yield Block(list(dict.fromkeys(sources)))
    for count, decay in enumerate(decays, 1):
        heading = [f"Decay {count}:"] * (len(decays) > 1)
        yield Block([*heading, str(decay.attrs.get("free_decay", "")), *_sentences(decay)])
    if next_command:
        yield Block([f"Next: {next_command}"])


def look_json(tree: xr.DataTree, next_command: str) -> dict[str, Any]:
    """Return the facts about a record as plain data, in the unit of the record."""
    records = [node for name, node in tree.children.items() if name.startswith("record")]
    return {
        "records": [layout.mapped(record, "record") for record in records],
        "decays": [layout.mapped(decay, "decay") for decay in _decays(tree)],
        "next": next_command,
    }


def driven_look_blocks(
    tree: xr.DataTree, sources: Sequence[str], models: xr.Dataset, next_command: str
) -> Iterator[Block]:
    """Return the blocks of the command `look` for driven records.

    Parameters
    ----------
    tree : DataTree
        Records with their inputs.
    sources : sequence of str
        Descriptions of the records.
    models : Dataset
        Result of `fitting_models`.
    next_command : str
        Command to copy.
    """
    yield Block(list(dict.fromkeys(sources)))
    for node in tree.children.values():
        run = node.to_dataset()
        yield Block([str(run.attrs.get("free_decay", "")), *_input_sentences(run)])
    yield Block([_fit_sentence(models)])
    yield Block([f"Next: {next_command}"])


def driven_look_json(tree: xr.DataTree, models: xr.Dataset, next_command: str) -> dict[str, Any]:
    """Return the facts about driven records as plain data."""
    return {
        "records": [layout.mapped(record, "record") for record in tree.children.values()],
        "decays": [],
        "driven": True,
        "models": [
            {
                "system": model.system.item(),
                "forces": model.forces.item().split(","),
                "residual_over_motion": model.residual_over_motion.item(),
            }
            for model in (models.isel(model=at) for at in range(models.sizes["model"]))
        ],
        "next": next_command,
    }


def _input_sentences(run: xr.Dataset) -> Iterator[str]:
    """Yield the range of each input, and that of the signal."""
    for name in input_names(run):
        unit = run[name].attrs.get("units", "")
        low, high = float(run[name].min()), float(run[name].max())
        label = input_label(run, name)
        yield f"Driven: input {label} ranges from {low:.4g} to {high:.4g}{f' {unit}' * bool(unit)}."
    own = "measured" if "measured" in run else "angle"
    low, high = float(run[own].min()), float(run[own].max())
    unit = run[own].attrs.get("units", "")
    yield f"The signal ranges from {low:.4g} to {high:.4g} {unit}; it is not a free decay."


def _fit_sentence(models: xr.Dataset) -> str:
    """Describe the residual of each kind of model, relative to the motion."""
    said = []
    columns = (models[name].values.tolist() for name in ("system", "forces", "residual_over_motion"))
    for system, forces, residual in zip(*columns, strict=True):
        kind = f"--system {system}" if system else f"an oscillator with {forces}"
        if residual < 1.0:
            said.append(f"{kind} {100.0 * residual:.2g} %")
    if not said:
        return "First fits of an oscillator and of each system do not follow the motion."
    return f"Residuals of first fits, relative to the motion: {'; '.join(said)}."


def _decays(tree: xr.DataTree) -> list[xr.Dataset]:
    return [node.to_dataset() for name, node in tree.children.items() if name.startswith("decay")]


def _sentences(decay: xr.Dataset) -> list[str]:
    """Describe a decay: the facts, their limits, and the forces that they indicate."""
    value = {name: decay[name].item() for name in FACTS}
    unit = decay.first_amplitude.attrs["units"]
    step = f"smallest step between values {value['sensor_step']:.3g} {decay.sensor_step.attrs['units']}"
    step = step if np.isfinite(value["sensor_step"]) else "values without a visible step"
    first, last = value["first_damping_ratio"], value["last_damping_ratio"]
    fall = value["first_amplitude"] / value["last_amplitude"]
    limits = {
        f"fewer than {FEW_SAMPLES:g} samples per period are few: sample faster": (
            value["samples_per_period"] < FEW_SAMPLES
        ),
        f"the amplitude falls only by a factor of {fall:.3g}, too little to separate laws of damping: record "
        "longer": decay.falls_too_little.item(),
        "the amplitude does not fall: the motion is driven, or the record is too short to show its damping. "
        "For a driven motion, give the input (--input COLUMN or FILE:COLUMN)": fall <= 1.0,
        f"the middle of the swing moves by {value['drift']:.2g} {unit} over the record: a drift, or forces "
        "that differ between the two sides": abs(value["drift"]) > DRIFTS * value["last_amplitude"],
    }
    said = [limit for limit, applies in limits.items() if applies]
    if np.isfinite(power := decay.damping_power.item()):
        said.append(_law(decay.attrs["damping_law"], power))
    pointed, several = decay.attrs["points_to"], str(decay.attrs.get("modes", ""))
    modal = (
        f"Several modes: {several}. These facts are about the mode of {1.0 / value['period']:.3g} Hz; the "
        "others act as noise. --mode selects one of them."
    )
    return [
        *([modal] if several else []),
        f"{value['periods']:.3g} periods of {value['period']:.5g} s; the amplitude falls from "
        f"{value['first_amplitude']:.4g} to {value['last_amplitude']:.4g} {unit}"
        f"{_damping_text(first, last)}.",
        f"{value['samples_per_period']:.3g} samples per period, noise {value['noise']:.2g} {unit}, {step}.",
        *([f"{said[0][0].upper()}{'; '.join(said)[1:]}."] if said else []),
        *([f"{pointed[0].upper()}{pointed[1:]}."] if pointed else []),
        *_sentences_on_systems(decay),
    ]


def _sentences_on_systems(decay: xr.Dataset) -> list[str]:
    """Describe how systems explain the frequency, what the columns indicate, and a wrong scale."""
    attrs = {name: str(value) for name, value in decay.attrs.items()}
    said = []
    if ranked := attrs["predicted_by"]:
        said.append(
            "Part of the frequency shift that stays unexplained with these elastic forces (--system options "
            f"that have them): {ranked}."
        )
    if columns := attrs["columns_point_to_system"]:
        said.append(f"The columns {columns} suggest a {attrs['points_to_system']}.")
    if scale := attrs["points_to_scale"]:
        factor = f"{scale} ± {attrs['points_to_scale_error']}"
        said.append(
            f"The frequency fits if the angle is {factor} times that of the file: probably a scale error of "
            f"the film or encoder (--scale {scale})."
        )
    return said


def _law(law: str, power: float) -> str:
    """Describe the friction indicated by the power of the amplitude in the decay rate."""
    if law == "sign(v)":
        return "the damping ratio is larger at small amplitudes, as with dry friction"
    if law == "v*abs(v)":
        return "the damping ratio is larger at large amplitudes, as with quadratic drag"
    return (
        f"the damping ratio is proportional to the amplitude to the power {power:.2g}; viscous friction "
        "gives the power 0, dry friction -1, quadratic drag 1"
    )


def _damping_text(first: float, last: float) -> str:
    """Describe the local damping ratio from the start to the end; empty if it is not known."""
    if not np.isfinite(first + last):
        return ""
    start, end = (f"{100.0 * ratio:.2g} %" for ratio in (first, last))
    if start == end:
        return f"; the local damping ratio is {start}"
    return f"; the local damping ratio {'rises' if last > first else 'falls'} from {start} to {end}"


def backbone_blocks(backbones: Mapping[str, xr.Dataset], sources: Sequence[str]) -> Iterator[Block]:
    """Return the blocks of the command `backbone`.

    Parameters
    ----------
    backbones : mapping of str to Dataset
        Result of `backbone` of each run.
    sources : sequence of str
        Descriptions of the records.
    """
    yield Block(list(dict.fromkeys(sources)))
    for run, data in enumerate(backbones.values(), 1):
        yield Block(table=_table(data), caption=f"Run {run}:" if len(backbones) > 1 else "")
    yield Block([EXPLANATION])


def backbone_json(backbones: Mapping[str, xr.Dataset]) -> dict[str, Any]:
    """Return the curves of each run as plain data, in the unit of the record."""
    return {"runs": [layout.mapped(data, "backbone") for data in backbones.values()]}


def backbone_csv(backbones: Mapping[str, xr.Dataset]) -> str:
    """Return a row for each run and amplitude."""
    first, rows = next(iter(backbones.values())), []
    heads = [name for name in layout.KEYS["backbone"] if name in first]
    for run, data in enumerate(backbones.values(), 1):
        table = data[heads].to_dataframe().reset_index()
        rows += table.assign(run=run, unit=data.amplitude.attrs["units"]).to_dict("records")
    return layout.csv_of(["run", "unit", *heads], rows)


def _table(data: xr.Dataset) -> Table:
    """Return the frequency and damping ratio at round amplitudes, with half their bands.

    The frequency of a mode is in Hz, as in the list of modes.
    """
    unit = data.amplitude.attrs["units"]
    frequency_unit, in_radians = frequency_unit_of(data.attrs)
    head = f"frequency ({frequency_unit})"
    rows = []
    for row in round_rows(data):
        cells = {f"amplitude ({unit})": f"{row.amplitude:.3g}"}
        if row.measured_amplitude is not None:
            measured = f"{data.attrs['signal']} ({data.measured_amplitude.attrs['units']})"
            cells[measured] = f"{row.measured_amplitude:.3g}"
        cells[head] = layout.value_with_error(row.frequency / in_radians, row.frequency_band / in_radians)
        cells["damping ratio"] = layout.value_with_error(row.damping_ratio, row.damping_ratio_band)
        rows.append(cells)
    return layout.text_table(rows)
