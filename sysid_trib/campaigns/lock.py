"""One writer of a store at a time."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sysid_trib.errors import RecordError

# What says that another process has locked a file: EDEADLK is of Windows.
TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold the lock of a store: a file next to it, locked until this process lets it go or dies.

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
            # Removed while it is held: whoever opened it before finds that it is gone. Windows removes no
            # file that anyone has open.
            if sys.platform != "win32":
                place.unlink(missing_ok=True)
            os.close(held)
            if sys.platform == "win32":
                with suppress(OSError):
                    place.unlink()


def _held(place: Path, path: Path) -> int | None:
    """The lock, as an open file; None where files cannot be locked."""
    while True:
        try:
            file = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            # A place that cannot be written is refused by what writes the store.
            return None
        try:
            _lock(file)
        except OSError as error:
            os.close(file)
            if error.errno not in TAKEN:
                return None
            raise RecordError(
                f"{path}: another campaign writes to this store; repeat the command when it has ended, or "
                "choose another store with -o."
            ) from None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), place.stat()):
                return file
        # The campaign that held it has removed it.
        os.close(file)


def _lock(file: int) -> None:
    """Lock an open file at once; an OSError with one of `TAKEN` where another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        # File systems of a network may have locks of records alone.
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
