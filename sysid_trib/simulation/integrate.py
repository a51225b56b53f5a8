"""A model's motion by the compiled engine: what it is given, what comes back, and what its failures mean."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from sysid_trib.errors import SimulationError
from sysid_trib.records.inputs import FORCING_CHANNEL
from sysid_trib.simulation.compiled import (
    CLOCK,
    INPUT_JUMPS,
    MEMORY_NOW,
    STATE,
    EngineState,
    Given,
    new_state,
)
from sysid_trib.simulation.model import Model, Motion, Vector, program_of
from sysid_trib.simulation.motions import (
    BY_ANGLE,
    BY_RATE,
    FREQUENCY,
    UNFORCED,
    Forcing,
    SimulatedMotion,
    jumps_of,
)
from sysid_trib.simulation.program import Instructions

# Steps a period that a motion may take: of a stiff state thousands, for which a fit does not wait.
STEPS_A_PERIOD, FEW_STEPS_A_PERIOD = 20_000, 500
# Bytes of address space that the engine takes when it is loaded.
ENGINE_ROOM = 300_000_000
DIVERGED = 1e3  # rad; no pendulum swings there


def integrate(
    model: Model,
    tau: Vector,
    at: tuple[float, float],
    *,
    by: Sequence[str] = (),
    forcing: Forcing = UNFORCED,
    most_steps: int = STEPS_A_PERIOD,
) -> SimulatedMotion:
    """Integrate the motion of a model along a grid.

    Parameters
    ----------
    model : Model
    tau : (sample,) array of float
        w t, increasing; the start is its first.
    at : (float, float), rad
        x and v there.
    by : sequence of str
        Parameters of the derivatives: symbols, `dahl.s`, `FREQUENCY`, `BY_ANGLE`, `BY_RATE`.
    forcing : Forcing
    most_steps : int
        A period.

    Raises
    ------
    SimulationError
        It diverges, switches without end, takes too many steps, or is not finite.
    """
    motion, program = program_of(model.forces, forced=forcing.forced, paced=FREQUENCY in by)
    state = begun((motion, program), model, at, by)
    state.v[CLOCK, 0] = tau[0]
    size, knots = program.states, forcing.knots
    columns = size + 1 + program.memory
    given = Given(
        tau,
        knots,
        forcing.polynomials,
        forcing.increments,
        np.zeros((len(knots), len(by))),
        np.where(jumps_of(forcing), INPUT_JUMPS, -1),
        np.empty((0, 0)),
        np.empty((len(tau), columns)),
        np.empty((len(tau), columns, len(by))),
    )
    periods, many = float(tau[-1] - tau[0]) / (2.0 * np.pi), len(knots)
    switchings = 1000 + many + int(periods * (50 + 10 * len(motion.switches)))
    limits = (DIVERGED, switchings, 5000 + many + int(most_steps * periods))
    reversals, turns, stop = run(program, given, state, limits, model.reference_frequency)
    names = (*motion.variables[2:], "", *motion.memory)
    hidden = dict(zip(names, given.rows.T[2:], strict=True))
    bend, y, stop = hidden.pop(""), given.rows[:, :size], np.nan if forcing.acts else stop
    return SimulatedMotion(
        model, tau, y, bend, hidden, stop, reversals[:turns].copy(), tuple(by), given.tangents
    )


def begun(
    equations: tuple[Motion, Instructions],
    model: Model,
    at: tuple[float, float],
    by: Sequence[str],
    *,
    places: tuple[int, int] | None = None,
) -> EngineState:
    """Where the engine begins: the start of a motion, its parameters and their derivatives.

    `places` are the first column of the derivatives by `by` and the number of all columns, where there are
    more.
    """
    motion, program = equations
    first, count = places or (0, len(by))
    state = new_state(program, count)
    y, p = motion.start(model, *at)
    dy, dp = _seeds(motion, model, at, by)
    columns = slice(first, first + len(by))
    slots = slice(program.states + 1 + program.channels, program.inputs)
    state.v[STATE, : len(y)], state.dy[:, columns] = y, dy
    state.v[MEMORY_NOW, : program.memory] = p[motion.memory_at]
    state.J[slots, 0] = state.aside[:, slots, 0] = np.append(1.0, p)
    state.T[slots, 0, columns] = dp
    # What is seen over w^p is less by p/w of itself where w is larger.
    forcing = (FORCING_CHANNEL,) * (program.channels - len(motion.channels))
    powers = np.array([channel.power for channel in (*forcing, *motion.channels)])
    of_frequency = np.array([name == FREQUENCY for name in by])
    state.of_drive[:, columns] = np.outer(-powers / model.reference_frequency, of_frequency)
    return state


def run(
    program: Instructions, given: Given, state: EngineState, limits: tuple[float, int, int], frequency: float
) -> tuple[Vector, int, float]:
    """Follow a motion, or intervals, by the compiled engine.

    Returns where the sign of v changes, how often, and where it comes to rest, in tau.

    Raises
    ------
    SimulationError
        It diverges, switches without end, takes too many steps, or is not finite.
    """
    compiled, ended = _engine()
    # One kind of array, for which it is compiled once.
    given = given._replace(
        **{name: np.require(part, part.dtype, ["C", "W"]) for name, part in given._asdict().items()}
    )
    reversals, turns, rest, outcome = compiled(program, given, state, limits)
    if outcome != ended:
        _raise(outcome, state.v[CLOCK, 0] / frequency)
    return reversals, turns, rest


@cache
def _engine() -> tuple[Callable[..., Any], int]:
    """The compiled function, whose import takes its time, and the outcome of a motion without failure."""
    # The compiler ends the process where memory does; what is not there is missed here instead.
    np.empty(ENGINE_ROOM, np.uint8)
    from sysid_trib.simulation.compiled import tell_of_compiling
    from sysid_trib.simulation.engine import ENDED, run

    tell_of_compiling()
    return run, ENDED


def _seeds(motion: Motion, model: Model, at: tuple[float, float], by: Sequence[str]) -> tuple[Vector, Vector]:
    """Derivatives of the start, (state, parameter), and of the program's parameters."""
    w, names = model.reference_frequency, [f.symbol for f in motion.forces]
    places = {name: 1 + i for i, name in enumerate((*names, *motion.shapes))}
    dy, dp = np.zeros((len(motion.variables), len(by))), np.zeros((1 + motion.memory_at.stop, len(by)))
    for column, name in enumerate(by):
        if name == BY_ANGLE:
            dy[0, column] = 1.0
        elif name == BY_RATE:
            dy[1, column] = 1.0 / w
        elif name == FREQUENCY:
            # v = rate/w at the start; then all goes faster.
            dy[1, column], dp[0, column] = -at[1] / w, 1.0 / w
        elif name in places:
            dp[places[name], column] = 1.0
    motion.start_derivatives(model, at, dy, dp[1:])
    return dy, dp


def _raise(outcome: int, elapsed: float) -> None:
    from sysid_trib.simulation import engine

    after = f"{elapsed:.4g} s after the start"
    if outcome == engine.GROWS:
        raise SimulationError(
            f"The motion diverges: |angle| passes {DIVERGED:g} rad by {after}; "
            "mind negative damping and negative stiffness in the coefficients, a far start, and a strong "
            "random force."
        )
    reason = {engine.SWITCHES: "switches without end", engine.STEPS: "needs too many steps"}
    raise SimulationError(
        f"The motion {reason.get(outcome, 'is not finite')}, {after}; mind forces that switch or are "
        "singular there."
    )
