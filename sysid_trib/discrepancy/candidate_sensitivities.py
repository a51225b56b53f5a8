"""Candidates as trials: each force, at each value of its shape parameters, and how it moves the motion."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.averaging.internal_states import GivenMotion, is_linear_in_state, values_along
from sysid_trib.discrepancy.frequency_parameters import is_frequency, is_resonance
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import Force, ForceLibrary, Shape
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import FAST, trajectory
from sysid_trib.trajectory_fit.sensitivities import Tangent, responses

# Values of one shape parameter (fewer where each costs a motion of its own, which is slow); of several, so
# many combinations at most. Promising ones are looked at more finely.
VALUES = 13
FEWER = 7
COMBINATIONS = 24
# Frequencies of a resonance beside those of lines: it may be so broad that it makes none.
BROAD = 3
# A force of this strength leaves the motion as it is, and lets what it remembers be carried along.
TRACE = 1e-9
# Parts of a cell over which a force that switches is averaged.
PARTS = (np.arange(8) + 0.5) / 8.0 - 0.5


@dataclass(frozen=True)
class TrialCandidate:
    """A candidate with its shape parameters held (`{"dahl.s": 0.02}`)."""

    force: Force
    shapes: Mapping[str, float]


@dataclass(frozen=True)
class ReferenceMotion:
    """One run's motion: the model, its start (rad, rad/s), the record's times, and the small deviations."""

    model: Model
    start: tuple[float, float]
    time: Array
    about: Tangent


def trials_of(
    candidates: ForceLibrary, frequencies: Sequence[float] = (), w: float = 1.0
) -> list[TrialCandidate]:
    """Every candidate at a grid of its shape parameters.

    `frequencies` : rad/s, at which a force that is periodic in time is tried, and a resonance too; `w` : the
        model's, in units of which a resonance is.
    """
    found = []
    for force in candidates:
        grids = [_grid(force, name, frequencies, w) for name in force.shape]
        while np.prod([len(grid) for grid in grids], dtype=int) > max(
            COMBINATIONS, len(frequencies) * VALUES
        ):
            longest = int(np.argmax([len(grid) for grid in grids]))
            grids[longest] = grids[longest][::2]
        for values in itertools.product(*grids):
            shapes = {f"{force.symbol}.{k}": float(v) for k, v in zip(force.shape, values, strict=True)}
            found.append(TrialCandidate(force, shapes))
    return found


def _grid(force: Force, name: str, frequencies: Sequence[float], w: float) -> Array:
    shape = force.shape[name]
    if is_frequency(force, name):
        inside = [q for q in frequencies if shape.low <= q <= shape.high]
        return np.array(inside or [shape.default])
    if is_resonance(force, name):
        inside = [q / w for q in frequencies if shape.low <= q / w <= shape.high]
        return np.sort([*inside, *np.geomspace(shape.low, shape.high, BROAD)])
    count = VALUES if force.memoryless or is_linear_in_state(force) else FEWER
    if is_wide(shape):
        return np.geomspace(shape.low, shape.high, count)
    return np.linspace(shape.low, shape.high, count)


def is_wide(shape: Shape) -> bool:
    """Whether a shape parameter spans more than a decade, so that its logarithm is what is even."""
    return shape.low > 0.0 and shape.high > 10.0 * shape.low


@dataclass(frozen=True)
class Moved:
    """How trials move one run.

    Attributes
    ----------
    angle : (sample, trial) derivative of the measured angle by each coefficient, zero if there is a reason.
    strength : (trial,) RMS of the force (or sensor term) over that of the angle.
    reasons : why a trial cannot be computed on this motion, else empty.
    """

    angle: Array
    strength: Array
    reasons: list[str]


def moved_by(course: ReferenceMotion, trials: Sequence[TrialCandidate]) -> Moved:
    """How each trial, with a coefficient of 1, moves a run."""
    moved = np.zeros((len(course.time), len(trials)))
    forces = np.zeros((len(course.about.x), len(trials)))
    reasons = [""] * len(trials)
    known = _with_a_past(course, trials)
    for at, trial in enumerate(trials):
        try:
            values = known[at] if at in known else _along(course, trial)
        except SysidTribError as error:
            reasons[at] = str(error)
            continue
        if not np.all(np.isfinite(values)):
            reasons[at] = "its formula is not finite on this motion"
            continue
        forces[:, at] = values
        if trial.force.kind == "sensor":
            moved[:, at] = course.about.at_samples(values)
    dynamic = [at for at, trial in enumerate(trials) if trial.force.kind != "sensor"]
    if dynamic:
        moved[:, dynamic] = responses(course.about, forces[:, dynamic])
    # What overflows on the way is no response.
    wild = ~np.all(np.isfinite(moved), axis=0)
    moved[:, wild] = 0.0
    told = ("its response is not finite" if lost else "" for lost in wild)
    return Moved(
        moved,
        np.sqrt(np.mean(forces**2, axis=0) / np.mean(course.about.x**2)),
        [reason or other for reason, other in zip(reasons, told, strict=True)],
    )


def _with_a_past(course: ReferenceMotion, trials: Sequence[TrialCandidate]) -> dict[int, Array]:
    """Values along the motion of the forces with a past, all trials of a force at once where that can be."""
    found: dict[int, Array] = {}
    members: dict[str, list[int]] = {}
    for at, trial in enumerate(trials):
        if not trial.force.memoryless:
            members.setdefault(trial.force.symbol, []).append(at)
    if not members:
        return found
    about = course.about
    motion = GivenMotion(about.tau, about.x, about.v, about.time)
    for rows in members.values():
        values = values_along(motion, trials[rows[0]].force, [trials[at].shapes for at in rows])
        if values is not None:
            found |= dict(zip(rows, values.T, strict=True))
    return found


def _along(course: ReferenceMotion, trial: TrialCandidate) -> Array:
    """Values of a trial along the motion, (point,)."""
    about, force = course.about, trial.force
    if force.memoryless:
        if not force.surfaces or force.kind == "sensor":
            return force.value(about.x, about.v, about.time, shapes=trial.shapes)
        # A switching falls between points; x'' = -x is near enough for parts of a cell.
        step = about.tau[1] - about.tau[0]
        parts = [
            force.value(
                about.x + s * step * about.v, about.v - s * step * about.x, about.time, shapes=trial.shapes
            )
            for s in PARTS
        ]
        return np.asarray(np.mean(parts, axis=0))
    library = ForceLibrary("with a candidate", (*course.model.library.forces, force))
    model = replace(
        course.model,
        library=library,
        coefficients={**course.model.coefficients, force.symbol: TRACE},
        shapes={**course.model.shapes, **trial.shapes},
    )
    motion = trajectory(model, about.time + course.time[0], *course.start, engine=FAST)
    names = (*force.state, *force.memory)
    hidden = {name: motion.hidden[f"{force.symbol}.{name}"] for name in names}
    return force.value(about.x, about.v, about.time, shapes=trial.shapes, hidden=hidden)
