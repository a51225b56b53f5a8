"""Results as files: netCDF that comes back equal, figures; written beside their place and renamed."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import xarray as xr

from sysid_trib.errors import RecordError, UsageError


def save(result: xr.Dataset | xr.DataTree, path: str | os.PathLike[str]) -> None:
    """Write a result as netCDF: beside its place first, then renamed, so that no half file is left.

    Parameters
    ----------
    result : any result of this package.
    path : the file, replaced if it is there.

    Raises
    ------
    RecordError
        The place cannot be written.
    """
    target = Path(path)

    write_beside(target, lambda beside: result.to_netcdf(beside, engine="h5netcdf"))


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure as PDF and PNG beside each other, its folder made if need be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(
            f"{path.parent}: cannot be made ({error.strerror}); choose another folder."
        ) from None
    for suffix in (".pdf", ".png"):
        write_beside(path.with_suffix(suffix), lambda beside: figure.savefig(beside, dpi=150))


def write_beside(target: Path, write: Callable[[str], Any]) -> None:
    """Call `write(temporary path)` in the target's folder and rename the file to `target`."""
    try:
        handle, beside = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}-", suffix=target.suffix)
        os.close(handle)
    except OSError as error:
        reason = error.strerror or error
        raise RecordError(f"{target}: cannot be written ({reason}); choose another place with -o.") from None
    try:
        write(beside)
        # mkstemp makes files that only their owner may read.
        os.chmod(beside, 0o666 & ~_umask())
        os.replace(beside, target)
    except OSError as error:
        reason = error.strerror or error
        raise RecordError(f"{target}: cannot be written ({reason}); choose another place with -o.") from None
    finally:
        Path(beside).unlink(missing_ok=True)


def load(path: str | os.PathLike[str]) -> xr.DataTree:
    """Read a result back from netCDF.

    Parameters
    ----------
    path : a file that `save` wrote.

    Returns
    -------
    DataTree, equal to what was saved and wholly in memory; a single Dataset is its root.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        It is no result in netCDF.
    """
    try:
        tree = xr.open_datatree(path, engine="h5netcdf")
    except FileNotFoundError:
        raise UsageError(f"There is no file {path}.") from None
    except (OSError, ValueError) as error:
        raise RecordError(f"{Path(path).name}: not a result in netCDF ({error}).") from None
    with tree:
        return tree.load()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
