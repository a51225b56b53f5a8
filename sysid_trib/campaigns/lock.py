"""One campaign at a time writes to a store."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sysid_trib.errors import RecordError


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold the lock of a store: a file beside it, locked until this process lets it go or dies.

    Raises
    ------
    RecordError
        Another campaign holds it.
    """
    place = path.with_name(f".{path.name}.lock")
    held = _held(place, path)
    try:
        yield
    finally:
        if held is not None:
            # Removed while it is held: whoever opened it before finds that it is gone.
            place.unlink(missing_ok=True)
            os.close(held)


def _held(place: Path, path: Path) -> int | None:
    """The lock, as an open file; None where files cannot be locked."""
    if sys.platform == "win32":
        return None
    import fcntl

    while True:
        try:
            file = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            # A place that cannot be written is refused by what writes the store.
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise RecordError(
                f"{path}: another campaign writes to this store; repeat the command when it has ended, or "
                "choose another store with -o."
            ) from None
        except OSError:
            os.close(file)
            return None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), place.stat()):
                return file
        # The campaign that held it has removed it.
        os.close(file)
