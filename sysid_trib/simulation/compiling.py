"""Functions that numba compiles, and where what it compiled is kept: once a user and version of the code."""

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

# Numba's own types know half of its options.
njit: Any = numba.njit
NUMBA_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# Of what only compiled functions call: a way in from Python would take a third of the time to compile.
inner: Any = njit(**NUMBA_OPTIONS, fastmath={"contract"}, no_cpython_wrapper=True)


def compiled(function: Callable[..., Any]) -> Any:
    """A function compiled when it is first called, and kept on disk where the user may write.

    Numba looks at the file of the function alone; the folder is named by all of the engine's, so that nothing
    stale is run. Where nothing can be kept each process compiles anew.
    """
    settings: Any = numba.config
    before, settings.CACHE_DIR = settings.CACHE_DIR, str(_folder())
    try:
        return njit(**NUMBA_OPTIONS, cache=True)(function)
    except RuntimeError:
        return njit(**NUMBA_OPTIONS)(function)
    finally:
        settings.CACHE_DIR = before


def tell_of_compiling() -> None:
    """Say on a terminal that the engine is compiled, where it was not kept."""
    if sys.stderr.isatty() and not any(_folder().rglob("*.nbi")):
        print("Compiling the simulator, once: up to a minute ...", file=sys.stderr, flush=True)


@cache
def _folder() -> Path:
    """The folder of what is compiled, of this user and of these sources."""
    here = Path(__file__).parent
    texts = b"".join(file.read_bytes() for file in sorted(here.glob("*.py")))
    digest = hashlib.sha256(texts + numba.__version__.encode()).hexdigest()[:16]
    if sys.platform == "win32":
        root = os.getenv("LOCALAPPDATA", "")
    else:
        root = os.getenv("XDG_CACHE_HOME", "")
    # Without a home there is no place; the name of it cannot be made either.
    base = Path(root) if root else Path(os.path.expanduser("~")) / ".cache"
    return base / "sysid_trib" / f"engine-{digest}"
