"""What numba compiles and where it is kept; what the compiled engine works on: a motion under way.

Few arrays, since each costs a compiled call half a dozen numbers.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

from sysid_trib.simulation.program import FORCING_NUMBERS, Instructions

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


ORDER = 18
# Marks of knots: what lies before it is written; what is given over time jumps there.
INTERVAL_ENDS, INPUT_JUMPS = -2, -3
# Rows of `v`: the state and what rounding has left of it; what is held between reversals, and the same before
# it was replaced; sides of the surfaces, and of which order one is known to be zero here; memory and sides of
# a motion that goes upwards or downwards from rest; tau and what rounding has left of it; room for surfaces
# and states, with the largest derivatives so far; how much the surface that holds it moves with v.
STATE, STATE_ROUNDING, MEMORY_NOW, MEMORY_BEFORE, SIGNS, ZEROS = range(6)
MEMORY_UP, SIGNS_UP, MEMORY_DOWN, SIGNS_DOWN = range(6, 10)
CLOCK, VALUES, SIGNS_FAR, SIGNS_AHEAD, STATE_LATER, LARGEST_DERIVATIVES, STATE_AT_REST, GRIP = range(10, 18)
# Tables of `aside`: slots at an instant that is tried; series at rest, were it to go upwards or downwards.
TRIAL, UP, DOWN = range(3)


# What a motion is held by, besides the number of a surface of which v is a part: nothing, rest.
FREE, RESTS = -1, 0
# Nearer than this to a surface, its sign is decided by where the motion is so much later (in tau).
NEAR_SURFACE, LOOKAHEAD = 1e-9, 1e-5
# In tau: as far as a motion is followed at once.
FURTHEST_AT_ONCE = 16.0
# What is left of a series after a step, of a state and of a surface or a derivative.
STATE_PART, SURFACE_PART = 1e-16, 1e-13


@inner
def put(source: Any, target: Any) -> None:
    """Copy a list of numbers."""
    for i in range(len(source)):
        target[i] = source[i]


class EngineState(NamedTuple):
    """A motion under way; its arrays are changed in place.

    Attributes
    ----------
    J, T : (slot, order) and (slot, order, parameter) array of float
        Series of the slots, and their derivatives.
    aside : (table, slot, order) array of float
    v : (row, number) array of float
    dy : (state, parameter) array of float
        Derivatives of the state.
    drive : (channel, PUSH_NUMBERS + 2) array of float
        What is given over time: by powers of tau since the clock, then its value and slope at the instant
        that is looked at.
    of_drive : (channel, parameter) array of float
        Its derivatives over itself.
    work : (5, 64) array of float
        Room for roots.
    """

    J: Any
    T: Any
    aside: Any
    v: Any
    dy: Any
    drive: Any
    of_drive: Any
    work: Any


class Given(NamedTuple):
    """What a motion is to follow, and where it is written.

    Attributes
    ----------
    grid : (grid,) array of float
        tau, increasing; the motion starts at the first.
    knots, drives, increments : (knot,), (knot, channel, degree + 1) and (knot, 2) array of float
        From each knot on, polynomials in tau since it; what is added to x and v there.
    impulses : (knot, parameter) array of float
        What is added there to the derivatives of v.
    marks : (knot,) array of int
        The start that is taken there, `INTERVAL_ENDS` or `INPUT_JUMPS`; -1 elsewhere.
    starts : (interval, state + memory) array of float
        Where intervals begin that are followed one after the other; none for one motion on the grid.
    rows : (grid, state + 1 + memory) array of float
        The states, the acceleration (of one motion), the memory; at the ends of intervals.
    tangents : (grid, state + 1 + memory, parameter) array of float
        Their derivatives.
    """

    grid: Any
    knots: Any
    drives: Any
    increments: Any
    impulses: Any
    marks: Any
    starts: Any
    rows: Any
    tangents: Any


def new_state(program: Instructions, parameters: int) -> EngineState:
    """Room for motions of a program, with so many derivatives."""
    slots, size = len(program.code), program.states
    width = max(size, program.memory, len(program.signs), parameters, 2)
    return EngineState(
        np.zeros((slots, ORDER + 1)),
        np.zeros((slots, ORDER + 1, parameters)),
        np.zeros((3, slots, ORDER + 1)),
        np.zeros((GRIP + 1, width)),
        np.zeros((size, parameters)),
        np.zeros((program.channels, FORCING_NUMBERS + 2)),
        np.zeros((program.channels, parameters)),
        np.zeros((5, 64)),
    )
