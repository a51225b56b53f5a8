"""The command that follows from a result, as it can be copied."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import Field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, get_type_hints

from sysid_trib.commands.options import default_of, flag_of
from sysid_trib.errors import readable

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.printing.next_step import NextStep

RECORDS = "records"


def keep_next(tree: "xr.DataTree", *groups: Any) -> None:
    """Keep the command that follows from a result as its attribute `next`.

    Parameters
    ----------
    tree : DataTree
        Result of a command.
    groups : dataclasses
        Groups of options that the command was given; the next command takes over those that it knows.
    """
    from sysid_trib.printing.next_step import next_step

    step = next_step(tree)
    tree.attrs["next"] = f"{command_after(step, groups)} # {step.reason}"


def command_after(step: "NextStep", groups: Sequence[Any]) -> str:
    """The command of a next step, with the options that were given before.

    Parameters
    ----------
    step : NextStep
    groups : sequence of dataclasses
        Groups of options, in their order.
    """
    known = _options_of(step.command)
    words = ["sysid-trib", step.command]
    replaced = {name.replace("-", "_") for name in (*step.options, *step.without)}
    given = {part.name: (part, getattr(group, part.name)) for group in groups for part in fields(group)}
    words += [_as_word(str(record)) for record in given.pop(RECORDS, (None, []))[1]] + list(step.records)
    for name, (part, value) in given.items():
        if name in known and name.strip("_") not in replaced and value != default_of(part):
            words += _words(part, value)
    words += [word for name, value in step.options.items() for word in (f"--{name}", value)]
    return readable(shlex.join(words))


def _as_word(file: str) -> str:
    """A file as a word of a command, where a dash at its beginning would be an option."""
    return f"./{file}" if file.startswith("-") else file


def _options_of(command: str) -> set[str]:
    """Names of the options of a command, those of its groups among them."""
    from sysid_trib.commands.app import app

    callbacks = [info.callback for info in app.registered_commands]
    taken = next(callback for callback in callbacks if callback and callback.__name__ == command)
    hints: Mapping[str, Any] = get_type_hints(taken.__wrapped__)  # type: ignore[attr-defined]
    groups = [kind for kind in hints.values() if is_dataclass(kind)]
    return {*hints, *(part.name for group in groups for part in fields(group))}


def _words(part: "Field[Any]", value: Any) -> Iterator[str]:
    """An option and its value as words; a switch is its flag alone, a list repeats it."""
    for item in value if isinstance(value, list | tuple) else [value]:
        yield flag_of(part)
        if not isinstance(item, bool):
            yield str(item)
