"""What is in a file, as sentences and as plain data for JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing.layers import ALWAYS, Block
from sysid_trib.printing.layout import number

# Below so many samples a period the weak form has few rows, and half-sines few samples.
FEW_SAMPLES = 20.0
# An amplitude that falls by less than this factor hardly tells one law of damping from another.
LEAST_FALL = 2.0
# A drift that counts, beside the last amplitude.
DRIFTS = 0.1
# Power of the amplitude in the rate of decay that speaks for a law: -1 of dry friction, 1 of quadratic drag.
CLEAR_POWER = 0.25
FACTS = (
    *("period", "periods", "first_amplitude", "last_amplitude", "first_damping_ratio", "last_damping_ratio"),
    *("drift", "noise", "sensor_step", "samples_per_period"),
)


def look_blocks(tree: xr.DataTree, sources: Sequence[str], next_command: str) -> list[Block]:
    """What the command `look` prints.

    Parameters
    ----------
    tree : DataTree
        Of `look`.
    sources : sequence of str
        What each record is.
    next_command : str
        To copy.
    """
    decays = _decays(tree)
    several = len(decays) > 1
    blocks = [Block(list(dict.fromkeys(sources)), ALWAYS)]
    for count, decay in enumerate(decays, 1):
        title = f"Decay {count}:" if several else ""
        sentences = [str(decay.attrs.get("free_decay", "")), *_sentences(decay)]
        blocks.append(Block(sentences, ALWAYS, title))
    return [*blocks, Block([f"Next: {next_command}"], ALWAYS)]


def look_json(tree: xr.DataTree, next_command: str) -> dict[str, Any]:
    """The same facts as plain data, in the unit of the record."""
    records = [node.to_dataset() for name, node in tree.children.items() if name.startswith("record")]
    names = ("source", "signal", "angle_unit_in_file", "angle_column", "time_column", "clock", "reading")
    return {
        "records": [{name: record.attrs.get(name) for name in names} for record in records],
        "decays": [
            {name: number(decay[name].item()) for name in FACTS}
            | {"unit": decay.first_amplitude.attrs["units"], "free_decay": decay.attrs.get("free_decay")}
            | {name: decay.attrs[name] for name in ("points_to_forces", "points_to_system")}
            for decay in _decays(tree)
        ],
        "next": next_command,
    }


def pointed_options(tree: xr.DataTree, system_given: bool) -> dict[str, str]:
    """Options of `identify` that the backbones of all decays point to.

    Parameters
    ----------
    tree : DataTree
        Of `look`.
    system_given : bool
        Whether the user has said what swings.
    """
    decays = _decays(tree)
    systems = {str(decay.attrs["points_to_system"]) for decay in decays}
    forces = dict.fromkeys(
        symbol for decay in decays for symbol in str(decay.attrs["points_to_forces"]).split(",") if symbol
    )
    # Of another system the frequency is another one's, and so are its forces.
    options = {} if system_given or not forces else {"forces": ",".join(forces)}
    return options | (
        {"system": systems.pop()} if not system_given and len(systems) == 1 and all(systems) else {}
    )


def _decays(tree: xr.DataTree) -> list[xr.Dataset]:
    return [node.to_dataset() for name, node in tree.children.items() if name.startswith("decay")]


def _sentences(decay: xr.Dataset) -> list[str]:
    value = {name: decay[name].item() for name in FACTS}
    unit = decay.first_amplitude.attrs["units"]
    step = f"step of the sensor {value['sensor_step']:.3g} {decay.sensor_step.attrs['units']}"
    step = step if np.isfinite(value["sensor_step"]) else "no step of the sensor is seen"
    fall = value["first_amplitude"] / value["last_amplitude"]
    sentences = [
        f"{value['periods']:.3g} periods of {value['period']:.5g} s; the amplitude falls from "
        f"{value['first_amplitude']:.4g} to {value['last_amplitude']:.4g} {unit}{_rates(value)}.",
        f"{value['samples_per_period']:.3g} samples a period, noise {value['noise']:.2g} {unit}, {step}.",
    ]
    limits = []
    if value["samples_per_period"] < FEW_SAMPLES:
        limits.append(f"fewer than {FEW_SAMPLES:g} samples a period make few equations: sample faster")
    if fall < LEAST_FALL:
        limits.append(
            f"the amplitude falls by a factor of {fall:.3g} alone, which hardly tells one law of damping "
            "from another: record longer"
        )
    if abs(value["drift"]) > DRIFTS * value["last_amplitude"]:
        limits.append(
            f"the middle of the swing moves by {value['drift']:.2g} {unit} over the record, as by a drift or "
            "by forces that differ between the two sides"
        )
    limits += _law(value, fall)
    sentences += [f"{'; '.join(limits).capitalize()}."] if limits else []
    pointed = decay.attrs["points_to"]
    return [*sentences, f"{pointed[0].upper()}{pointed[1:]}."] if pointed else sentences


def _rates(value: dict[str, float]) -> str:
    """The rate of decay at either end; nothing where there is none."""
    first, last = value["first_damping_ratio"], value["last_damping_ratio"]
    if not np.isfinite(first + last):
        return ""
    return f", its rate over w is {first:.3g} at the start and {last:.3g} at the end"


def _law(value: dict[str, float], fall: float) -> list[str]:
    """What the change of the rate of decay with amplitude speaks for."""
    first, last = value["first_damping_ratio"], value["last_damping_ratio"]
    if fall < LEAST_FALL or not (first > 0.0 and last > 0.0):
        return []
    power = float(np.log(first / last) / np.log(fall))
    if power < -CLEAR_POWER:
        return ["the smaller the amplitude the faster it falls, as by dry friction"]
    if power > CLEAR_POWER:
        return ["the larger the amplitude the faster it falls, as by drag"]
    return [
        f"the rate goes with the amplitude to the power of {power:.2g}: nearest to viscous friction, which "
        "has 0 (dry friction -1, drag 1)"
    ]
