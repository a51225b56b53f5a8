"""Results as files: the format of a result, and netCDF that is read back equal or replaces nothing."""

import errno
import io
import os
import secrets
import sys
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records import tables
from sysid_trib.records.probe import check_binary
from sysid_trib.results.variables import FORMAT_VERSION

# netCDF returns a list of one text as the text, and an empty list as an array.
LISTS = (
    *("record_source", "record_checksum", "first_record", "second_record"),
    *("left_out", "failed_fits", "parts", "decimated"),
)


def current_format(tree: xr.DataTree, path: Path) -> xr.DataTree:
    """Convert a tree of an earlier file to the present format.

    Parameters
    ----------
    tree : DataTree
        Tree that netCDF returned.
    path : path
        Its file, for the message.

    Raises
    ------
    RecordError
        The file has another version of the format.
    """
    for node in tree.subtree:
        version = node.attrs.get("format_version", 1)
        if "sysid_trib_version" in node.attrs and version != FORMAT_VERSION:
            raise RecordError(
                f"{path.name}: a result in format {version}, and this version of sysid_trib reads format "
                f"{FORMAT_VERSION}; make the result again."
            )
        # A record and its envelope have a single source, as text.
        lists = [name for name in LISTS if name in node.attrs and "source" not in node.attrs]
        node.attrs |= {name: np.ravel(node.attrs[name]).astype(str).tolist() for name in lists}
    return tree


# Beginning of the names of incomplete files.
TEMPORARY = ".sysid-trib-"


def save(result: xr.Dataset | xr.DataTree, path: str | os.PathLike[str]) -> None:
    """Write a result as netCDF; an older file is replaced only by a complete one.

    Parameters
    ----------
    result : Dataset or DataTree
        Any result of this package.
    path : str or path
        The file; an existing one is replaced.

    Raises
    ------
    RecordError
        The file cannot be written. The older file is unchanged.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin())
    >>> st.save(result, "result.nc")
    >>> st.load("result.nc").identical(result)
    True
    """
    # HDF5 can crash the process when it closes a file on a full disk: let it write to memory.
    write_file(Path(path), bytes(result.to_netcdf(engine="h5netcdf")))


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure as PDF and PNG (300 dpi) next to each other; create the folder if necessary.

    Parameters
    ----------
    figure : matplotlib Figure
    path : path
        Path without an ending.

    Raises
    ------
    RecordError
        The file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(
            f"{path.parent}: cannot be made ({error.strerror}); choose another folder."
        ) from None
    for kind in ("pdf", "png"):
        content = io.BytesIO()
        figure.savefig(content, dpi=300, format=kind)
        write_file(path.with_suffix(f".{kind}"), content.getvalue())


def write_file(target: Path, content: bytes) -> None:
    """Write a file under another name in its folder, read it back, and rename it only if it is complete.

    Parameters
    ----------
    target : path
        The file; an existing one is replaced.
    content : bytes
        Whole content of the file.

    Raises
    ------
    RecordError
        The file cannot be written, or differs from its content when read back. The older file is unchanged.
    """
    temporary = target.with_name(f"{_mark(os.getpid())}{secrets.token_hex(8)}{target.suffix}")
    try:
        _clear(target.parent)
        try:
            with temporary.open("xb") as file:
                file.write(content)
                file.flush()
                # A full disk may be detected only now, or when the file is closed.
                os.fsync(file.fileno())
            if temporary.read_bytes() != content:
                raise OSError(errno.EIO, "what was written does not read back the same")
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise RecordError(f"{target}: cannot be written ({reason}); choose another place.") from None


def _mark(process: int) -> str:
    """Return the prefix of temporary file names of a process on this machine."""
    return f"{TEMPORARY}{uuid.getnode():x}-{process}-"


def _clear(folder: Path) -> None:
    """Remove temporary files of killed processes of this machine from a folder."""
    for place in folder.glob(f"{TEMPORARY}{uuid.getnode():x}-*"):
        process = place.name.removeprefix(TEMPORARY).split("-")[1]
        if process.isdecimal() and not _is_alive(int(process)):
            place.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    """Return true if a process of this machine is running, as far as the system reports."""
    if sys.platform == "win32":
        return True
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)
    return True


def load(path: str | os.PathLike[str]) -> xr.DataTree:
    """Read a result back from netCDF.

    Parameters
    ----------
    path : str or path
        A file that `save` wrote.

    Returns
    -------
    DataTree
        Equal to the saved result and completely in memory. A single Dataset is its root.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        The file is not a result in netCDF, or has another version of the format.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> st.save(result, "result.nc")
    >>> st.load("result.nc").coefficient.sel(force="zeta").round(4).item()
    0.0097
    """
    place = Path(path)
    if not os.path.exists(place):
        raise UsageError(f"There is no file {path}.")
    if place.is_dir():
        raise RecordError(
            f"{place.name}: a folder, no result in netCDF; the store of a campaign has its page next to it "
            f"({place.stem}.html), and st.campaigns.open_store reads it."
        )
    tables.check_is_file(place)
    try:
        with place.open("rb") as file:
            hdf5 = file.read(4) == b"\x89HDF"
        if not hdf5:
            raise RecordError(f"{place.name}: not a result in netCDF, as commands write with -o.")
        check_binary(place, "read_tree")
        with xr.open_datatree(place, engine="h5netcdf") as tree:
            return current_format(tree.load(), place)
    except (RecordError, MemoryError):
        raise
    # Readers may raise any exception for a damaged file.
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise RecordError(f"{place.name}: not a result in netCDF, or a damaged one ({reason}).") from None
