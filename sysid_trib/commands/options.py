"""Options of all commands, of a table (`options.toml`), and what a command was given."""

import tomllib
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any

import typer

# What the embedded example starts from: a search then has two elastic forces to find.
EXAMPLE_FORCES = "lambda,zeta,delta"
# No oscillator is outside of this range in rad/s, Hz or s; far beyond it arithmetic overflows.
LEAST, MOST = 1e-9, 1e9
POSITIVE = (LEAST, MOST, "")
KINDS: dict[str, Any] = {"text": str, "number": float, "count": int, "switch": bool, "file": Path}
KINDS |= {"files": list[Path], "texts": list[str]}
# What stands for an option that is left out, where it is not None.
ABSENT: dict[str, Any] = {"files": [], "texts": [], "switch": False}


@dataclass(frozen=True)
class Option:
    """A row of the table; see there."""

    name: str
    title: str
    help: str
    kind: str = "text"
    value: str | None = None
    default: Any = None
    required: bool = False
    positional: bool = False
    flag: str = ""
    least: int | None = None
    within: Any = None
    ending: str = ""

    @property
    def parameter(self) -> Parameter:
        """It as the argument of a function that typer reads, under the title of its group in the help."""
        told: dict[str, Any] = {"metavar": self.value, "help": self.help, "rich_help_panel": self.title}
        if self.positional:
            # What cannot be read is refused where it is read.
            read = typer.Argument(show_default=self.default != [], readable=False, **told)
        else:
            flags = ("-o", "--output") if self.flag == "-o" else (self.flag,)
            read = typer.Option(*flags, min=self.least, **told)
        kind = KINDS[self.kind] | None if self.default is None else KINDS[self.kind]
        of = {"default": copy(self.default), "annotation": Annotated[kind, read]}
        return Parameter(self.name, Parameter.KEYWORD_ONLY, **of)


def _option(name: str, title: str, row: Mapping[str, Any]) -> Option:
    usual: dict[str, Any] = {"title": title, "flag": f"--{name.replace('_', '-')}"}
    absent = ... if row.get("required") else ABSENT.get(row.get("kind", ""))
    whole = usual | {"default": absent} | dict(row)
    whole["help"] = whole["help"].format(example=EXAMPLE_FORCES)
    if whole.get("within") == "positive":
        whole["within"] = POSITIVE
    return Option(name, **whole)


def _groups() -> dict[str, dict[str, Option]]:
    """The options of the table by their names, in groups by theirs."""
    table = tomllib.loads(Path(__file__).with_name("options.toml").read_text(encoding="utf-8"))
    titles = {name: rows.pop("title") for name, rows in table.items()}
    return {
        group: {
            name: _option(name, titles[group], table[row][name] if isinstance(row, str) else row)
            for name, row in rows.items()
        }
        for group, rows in table.items()
    }


GROUPS = _groups()


class Given:
    """What a command was given: the values of its options by their names, and these as `options`."""

    def __init__(self, options: Mapping[str, Option], **values: Any) -> None:
        vars(self).update({name: copy(row.default) for name, row in options.items()} | values)
        self.options = options

    def __getattr__(self, name: str) -> Any:
        """Refuse what is no option of the command."""
        raise AttributeError(name)

    def but(self, **values: Any) -> "Given":
        """Options and values, some of them others."""
        return Given(**vars(self) | values)

    def changed(self, names: Iterable[str]) -> list[str]:
        """Flags of the options among these that have another value than their default."""
        return [self.options[n].flag for n in names if getattr(self, n) != self.options[n].default]


def options_of(*groups: str) -> dict[str, Option]:
    """The options of groups by their names."""
    return {name: row for group in groups for name, row in GROUPS[group].items()}
