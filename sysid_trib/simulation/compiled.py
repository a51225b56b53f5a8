"""Compilation by numba and its cache; Taylor series of all slots of a program, with their derivatives.

J[slot, k] is the k-th Taylor coefficient, T[slot, k, parameter] its derivative, order by order. The
recurrences are those of automatic differentiation (Jorba and Zou 2005, Table 2); their derivatives are the
same, linearised.
"""

import hashlib
import math
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.caching import FunctionCache

from sysid_trib.simulation import program as op

# Numba's type annotations miss half of its options.
njit: Any = numba.njit
# Compiled functions create and keep no arrays. So reference counts, which every view of an array would
# change, are switched off; this halves the time.
NUMBA_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "_nrt": False,
}
# For functions that only compiled functions call: an entry point from Python would add a third to the compile
# time.
inner: Any = njit(**NUMBA_OPTIONS, fastmath={"contract"}, no_cpython_wrapper=True)


_COMPILING = "Compiling the simulator, once: up to a minute ..."


class _RebuiltCache(FunctionCache):
    """Cache of numba on disk; a damaged file is compiled again instead of raising an error.

    A file is incomplete if a process was killed or the disk was full. Reading it may raise any exception.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            if sys.stderr.isatty():
                print(_COMPILING, file=sys.stderr, flush=True)
            # Write an empty index, so that newly compiled functions are stored.
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        # If the disk is full, each process compiles the functions again.
        with suppress(Exception):
            super().save_overload(sig, data)


def compiled(function: Callable[..., Any]) -> Any:
    """Return a function that is compiled at its first call, and cached on disk if the user may write there.

    Numba checks only the source file of the function. The folder name therefore depends on all sources of the
    engine, so that outdated code is never used. Without a cache each process compiles again.
    """
    settings: Any = numba.config
    before, settings.CACHE_DIR = settings.CACHE_DIR, str(_folder())
    try:
        dispatcher = njit(**NUMBA_OPTIONS, cache=True)(function)
        dispatcher._cache = _RebuiltCache(function)
        return dispatcher
    except RuntimeError:
        return njit(**NUMBA_OPTIONS)(function)
    finally:
        settings.CACHE_DIR = before


def tell_of_compiling() -> None:
    """Report on a terminal that the engine is being compiled, if it is not cached."""
    if sys.stderr.isatty() and not any(_folder().rglob("*.nbi")):
        print(_COMPILING, file=sys.stderr, flush=True)


@cache
def _folder() -> Path:
    """Return the cache folder for this user and these sources."""
    here = Path(__file__).parent
    texts = b"".join(file.read_bytes() for file in sorted(here.glob("*.py")))
    digest = hashlib.sha256(texts + numba.__version__.encode()).hexdigest()[:16]
    if sys.platform == "win32":
        root = os.getenv("LOCALAPPDATA", "")
    else:
        root = os.getenv("XDG_CACHE_HOME", "")
    # Without a home directory the path does not exist and cannot be created.
    base = Path(root) if root else Path(os.path.expanduser("~")) / ".cache"
    return base / "sysid_trib" / f"engine-{digest}"


# These functions are called most often. They take arrays one by one, because a call takes time for each entry
# of a tuple, and a program has seventy.
@inner
def _row_by_row(code, c, J, first, last, live):
    """Compute slots from `first` up to `last` at order 0; signs follow their surfaces where `live`."""
    for s in range(first, last):
        o, p, q, d = code[s, 0], code[s, 1], code[s, 2], code[s, 3]
        if o == op.ADD:
            J[s, 0] = J[p, 0] + J[q, 0]
        elif o == op.SUB:
            J[s, 0] = J[p, 0] - J[q, 0]
        elif o == op.LINEAR:
            # A branch that is off has no effect even if it is singular.
            factor = c[s] * J[d, 0]
            J[s, 0] = J[p, 0] + factor * J[q, 0] if factor != 0.0 else J[p, 0]
        elif o == op.SCALE:
            J[s, 0] = J[p, 0] * J[q, 0] if J[p, 0] != 0.0 else 0.0
        elif o == op.MUL:
            J[s, 0] = J[p, 0] * J[q, 0]
        elif o == op.DIV:
            J[s, 0] = J[p, 0] / J[q, 0] if J[q, 0] != 0.0 else np.nan
        elif o == op.NEG:
            J[s, 0] = -J[p, 0]
        elif o == op.CONST:
            J[s, 0] = c[s]
        elif o == op.SIN:
            J[s, 0] = math.sin(J[p, 0])
        elif o == op.PARTNER:
            J[s, 0] = math.cos(J[p, 0])
        elif o == op.EXP:
            J[s, 0] = math.exp(min(J[p, 0], 709.0))
        elif o == op.LOG:
            J[s, 0] = math.log(J[p, 0]) if J[p, 0] > 0.0 else np.nan
        elif o == op.POWER:
            J[s, 0] = J[p, 0] ** c[s]
        elif o == op.TANH:
            J[s, 0] = math.tanh(J[p, 0])
        elif o == op.SIGN and live:
            J[s, 0] = 1.0 if J[p, 0] > 0.0 else -1.0 if J[p, 0] < 0.0 else J[p, 0]


@inner
def at_once(program, J):
    """Compute all slots of a motion at order 0, on the branch of the signs in J."""
    _row_by_row(program.code, program.c, J, program.inputs, program.main, False)


@inner
def at_once_live(program, J, last):
    """Compute slots up to `last` at order 0; signs follow their surfaces."""
    _row_by_row(program.code, program.c, J, program.inputs, last, True)


@inner
def order(program, J, k):
    """Compute order k >= 1 of the slots that change, from the orders below it."""
    _order(program.code, program.c, program.rows, J, k)


@inner
def _order(code, c, rows, J, k):
    for s in rows:
        o, p, q, d = code[s, 0], code[s, 1], code[s, 2], code[s, 3]
        t = 0.0
        if o == op.ADD:
            t = J[p, k] + J[q, k]
        elif o == op.SUB:
            t = J[p, k] - J[q, k]
        elif o == op.LINEAR:
            factor = c[s] * J[d, 0]
            t = J[p, k] + factor * J[q, k] if factor != 0.0 else J[p, k]
        elif o == op.SCALE:
            t = J[p, 0] * J[q, k] if J[p, 0] != 0.0 else 0.0
        elif o == op.MUL:
            u, w = J[p], J[q]
            if p == q:
                for j in range((k + 1) // 2):
                    t += u[j] * u[np.uintp(k - j)]
                t *= 2.0
                if k % 2 == 0:
                    t += u[k // 2] * u[k // 2]
            else:
                for j in range(k + 1):
                    t += u[j] * w[np.uintp(k - j)]
        elif o == op.DIV:
            u, w = J[q], J[s]
            t = J[p, k]
            for j in range(1, k + 1):
                t -= u[j] * w[np.uintp(k - j)]
            t /= u[0]
        elif o == op.NEG:
            t = -J[p, k]
        elif o == op.SIN:
            for j in range(1, k + 1):
                t += j * J[p, j] * J[q, k - j]
            t /= k
        elif o == op.PARTNER:
            for j in range(1, k + 1):
                t -= j * J[p, j] * J[q, k - j]
            t /= k
        elif o == op.EXP:
            for j in range(1, k + 1):
                t += j * J[p, j] * J[s, k - j]
            t /= k
        elif o == op.LOG:
            for j in range(1, k):
                t += j * J[s, j] * J[p, k - j]
            t = (J[p, k] - t / k) / J[p, 0]
        elif o == op.POWER:
            for j in range(1, k + 1):
                t += (c[s] * j - (k - j)) * J[p, j] * J[s, k - j]
            t /= k * J[p, 0]
        elif o == op.TANH:
            for j in range(1, k + 1):
                t += j * J[p, j] * J[q, k - j]
            t /= k
        J[s, k] = t


@inner
def _derivatives(code, c, J, T, k, s):
    """Compute order k of the derivatives of a slot, from the series and the orders below it."""
    count = T.shape[2]
    o, p, q, r = code[s, 0], code[s, 1], code[s, 2], code[s, 3]
    here = T[s, k]
    if o <= op.LINEAR:
        way = -1.0 if o == op.SUB else 1.0
        factor = c[s] * J[r, 0] if o == op.LINEAR else way
        of_factor = c[s] * J[q, k] if o == op.LINEAR else 0.0
        for i in range(count):
            here[i] = T[p, k, i] + factor * T[q, k, i] + of_factor * T[r, 0, i]
        return
    if o in (op.SCALE, op.NEG):
        factor, of_factor = (J[p, 0], J[q, k]) if o == op.SCALE else (0.0, 0.0)
        for i in range(count):
            here[i] = T[p, 0, i] * of_factor + factor * T[q, k, i] if o == op.SCALE else -T[p, k, i]
        return
    for i in range(count):
        here[i] = 0.0
    if o in (op.CONST, op.SIGN):
        return
    if o == op.MUL:
        u, w, of_u, of_w = J[p], J[q], T[p], T[q]
        for m in range(k + 1):
            by_u, by_w = w[np.uintp(k - m)], u[np.uintp(k - m)]
            for i in range(count):
                here[i] += by_u * of_u[m, i] + by_w * of_w[m, i]
        return
    if o == op.DIV:
        u, w, of_u, of_w = J[q], J[s], T[q], T[s]
        for m in range(k):
            by_u, by_w = w[np.uintp(k - m)], u[np.uintp(k - m)]
            for i in range(count):
                here[i] -= by_u * of_u[m, i] + by_w * of_w[m, i]
        for i in range(count):
            here[i] = (here[i] + T[p, k, i] - w[0] * of_u[k, i]) / u[0]
        return
    for m in range(k + 1):
        # Factors of the derivatives of the operands, and of the slot itself, at order m.
        of_p, of_q, of_s, at_last = 0.0, 0.0, 0.0, m == k
        if o in (op.LOG, op.POWER):
            of_p = (1.0 if at_last else 0.0) if o == op.LOG else c[s] * J[s, k - m]
            of_s = 0.0 if at_last else -J[p, k - m]
        else:
            # d sin u = cos u du, d cos u = -sin u du, d exp u = exp u du, d tanh u = (1 - tanh^2 u) du
            of_p = J[s, k - m] if o == op.EXP else -J[q, k - m] if o == op.PARTNER else J[q, k - m]
        for i in range(count):
            here[i] += of_p * T[p, m, i] + of_q * T[q, m, i] + of_s * T[s, m, i]
    if o in (op.LOG, op.POWER):
        for i in range(count):
            here[i] /= J[p, 0]


@inner
def derivatives_at_once(program, J, T, last):
    """Compute derivatives of the slots up to `last` at order 0."""
    _at_order_0(program.code, program.c, J, T, program.inputs, last)


@inner
def _at_order_0(code, c, J, T, first, last):
    for s in range(first, last):
        _derivatives(code, c, J, T, np.int64(0), s)


@inner
def derivatives_of_order(program, J, T, k):
    """Compute order k >= 1 of the derivatives of the slots that change."""
    _of_order(program.code, program.c, program.rows, J, T, k)


@inner
def _of_order(code, c, rows, J, T, k):
    for s in rows:
        _derivatives(code, c, J, T, k, s)
