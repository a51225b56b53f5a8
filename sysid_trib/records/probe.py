"""Binary files are read by a process of their own first: code in C may hang on a damaged one, or crash.

`check_binary` runs this module on the file, with limits of time and memory; what it could read there to the
end, without leaving the file, is then read as usual. On its own it takes a kind and a path, and says on
standard output what is wrong.
"""

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from sysid_trib.errors import RecordError

# Seconds of the processor: to begin with, and for each byte of the file. On a busy machine that many seconds
# take several times as long.
SECONDS, SECONDS_PER_BYTE = 4.0, 5e-8
BUSY = 15.0
# Of a process that the system ended since it had used up its time.
OUT_OF_TIME = -24
# Bytes of memory: to begin with, and for each byte of the file.
MEMORY, MEMORY_PER_BYTE = 2**30, 16
HDF5 = "hdf5"
# Status of a file that points outside of itself, or in circles; and where the package is not installed that
# reads it, which is named.
LINKED, NO_READER = 3, 4


class LinkedError(ValueError):
    """Numbers that are elsewhere."""


# The module of the package that runs here, wherever the child is started. In a process that does nothing else
# more threads take address space alone.
START = """
import os, runpy, sys
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
sys.path.insert(0, sys.argv.pop(1))
runpy.run_module("sysid_trib.records.probe", run_name="__main__")
"""


def check_binary(path: Path, kind: str) -> None:
    """Read a binary file in a process of its own.

    Parameters
    ----------
    path : path
    kind : str
        `hdf5`, or the name of a reader of `tables`.

    Raises
    ------
    RecordError
        It cannot be read there: damaged, too large or slow to read, or it points outside of itself.
    ImportError
        The package is not installed that reads it, by its name if that is known.
    """
    size = path.stat().st_size
    root = Path(__file__).parents[2]
    command = [sys.executable, "-P", "-c", START, str(root), kind, str(path)]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=BUSY * _seconds(size),
            check=False,
        )
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode == OUT_OF_TIME:
        raise RecordError(f"{path.name}: takes far too long to read; it seems damaged.")
    if done.returncode == LINKED:
        raise RecordError(
            f"{path.name}: {done.stdout.decode().strip()}; copy all numbers into one plain file."
        )
    if done.returncode == NO_READER:
        raise ImportError(name=done.stdout.decode().strip() or None)
    if done.returncode:
        said = done.stdout.decode(errors="replace").strip().splitlines()
        reason = said[-1] if said else "its reader ends without a word"
        raise RecordError(f"{path.name}: cannot be read, it seems damaged or cut off ({reason}).")


def _main(kind: str, path: str) -> int:
    """Read a file within limits; 0 where that works."""
    size = os.path.getsize(path)
    _limit(MEMORY + MEMORY_PER_BYTE * size, math.ceil(_seconds(size)))
    try:
        if kind == HDF5:
            _walk(path)
        else:
            from sysid_trib.records import tables

            getattr(tables, kind)(Path(path))
    except MemoryError:
        print("it needs far more memory than its size lets expect")
        return 1
    except LinkedError as error:
        print(error)
        return LINKED
    except ImportError as error:
        print(error.name or "")
        return NO_READER
    except Exception as error:
        print(next(iter(str(error).splitlines()), "") or type(error).__name__)
        return 1
    return 0


def _seconds(size: int) -> float:
    """Seconds of the processor that a file of so many bytes may take."""
    return SECONDS + SECONDS_PER_BYTE * size


def _limit(memory: int, seconds: int) -> None:
    """Most address space and processor time of this process, where the system has such limits."""
    try:
        import resource
    except ImportError:
        return
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_AS, (memory if most < 0 else min(memory, most), most))


def _walk(path: str) -> None:
    """Read all of an HDF5 file, and refuse what is outside of it or linked in circles."""
    import h5py

    groups: set[int] = set()

    def visit(group: Any) -> None:
        address = h5py.h5o.get_info(group.id).addr
        if address in groups:
            raise LinkedError("a group in it is linked more than once")
        groups.add(address)
        dict(group.attrs)
        for name in group:
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise LinkedError(f"{group.name.rstrip('/')}/{name} is a link to another file")
            item = group[name]
            if isinstance(item, h5py.Group):
                visit(item)
            elif isinstance(item, h5py.Dataset):
                _read(item)

    with h5py.File(path, "r") as file:
        visit(file)


def _read(dataset: Any) -> None:
    """Read a dataset, unless its numbers are elsewhere."""
    if dataset.external or dataset.is_virtual:
        raise LinkedError(f"the numbers of {dataset.name} are in another file")
    dict(dataset.attrs)
    if dataset.shape is not None:
        dataset[()]


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
