"""What `sysid-trib discover` is given beside records: how to search, candidates, and what is held out."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid_trib.commands.checks import check_positive, offered_forces, parse_window
from sysid_trib.commands.options import SearchOptions
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import load_library

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.forces.force import ForceLibrary
    from sysid_trib.forces.systems import System

EFFECTS = "candidate_effects"


def start_forces(
    library: str, forces: str | None, frequency: float | None, system: "System | None" = None
) -> "ForceLibrary":
    """The forces of the start model: those asked for, else viscous friction; and what a system always has.

    Raises
    ------
    UsageError
        None are asked for, and the library has no viscous friction.
    """
    if forces is None:
        whole = load_library(library)
        viscous = whole.role("2*v") or whole.role("v")
        if viscous is None:
            raise UsageError(
                f"Library '{whole.title}' has no viscous friction to start from; name the forces of the "
                f"start model (--forces {','.join(whole.symbols[:2])})."
            )
        forces = viscous.symbol
    if system is not None:
        forces = system.with_held(forces)
    return offered_forces(library, forces, frequency is not None)


def search_options(
    asked: SearchOptions, frequency: float | None, system: "System | None" = None
) -> dict[str, Any]:
    """How to search, and what a system always has, as `discover` takes it.

    Raises
    ------
    UsageError
        A level that is none, or a time limit that leaves no time.
    """
    if not 0.0 < asked.level < 1.0:
        raise UsageError(f"--level '{asked.level:g}' must lie between 0 and 1, such as 0.01.")
    check_positive(asked.time_limit, "--time-limit")
    return {
        "reference_frequency": frequency,
        "fix": {} if system is None else dict(system.held),
        "max_effects": asked.max_effects,
        "refit": asked.refit,
        "level": asked.level,
        "time_limit": asked.time_limit or float("inf"),
    }


def offered_candidates(library: str, candidates: str | None, start: "ForceLibrary") -> "ForceLibrary":
    """What may be missing: the library asked for, or the other forces of the model's and the usual effects.

    Raises
    ------
    UsageError
        A candidate has the symbol of another force of the model: a name would then say nothing.
    """
    if candidates is not None:
        offered = load_library(candidates)
    else:
        whole, effects = load_library(library), load_library(EFFECTS)
        others = [force for force in whole if force.symbol not in start.symbols]
        taken = [force.symbol for force in (*start, *others)]
        # One's own force of a symbol goes before the usual effect of the same.
        others += [force for force in effects if force.symbol not in taken]
        offered = replace(effects, forces=tuple(others))
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
