"""Test reading of binary files in a separate process: C code may hang or crash on a damaged file.

`check_binary` uses a process that it starts once. For each file that process forks a child, which reads the
file to its end within limits of time and memory, without following links to other files. If this succeeds,
the file is read as usual. Where processes cannot fork, the process itself reads, and a new one replaces it if
it dies.
"""

import atexit
import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from time import monotonic
from typing import Any

from sysid_trib.errors import RecordError

# Processor time (s) as a base, and for each byte of the file; on a busy machine the real time is longer.
SECONDS = 4.0
SECONDS_PER_BYTE = 5e-8
BUSY = 15.0
# Memory (bytes) beyond that of the process as a base, and for each byte of the file.
MEMORY = 2**29
MEMORY_PER_BYTE = 16
# Outcomes of reading a file: complete or not, external or circular links, or a missing package.
WHOLE = "whole"
DAMAGED = "damaged"
LINKED = "linked"
NO_READER = "no reader"
# Modules of the readers, imported before a process is forked.
PACKAGES: dict[str, tuple[str, ...]] = {
    "read_hdf5": ("h5py",),
    "read_matlab": ("scipy.io",),
    "read_numpy": ("numpy",),
    "read_excel": ("openpyxl",),
    "read_netcdf": ("xarray", "scipy.io", "h5netcdf.legacyapi", "h5py", "dask.base"),
    "read_parquet": ("pyarrow.parquet", "pyarrow.dataset"),
    "read_tdms": ("nptdms",),
    "read_tree": ("h5py",),
}
# Run the module of this package, wherever the process is started. More threads would only take address space
# there.
START = """
import os, runpy, sys
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
sys.path.insert(0, sys.argv.pop(1))
runpy.run_module("sysid_trib.records.probe", run_name="__main__")
"""


# The reading process of each process; a forked process needs its own.
_processes: dict[int, subprocess.Popen[bytes]] = {}
_locks: dict[int, threading.Lock] = {}


def check_binary(path: Path, reader: str) -> None:
    """Read a binary file in a separate process.

    Parameters
    ----------
    path : path
    reader : str
        Name of a reader: one of `PACKAGES`.

    Raises
    ------
    RecordError
        The file cannot be read there: it is damaged, too large or slow to read, or has links to other files.
    ImportError
        The package that reads the file is not installed; the error names it if it is known.
    """
    with _locks.setdefault(os.getpid(), threading.Lock()):
        end, said = _ask(reader, path)
    if end == LINKED:
        raise RecordError(f"{path.name}: {said}; copy all numbers into one plain file.")
    if end == NO_READER:
        raise ImportError(name=said or None)
    if end == DAMAGED:
        raise RecordError(f"{path.name}: cannot be read, it seems damaged or cut off ({said}).")


def _ask(reader: str, path: Path) -> tuple[str, str]:
    """Read a file in the other process; return the reader used and the error message."""
    process = _processes.get(os.getpid())
    if process is None or process.poll() is not None:
        process = _processes[os.getpid()] = _started()
    assert process.stdin is not None
    assert process.stdout is not None
    seconds = SECONDS + SECONDS_PER_BYTE * path.stat().st_size
    began = monotonic()
    answer = b""
    timer = threading.Timer(BUSY * seconds, _kill, [process])
    try:
        timer.start()
        process.stdin.write(json.dumps([reader, os.fspath(path.absolute()), seconds]).encode() + b"\n")
        process.stdin.flush()
        answer = process.stdout.readline()
    except OSError:
        pass
    finally:
        timer.cancel()
        # Discard a process whose answer was not read: the next file would get that answer.
        if not answer.endswith(b"\n"):
            _end(process, os.getpid())
    if answer.endswith(b"\n"):
        end, said = json.loads(answer)
        return str(end), str(said)
    late = monotonic() - began >= BUSY * seconds
    return DAMAGED, "it takes far too long" if late else "its reader ends without a message"


