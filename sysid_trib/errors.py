"""Errors for the user, and progress of long computations."""

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Protocol


class SysidTribError(ValueError):
    """Base of the package's errors; the command line ends with `exit_status`.

    Parameters
    ----------
    message : str
        The error, its place, and the remedy. It may quote a file, so control characters are removed.
    """

    exit_status = 1

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class UsageError(SysidTribError):
    """A name that does not exist: an option, command, force, column or file."""

    exit_status = 2


class ChoiceError(UsageError):
    """A file in which several columns could be the signal.

    Parameters
    ----------
    message : str
        The error, its place, and the remedy.
    choices : iterable of str
        Names of these columns.
    """

    def __init__(self, message: str, choices: Iterable[str]) -> None:
        super().__init__(message)
        self.choices = tuple(choices)


class LibraryError(SysidTribError):
    """A force library that is malformed, hostile or not finite."""


class RecordError(SysidTribError):
    """A file that cannot be read as a record, or a result that cannot be written."""


class DecayError(SysidTribError):
    """A record that cannot support the request: too short, growing, clipped, flat, noise."""


class SimulationError(SysidTribError):
    """A model whose motion cannot be computed: diverging or switching without end."""


def printable(text: str) -> str:
    """Return one line without control characters, which names of columns may contain."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def readable(name: str) -> str:
    """Return a name from the operating system as text; undecodable characters become question marks."""
    return name.encode("utf-8", "replace").decode()


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ` Did you mean ...?` with the known name nearest to an unknown one, or an empty text.

    Parameters
    ----------
    name : str
        Name as given by the user.
    known : iterable of str
        Known names.
    """
    by_lower = {text.lower(): text for text in known}
    near = get_close_matches(name.strip().lower(), by_lower, n=1)
    return f" Did you mean '{by_lower[near[0]]}'?" if near else ""


class Tell(Protocol):
    """Progress report: called with the name of the current work and, if known, its completed fraction."""

    def __call__(self, activity: str, done: float | None = None) -> None:
        """Report.

        Parameters
        ----------
        activity : str
            Work that begins or continues.
        done : float, optional
            Completed fraction of it, 0 to 1, from which the remaining time is estimated.
        """


def silent(activity: str, done: float | None = None) -> None:
    """Report no progress."""


def internal_error_text(error: Exception) -> str:
    """Describe an internal error in one line that shows its place, without a traceback."""
    import traceback

    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(frame.filename).name}:{frame.lineno}"
    return f"Internal error ({type(error).__name__} in {place}: {error}); please report it."
