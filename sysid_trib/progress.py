"""What a long computation says of itself while it runs."""

from typing import Protocol


class Tell(Protocol):
    """Takes the name of what begins, and which part of it is done where that is known."""

    def __call__(self, activity: str, done: float | None = None) -> None:
        """Report.

        Parameters
        ----------
        activity : str
            What begins, or goes on.
        done : float, optional
            Part of it that is done, 0 to 1, from which the time left follows.
        """


def silent(activity: str, done: float | None = None) -> None:
    """Say nothing."""
