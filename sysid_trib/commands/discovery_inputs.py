"""What `sysid-trib discover` is given beside records: how to search, candidates, and what is held out."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid_trib.commands.checks import check_positive, offered_forces, parse_window
from sysid_trib.commands.options import ModelOptions, SearchOptions
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import further_forces, viscous_model
from sysid_trib.forces.systems import load_system, without_impossible

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.commands.discover import StartOptions
    from sysid_trib.forces.force import ForceLibrary
    from sysid_trib.forces.systems import System


def start_forces(
    library: str,
    forces: str | None,
    frequency: float | None,
    system: "System | None" = None,
    inputs: Collection[str] = (),
) -> "ForceLibrary":
    """The forces of the start model: those asked for, else viscous friction and what drives.

    With what a system always has.

    Raises
    ------
    UsageError
        None are asked for, and the library has no viscous friction.
    """
    if forces is None:
        forces = ",".join(viscous_model(load_library(library), inputs).symbols)
    if system is not None:
        forces = system.with_held(forces)
    return offered_forces(library, forces, frequency is not None)


def asked_search(
    model: "StartOptions | ModelOptions",
    forces: str | None,
    asked: SearchOptions,
    system: str | None,
    inputs: Collection[str] = (),
) -> "tuple[ForceLibrary, ForceLibrary, dict[str, Any]]":
    """The start model, what it may lack, and how to search, as `discover` takes them.

    Parameters
    ----------
    model : dataclass
        Options of the start model.
    forces : str, optional
        Its forces.
    asked : SearchOptions
        How to search.
    system : str, optional
        Name or file of the system: what it always has is held, what it cannot have is not offered.
    inputs : collection of str
        Names of what drives.

    Raises
    ------
    UsageError
        A level that is none, or a time limit that leaves no time; see also `start_forces`.
    """
    held, swinging = model.reference_frequency, None if system is None else load_system(system)
    check_positive(held, "--reference-frequency")
    if not 0.0 < asked.level < 1.0:
        raise UsageError(f"--level '{asked.level:g}' must lie between 0 and 1, such as 0.01.")
    check_positive(asked.time_limit, "--time-limit")
    start = start_forces(model.library, forces, held, swinging, inputs)
    options = {
        "reference_frequency": held,
        "constraints": {} if swinging is None else dict(swinging.held),
        "max_effects": asked.max_effects,
        "refit": asked.refit,
        "level": asked.level,
        "time_limit": asked.time_limit or float("inf"),
    }
    return start, offered_candidates(model.library, asked.candidates, start, swinging, inputs), options


def offered_candidates(
    library: str,
    candidates: str | None,
    start: "ForceLibrary",
    system: "System | None" = None,
    inputs: Collection[str] = (),
) -> "ForceLibrary":
    """What may be missing: the library asked for, or the other forces of the model's and the usual effects.

    What a system cannot have is not among them.

    Raises
    ------
    UsageError
        A candidate has the symbol of another force of the model: a name would then say nothing.
    """
    if candidates is None:
        asked = further_forces(load_library(library), start, inputs)
    else:
        asked = load_library(candidates)
    offered = replace(asked, forces=without_impossible(asked, system))
    for force in offered:
        if force.symbol in start.symbols and force.formula.text != start[force.symbol].formula.text:
            raise UsageError(
                f"Candidate '{force.symbol}' ({force.formula.text}) has the symbol of another force of the "
                f"start model ({start[force.symbol].formula.text}); rename one of them."
            )
    return offered


def held_out(
    decays: "Sequence[xr.Dataset]", window: str | None
) -> "tuple[list[xr.Dataset], list[xr.Dataset]]":
    """What is learned from, and what is kept for prediction: the window (`START:STOP`, s) of each decay."""
    if window is None:
        return list(decays), []
    low, high = parse_window(window, "--holdout")
    pairs = [_parted(decay, low, high, window) for decay in decays]
    return [seen for seen, _ in pairs], [held for _, held in pairs]


def window_text(window: str, runs: int) -> str:
    """What is held out, as the story has it."""
    low, high = parse_window(window, "--holdout")
    ends = "" if low is None else f"from {low:g} s on" if high is None else f"{low:g} s to {high:g} s"
    return (ends or f"up to {high:g} s") + (" of each run" if runs > 1 else "")


def _parted(
    decay: "xr.Dataset", low: float | None, high: float | None, window: str
) -> "tuple[xr.Dataset, xr.Dataset]":
    time = decay.time.values
    inside = (time >= (time[0] if low is None else low)) & (time <= (time[-1] if high is None else high))
    here = f"the decay is from {time[0]:.4g} s to {time[-1]:.4g} s"
    if not inside.any() or inside.all():
        raise DecayError(f"--holdout '{window}' holds out {'all' if inside.any() else 'nothing'}: {here}.")
    if not (inside[0] or inside[-1]):
        raise UsageError(f"--holdout '{window}' must reach to the start or the end: {here}.")
    return decay.isel(time=np.flatnonzero(~inside)), decay.isel(time=np.flatnonzero(inside))
