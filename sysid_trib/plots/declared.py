"""Which figures show a result: each declares itself above its function, for `--plot`, pages and tests."""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TypeVar

import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.results.files import is_of_driven, kind_of
from sysid_trib.results.variables import group_names, record_groups

Draw = TypeVar("Draw", bound=Callable[..., Figure])
# What `kind_of` says of results, and commands that show what is no result.
RESULT_KINDS = (
    *("cross_check", "driven", "compare", "difference", "discover"),
    *("look", "backbone", "plan", "response"),
)
NO_CAPTIONS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Declared:
    """A figure, and what it shows (see `shows`)."""

    draw: Callable[..., Figure]
    kinds: tuple[str, ...]
    block: str
    groups: tuple[str, ...]
    captions: Mapping[str, str]

    @property
    def of_each_run(self) -> bool:
        """True if each run of a result has one."""
        return "run" in inspect.signature(self.draw).parameters

    def caption(self, tree: xr.DataTree) -> str:
        """What stands below it on a page: what its docstring says before the parameters."""
        said = (inspect.getdoc(self.draw) or "").partition("\n\nParameters\n")[0]
        kind = "driven" if is_of_driven(tree) else kind_of(tree)
        return self.captions.get(kind, " ".join(said.split()))

    def drawings(self, tree: xr.DataTree) -> Iterator[tuple[str, int, Callable[..., Figure]]]:
        """Name of the file, run and what draws it, where the result has what is shown."""
        name = self.draw.__name__
        if self.groups:
            of_these = re.compile(rf"(?:{'|'.join(self.groups)})((?:_\d+)?)")
            ends = dict.fromkeys(match[1] for child in tree.children if (match := of_these.fullmatch(child)))
            for end in ends:
                data = [tree[f"{g}{end}"].to_dataset() for g in self.groups if f"{g}{end}" in tree.children]
                yield f"{name}{end}", int(end[1:] or 1) - 1, partial(self.draw, *data)
        elif self.of_each_run:
            for run, label in enumerate(group_names(name, len(record_groups(tree)))):
                yield label, run, partial(self.draw, tree, run)
        else:
            yield name, 0, partial(self.draw, tree if tree.children else tree.to_dataset())


_DECLARED: dict[str, Declared] = {}


def shows(
    *kinds: str, block: str = "", groups: tuple[str, ...] = (), captions: Mapping[str, str] = NO_CAPTIONS
) -> Callable[[Draw], Draw]:
    """Declare that a function draws a figure of results.

    It takes the result, and `run` if each run has one of its own; or the datasets of `groups`, of each run if
    they are numbered by runs, where the result has any of them.

    Parameters
    ----------
    *kinds : str
        Kinds of result, of `RESULT_KINDS`.
    block : str
        Title of the section of a page that has it; without one `--plot` alone draws it.
    groups : tuple of str
        Groups of the result that are drawn.
    captions : mapping of str to str
        Captions of kinds of result of which the docstring says too much.
    """
    if others := {*kinds, *captions} - set(RESULT_KINDS):
        raise ValueError(f"No result is of the kind {', '.join(sorted(others))}; there are {RESULT_KINDS}.")

    def declare(draw: Draw) -> Draw:
        _DECLARED[draw.__name__] = Declared(draw, kinds, block, groups, captions)
        return draw

    return declare


def figures_of(kind: str) -> list[Declared]:
    """The figures of a kind of result."""
    from sysid_trib import plots

    # A figure is known once its module is imported.
    names = [name for name in dir(plots) if getattr(plots, name)]
    return [_DECLARED[name] for name in names if name in _DECLARED and kind in _DECLARED[name].kinds]
