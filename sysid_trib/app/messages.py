"""Requests of the page to its worker process, and the messages that the process sends."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

# Parts of the page: commands with their titles.
TITLES = {
    "backbone": "Backbone",
    "identify": "Coefficients and residual",
    "laws": "Friction and restoring force",
}


@dataclass(frozen=True)
class Request:
    """A record, how it is read, and the wanted identification.

    Attributes
    ----------
    folder : Path
        Folder for the files that can be downloaded.
    record : str
        File or `dataset:NAME`; empty for the synthetic example.
    shown : str
        Name of the record in the command.
    reading : mapping of str to (str or float)
        Options of `st.records.Reading` that are given.
    window : (float or None, float or None), s
    system : str
        Name of a system, or empty.
    forces : tuple of str
        Symbols of forces; empty for the usual ones.
    laws : bool
        True to identify the laws as well.
    suggest : bool
        True to take the system and the forces that the backbone suggests.
    """

    folder: Path
    record: str = ""
    shown: str = ""
    reading: Mapping[str, str | float] = field(default_factory=dict)
    window: tuple[float | None, float | None] = (None, None)
    system: str = ""
    forces: tuple[str, ...] = ()
    laws: bool = True
    suggest: bool = False

    def command(self, name: str) -> str:
        """Return the command of the terminal that gives the same result."""
        window = ":".join("" if side is None else f"{side:.12g}" for side in self.window)
        options = {**self.reading, "window": window.strip(":") and window, "system": self.system}
        if name == "identify":
            options["forces"] = ",".join(self.forces)
        words = [f"./{self.shown}" if self.shown.startswith("-") else self.shown] if self.shown else []
        for option, value in options.items():
            flag, text = (
                f"--{option.replace('_', '-')}",
                f"{value:.12g}" if isinstance(value, float) else value,
            )
            if text:
                # A value that begins with a dash would be read as an option.
                words += [f"{flag}={text}"] if text.startswith("-") else [flag, text]
        return shlex.join(["sysid-trib", name, *words])


@dataclass(frozen=True)
class Progress:
    """Current work and, if known, its completed fraction."""

    activity: str
    done: float | None = None


@dataclass(frozen=True)
class Signal:
    """The record as read: text, decimated signal, its label and ends, columns, and the suggested model."""

    text: str
    time: np.ndarray
    value: np.ndarray
    label: str
    ends: tuple[float, float]
    columns: Sequence[str]
    system: str
    forces: tuple[str, ...]


@dataclass(frozen=True)
class Section:
    """One of `TITLES` as HTML, the command that gives the same, and files for download."""

    name: str
    text: str
    command: str
    files: Sequence[Path]
    verdict: str


@dataclass(frozen=True)
class Failure:
    """An error in one sentence, columns of the file to choose from, and the part that failed."""

    text: str
    choices: Sequence[str] = ()
    part: str = ""
