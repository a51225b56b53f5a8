"""What `sysid-trib campaign` does with each record, as its options have it."""

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import xarray as xr

from sysid_trib.campaigns.task import TASKS, Task
from sysid_trib.commands.checks import asked_model
from sysid_trib.commands.discover import StartOptions
from sysid_trib.commands.discovery_inputs import asked_search
from sysid_trib.commands.options import (
    ConstraintOptions,
    DecayOptions,
    ModelOptions,
    SearchOptions,
    changed_flags,
    flag_of,
)
from sysid_trib.commands.record_inputs import read_decays
from sysid_trib.errors import UsageError
from sysid_trib.methods.scope import with_random_force
from sysid_trib.validation.compare import every_method


def decays_of(
    given: DecayOptions,
    reference: float | None,
    contactless: tuple[float, float] | None,
    named: bool,
    path: str,
) -> list[xr.Dataset]:
    """The decays of a file, read as the options say; frequencies that cannot be theirs are refused.

    Where the forces are named, a motion that proves itself no decay is taken as it is.
    """
    return read_decays(replace(given, records=[Path(path)]), reference, contactless, as_it_is=named)[0]


def task_of(
    given: DecayOptions,
    model: ModelOptions,
    constraint: ConstraintOptions,
    search: SearchOptions,
    asked: tuple[str, str | None],
) -> Task:
    """The task that the options ask for.

    Parameters
    ----------
    given, model, constraint, search : dataclasses
        Groups of options.
    asked : (str, str or None)
        Name of the task, and its methods (`A,B,...`).

    Raises
    ------
    UsageError
        An unknown name, or an option that the task does not have.
    """
    name, listed = asked
    if name not in TASKS:
        raise UsageError(f"--task '{name}' is unknown: give {', '.join(TASKS)}.")
    # How a file is read does not depend on which others there are.
    alike, held = replace(given, records=[]), model.reference_frequency
    if name == "discover":
        known = [flag_of(part) for part in fields(StartOptions)]
        others = [*changed_flags(model), *changed_flags(constraint)]
        _refuse(name, [flag for flag in others if flag not in known])
        if listed is not None:
            raise UsageError("--methods are of identify and compare; discover has one of its own.")
        start, offered, options = asked_search(model, model.forces, search, given.system)
        read = partial(decays_of, alike, held, None, bool(model.forces))
        return Task("discover", start, candidates=offered, read=read, options=options)
    _refuse(name, changed_flags(search))
    of_model = asked_model(model, constraint, given.system)
    methods = {
        label: with_random_force(method, of_model.random_force)
        for label, method in every_method(held, of_model.shapes).items()
    }
    wanted = [label.strip() for label in listed.split(",")] if listed else list(methods)
    if name == "identify" and not listed:
        # The two that `identify` holds against each other.
        wanted = ["averaging", "direct"]
    if misspelt := [label for label in wanted if label not in methods]:
        raise UsageError(f"--methods '{misspelt[0]}' is unknown; there are {', '.join(methods)}.")
    return Task(
        name,  # type: ignore[arg-type]
        of_model.library,
        {label: methods[label] for label in wanted},
        judged=name == "identify" and not listed,
        read=partial(decays_of, alike, held, of_model.contactless, bool(model.forces)),
        constraints=of_model.constraints.table,
        contactless=of_model.contactless,
    )


def _refuse(name: str, flags: Sequence[str]) -> None:
    """Refuse options that a task would pass over in silence."""
    if flags:
        raise UsageError(f"{flags[0]} is no option of --task {name}; leave it out, or give another task.")