def _started() -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", START, str(Path(__file__).parents[2])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # In a separate process group: an interrupt from the keyboard must not reach it.
        process_group=None if sys.platform == "win32" else 0,
    )
    atexit.register(_end, process, os.getpid())
    return process


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill the process and its present reader."""
    if sys.platform == "win32":
        process.kill()
        return
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _end(process: subprocess.Popen[bytes], owner: int) -> None:
    """End the process when it is no longer needed; do not end one of another process."""
    if owner == os.getpid() and process.returncode is None:
        _kill(process)
        process.communicate()


def _answer_all() -> None:
    """Answer requests until no more come; each is a JSON line with a reader, a path and seconds."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    # Discard the output of libraries.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    for line in sys.stdin:
        reader, path, seconds = json.loads(line)
        print(json.dumps(_answer(reader, path, seconds)), file=answers)


def _answer(reader: str, path: str, seconds: float) -> tuple[str, str]:
    needed, *besides = PACKAGES[reader]
    try:
        for name in ("sysid_trib.records.formats", needed):
            importlib.import_module(name)
    except ImportError as error:
        return NO_READER, error.name or ""
    for name in besides:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    if not hasattr(os, "fork"):
        return _read(reader, path)
    ours, its = os.pipe()
    child = os.fork()
    if child == 0:
        # An error here must not leave a second process that answers.
        try:
            _limit(seconds, MEMORY + MEMORY_PER_BYTE * os.path.getsize(path))
            os.write(its, json.dumps(_read(reader, path)).encode())
        finally:
            os._exit(0)
    os.close(its)
    with os.fdopen(ours, "rb") as pipe:
        said = pipe.read()
    _, status = os.waitpid(child, 0)
    if said:
        return tuple(json.loads(said))
    late = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU
    return DAMAGED, "it takes far too long" if late else "its reader ends without a message"


def _limit(seconds: float, memory: int) -> None:
    """Limit processor time and further address space of this process."""
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 0
    for what, wanted in (
        (resource.RLIMIT_CPU, round(seconds + 0.5)),
        (resource.RLIMIT_AS, memory + (pages * resource.getpagesize() or MEMORY)),
        # Do not write core files of a crash.
        (resource.RLIMIT_CORE, 0),
    ):
        _, most = resource.getrlimit(what)
        resource.setrlimit(what, (wanted if most < 0 else min(wanted, most), most))


def _read(reader: str, path: str) -> tuple[str, str]:
    """Read a file; return the reader used and the error message."""
    from sysid_trib.records import formats

    try:
        said = _walk(path, whole=reader == "read_tree") if "h5py" in PACKAGES[reader] else ""
        if said:
            return LINKED, said
        if reader != "read_tree":
            getattr(formats, reader)(Path(path))
    except RecordError:
        # The reader reports this fault itself: the requesting process will get the same error.
        return WHOLE, ""
    except MemoryError:
        return DAMAGED, "it needs far more memory than its size suggests"
    # Readers of foreign formats may raise any exception for a damaged file.
    except Exception as error:
        return DAMAGED, next(iter(str(error).splitlines()), "")[:200] or type(error).__name__
    return WHOLE, ""


def _walk(path: str, *, whole: bool) -> str:
    """Visit all of an HDF5 file; return its external or circular links, or nothing.

    For a whole result, only the C library reads: xarray would take seconds for its 400 variables.
    """
    import h5py

    groups: set[int] = set()

    def visit(group: Any) -> str:
        address = h5py.h5o.get_info(group.id).addr
        if address in groups:
            return "a group in it is linked more than once"
        groups.add(address)
        for name in group:
            if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
                return f"{group.name.rstrip('/')}/{name} is a link to another file"
            item = group[name]
            if isinstance(item, h5py.Group) and (said := visit(item)):
                return said
            is_dataset = isinstance(item, h5py.Dataset)
            if is_dataset and (item.external or item.is_virtual):
                return f"the numbers of {item.name} are in another file"
            if whole:
                _ = dict(item.attrs), item[()] if is_dataset else None
        return ""

    # NetCDF of version 3 is not HDF5.
    if not whole and not h5py.is_hdf5(path):
        return ""
    with h5py.File(path, "r") as file:
        return visit(file)


if __name__ == "__main__":
    _answer_all()
