"""Indirect inference: what a simplified method gets wrong on the motion of its own model is taken off."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.decays.half_sines import envelope
from sysid_trib.errors import SysidTribError
from sysid_trib.regression.relations import Equations, Solution, solve
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.initial_conditions import first_guess, fit_start

Array = NDArray[np.float64]

MAX_CORRECTIONS = 20
# Of the standard errors by the noise alone, or of the values where there is next to no noise.
SETTLED, ROUNDING = 1e-2, 1e-9


@dataclass(frozen=True)
class Law:
    """What a method holds of a decay.

    Attributes
    ----------
    equations : groups of equations between half periods with unknowns of their own, `envelope`, `frequency`.
    values : from all unknowns, in the groups' order, to coefficients and, last, the frequency.
    model : of such values.
    """

    equations: Mapping[str, Equations]
    values: Callable[[Array], Array]
    model: Callable[[Array], Model]


@dataclass(frozen=True)
class Found:
    """Values of a law, what was taken off them, and how far the half periods are from it.

    `told` : `yes`, or `no` and why. `birge_ratios` : of each group of equations, RMS of the residual over its
    error, which scales the errors of the group's unknowns; `birge_ratio` : of all.
    """

    values: Array
    bias: Array
    covariance: Array
    noise: float
    birge_ratios: Mapping[str, float]
    birge_ratio: float
    told: str


def find(law: Law, decay: xr.Dataset, correct: bool) -> Found:
    """Solve a law on a decay's half-sines; `correct` removes its bias.

    The model found is simulated from the fitted start, its motion goes through half-sines and law as the
    record did, and what that got wrong is subtracted, until nothing moves (Gourieroux et al. 1993).
    """
    measured = envelope(decay)
    first = [solve(equations, measured) for equations in law.equations.values()]
    raw = law.values(np.concatenate([part.unknown for part in first]))
    values, told, gaps = raw, "no", [(part, part.residual) for part in first]
    if correct:
        try:
            values, gaps = _corrected(law, decay, measured, first)
            told = "yes"
        except (SysidTribError, np.linalg.LinAlgError) as error:
            told = f"no: {error}"
    squares = [part.chi_square(residual) for part, residual in gaps]
    freedom = [part.freedom for part, _ in gaps]
    birge_ratios = [float(np.sqrt(s / f)) for s, f in zip(squares, freedom, strict=True)]
    spread = _covariance(law, first, birge_ratios)
    named = dict(zip(law.equations, birge_ratios, strict=True))
    total = float(np.sqrt(sum(squares) / sum(freedom)))
    return Found(values, raw - values, spread, float(measured.noise), named, total, told)


def _covariance(law: Law, parts: list[Solution], birge_ratios: Sequence[float]) -> Array:
    """Of the values: groups share the errors of half periods, each is scaled by its own Birge ratio."""
    unknown = np.concatenate([part.unknown for part in parts])
    influence = np.concatenate(
        [part.influence * max(1.0, ratio) for part, ratio in zip(parts, birge_ratios, strict=True)]
    )
    steps = 1e-3 * np.linalg.norm(influence, axis=1) + 1e-300
    steps = np.clip(steps, 1e-7 * np.abs(unknown), None)
    slopes = [
        (law.values(unknown + s * unit) - law.values(unknown - s * unit)) / (2.0 * s)
        for s, unit in zip(steps, np.eye(len(unknown)), strict=True)
    ]
    moved = np.stack(slopes, axis=1) @ influence
    return np.asarray(moved @ moved.T)


def _corrected(
    law: Law, decay: xr.Dataset, measured: xr.Dataset, first: list[Solution]
) -> tuple[Array, list[tuple[Solution, Array]]]:
    """Values whose motion, seen in the same way, gives what the record gave; the residuals' gaps."""
    found = law.values(np.concatenate([part.unknown for part in first]))
    errors = np.sqrt(np.diag(_covariance(law, first, [1.0] * len(first))))
    small = SETTLED * errors + ROUNDING * np.abs(found)
    part = _first_swings(decay, float(found[-1]))
    start = first_guess(*part, float(found[-1]))
    values = found
    for _ in range(MAX_CORRECTIONS):
        simulated = _simulated(law.model(values), decay, part, start, measured)
        again = [solve(equations, simulated) for equations in law.equations.values()]
        step = found - law.values(np.concatenate([solution.unknown for solution in again]))
        values = values + step
        if np.all(np.abs(step) < small):
            # What half-sines and law leave of a motion that is the law's own is no departure from it.
            return values, [
                (new, old.residual[: len(new.residual)] - new.residual)
                for old, new in zip(first, again, strict=True)
            ]
    raise SysidTribError("the correction did not settle")


def _first_swings(decay: xr.Dataset, frequency: float) -> tuple[Array, Array]:
    """Two periods fix the start; a law that misses a force may slip out of phase later."""
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    count = int(np.searchsorted(time, time[0] + 4.0 * np.pi / frequency)) + 1
    return time[:count], angle[:count]


def _simulated(
    model: Model,
    decay: xr.Dataset,
    part: tuple[Array, Array],
    start: tuple[float, float],
    measured: xr.Dataset,
) -> xr.Dataset:
    """The half-sines of the model's motion, at the record's half periods and with its error bars."""
    time = decay.time.values.astype(float)
    motion = fit_start(model, *part, start, offset=None)
    moved = trajectory(model, time, motion.angle, motion.rate).angle
    seen = envelope(xr.Dataset({"angle": ("time", moved)}, {"time": time}))
    shift = int(np.argmin(np.abs(seen.extremum_time.values - measured.extremum_time.values[0])))
    count = min(measured.sizes["half_period"], seen.sizes["half_period"] - shift)
    names = ["extremum_standard_error", "extremum_time_standard_error"]
    bars = measured[names].isel(half_period=slice(0, count))
    return seen[["extremum", "extremum_time"]].isel(half_period=slice(shift, shift + count)).merge(bars)
