"""Which record is refused."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from sysid_trib.errors import DecayError


@contextmanager
def named(records: Sequence[Path]) -> Iterator[None]:
    """Name the files in what they are refused for: a method knows numbers alone.

    Parameters
    ----------
    records : sequence of Path
        None for the embedded example.
    """
    try:
        yield
    except DecayError as error:
        said, names = str(error), [record.name for record in records]
        if not names or any(name in said for name in names):
            raise
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        raise DecayError(f"{names[0]}{more}: {said}") from None
