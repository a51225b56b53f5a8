"""Official files, fetched by the package `nonlinear_benchmarks` and kept in the user's cache."""

import contextlib
import io
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sysid_trib.errors import RecordError

INSTALL = "install it by: pip install -e '.[benchmarks]'"


def error_metrics() -> Any:
    """Return the module of the official metrics.

    Raises
    ------
    RecordError
        The package `nonlinear_benchmarks` is not installed.
    """
    try:
        from nonlinear_benchmarks import error_metrics as metrics
    except ImportError:
        raise RecordError(f"The official package nonlinear_benchmarks is not installed; {INSTALL}.") from None
    return metrics


def loaders() -> dict[str, Callable[..., Any]]:
    """Return the official loaders by the folder in which each puts its files."""
    error_metrics()
    import nonlinear_benchmarks as official

    return {
        "Silverbox": official.Silverbox,
        "EMPS": official.EMPS,
        "BoucWen": official.not_splitted_benchmarks.BoucWen,
    }


def cache() -> Path:
    """Return the folder in which downloads are kept."""
    named = os.environ.get("SYSID_TRIB_BENCHMARKS")
    if named:
        return Path(named)
    import pooch

    return Path(pooch.os_cache("sysid_trib")) / "public_benchmarks"


def download(name: str) -> Path:
    """Download the files of a benchmark, unless they are in the cache, and return the folder of all.

    A download that breaks off leaves nothing behind: the files are moved to the cache as a whole.

    Raises
    ------
    RecordError
        The package is not installed, or the download failed.
    """
    folder = cache()
    if (folder / name).is_dir():
        return folder
    loader = loaders()[name]
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        # The package prints its progress.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            try:
                loader(data_file_locations=True, dir_placement=temporary)
            except (
                Exception
            ) as error:  # The package raises errors of requests, urllib, zipfile, and plain ones.
                raise RecordError(f"the download failed ({type(error).__name__})") from None
        shutil.move(Path(temporary) / name, folder / name)
    return folder
