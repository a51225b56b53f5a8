"""Trajectory fit: maximum likelihood of the angle itself, with exact switching and sticking."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sysid_trib.coloured_noise import autoregression, whitened
from sysid_trib.errors import DecayError, SimulationError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.unknowns import unknown_forces
from sysid_trib.model import Model
from sysid_trib.results import Estimate, identification, model_of
from sysid_trib.simulation import trajectory
from sysid_trib.start import first_guess

Array = NDArray[np.float64]

# Parts of the record to which the fit is extended in turn, so that a phase slip cannot trap it.
WINDOWS = (0.06, 0.12, 0.22, 0.4, 0.65)
# A start whose motion is this near to the record (RMS, of the record's) needs no growing window.
NEAR = 0.1
MAX_EVALUATIONS = 60
# What a motion that cannot be computed leaves, in swings: far, but finite for the optimiser.
FAR = 10.0
# Sensitivities are forward differences over a step that moves the phase by about this much (rad).
REACH = 1e-6


@dataclass(frozen=True)
class Trajectory:
    """Least squares of the measured angle on the motion of the model: maximum likelihood in white noise.

    Parameters
    ----------
    reference_frequency : w in rad/s, held; the library's force of formula `x` is then an unknown.
        Without it w is fitted and that force is absent.
    noise : `white`, or `coloured`: residuals and sensitivities are whitened by an autoregression whose order
        is chosen by the Bayesian information criterion.
    fit_shapes : shape parameters to fit (`("dahl.s",)`), between the library's limits; the others are held.
    bounds : `{"lambda": (0, inf)}` for coefficients and shapes.
    start : model from which the fit starts; None is the direct identification.
    shapes : values of shape parameters, held or first guesses.

    Notes
    -----
    The window grows over the record unless the start already follows it; sensitivities are differences of
    exact motions, so that switching times and the stop take part.
    """

    reference_frequency: float | None = None
    noise: Literal["white", "coloured"] = "white"
    fit_shapes: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    start: Model | None = None
    shapes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.noise not in ("white", "coloured"):
            raise UsageError(f"noise='{self.noise}' is neither 'white' nor 'coloured'.")

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            No motion of the model can be fitted to the decay.
        """
        asked = unknown_forces(library, self.reference_frequency)
        _check_names(self, asked)
        time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
        problem = _Problem(self, asked, time, angle)
        unknown = _grown(problem, _beginning(problem, decay, library))
        unknown, filter_ = _fitted(problem, unknown), np.ones(1)
        for _ in range(3 if self.noise == "coloured" else 0):
            filter_ = autoregression(problem.residual(unknown))
            unknown = _fitted(problem, unknown, filter_)
        return _labelled(problem, decay, library, unknown, filter_)


def _check_names(method: Trajectory, library: ForceLibrary) -> None:
    shapes = {f"{force.symbol}.{name}" for force in library for name in force.shape}
    for name in (*method.fit_shapes, *method.bounds):
        if name not in shapes and (name in method.fit_shapes or name not in library.symbols):
            raise UsageError(f"There is no force or shape parameter '{name}' among the unknowns.")


@dataclass(frozen=True)
class _Problem:
    """One record, its unknowns in one vector: coefficients, shapes, w if free, angle, rate, offset."""

    method: Trajectory
    library: ForceLibrary
    time: Array
    angle: Array

    @property
    def free(self) -> bool:
        return self.method.reference_frequency is None

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.library.symbols, *self.method.fit_shapes)

    def model(self, unknown: Array) -> Model:
        count, named = len(self.library), len(self.names)
        coefficients = dict(zip(self.library.symbols, unknown[:count].tolist(), strict=True))
        shapes = dict(zip(self.method.fit_shapes, unknown[count:named].tolist(), strict=True))
        frequency = float(unknown[-4]) if self.free else float(self.method.reference_frequency or 0.0)
        return Model(self.library, coefficients, frequency, dict(self.method.shapes) | shapes)

    def first(self, part: float) -> "_Problem":
        """The problem of the first part of the record."""
        count = max(20, round(part * len(self.time)))
        return replace(self, time=self.time[:count], angle=self.angle[:count])

    def residual(self, unknown: Array) -> Array:
        """Motion minus record (rad); far off where the motion cannot be computed."""
        try:
            found = trajectory(self.model(unknown), self.time, float(unknown[-3]), float(unknown[-2]))
        except SimulationError:
            return np.full(len(self.time), FAR * float(np.max(np.abs(self.angle))))
        return np.asarray(found.angle + unknown[-1] - self.angle)

    def sensitivity(self, unknown: Array) -> Array:
        """Derivative of the residual by each unknown, (sample, unknown)."""
        here = self.residual(unknown)
        steps = self._steps(unknown)
        columns = [
            (self.residual(unknown + s * unit) - here) / s
            for s, unit in zip(steps, np.eye(len(steps)), strict=True)
        ]
        columns[-1] = np.ones_like(here)
        return np.stack(columns, axis=1)

    def _steps(self, unknown: Array) -> Array:
        """Steps that move the motion by about `REACH` swings at the end of the record."""
        size = float(np.max(np.abs(self.angle)))
        frequency = self.model(unknown).reference_frequency
        phase = frequency * (self.time[-1] - self.time[0]) + 1.0
        x = size * np.cos(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
        v = size * np.sin(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
        hidden = 0.5 * size
        steps = []
        for force in self.library:
            names = dict.fromkeys((*force.state, *force.memory), hidden)
            scale = np.sqrt(np.mean(force.value(x, v, shapes=self.method.shapes, hidden=names) ** 2))
            steps.append(REACH * size / (phase * max(float(scale), 1e-9)))
        count = len(self.library)
        steps += [1e-5 * abs(value) for value in unknown[count : len(self.names)]]
        steps += [REACH * frequency / phase] if self.free else []
        return np.array([*steps, REACH * size, REACH * size * frequency, REACH * size])


def _beginning(problem: _Problem, decay: xr.Dataset, library: ForceLibrary) -> Array:
    """First guess of all unknowns: from the start model, or from direct identification."""
    method = problem.method
    start, offset = method.start, 0.0
    if start is None:
        quick = Direct(reference_frequency=method.reference_frequency, shapes=method.shapes)
        found = quick.identify(decay, library)
        start, offset = model_of(found), found.offset.item()
        at = (found.start_angle.item(), found.start_rate.item())
    else:
        at = first_guess(problem.time, problem.angle, start.reference_frequency)
    coefficients = [start.coefficients.get(symbol, 0.0) for symbol in problem.library.symbols]
    defaults = {f"{f.symbol}.{k}": v for f in library for k, v in f.shape_values(method.shapes).items()}
    shapes = [start.shapes.get(name, defaults[name]) for name in method.fit_shapes]
    frequency = [start.reference_frequency] if problem.free else []
    return np.array([*coefficients, *shapes, *frequency, *at, offset])


def _grown(problem: _Problem, unknown: Array) -> Array:
    """Extend the fit over the record window by window, unless the start follows it already."""
    gap = np.sqrt(np.mean(problem.residual(unknown) ** 2))
    if gap < NEAR * np.sqrt(np.mean(problem.angle**2)):
        return unknown
    for part in WINDOWS:
        unknown = _fitted(problem.first(part), unknown)
    return unknown


def _fitted(problem: _Problem, unknown: Array, filter_: Array | None = None) -> Array:
    """Least squares from a first guess, on residuals whitened by a filter."""
    white = np.ones(1) if filter_ is None else filter_
    low, high = _limits(problem, len(unknown))
    bounded = bool(np.any(np.isfinite(low)) or np.any(np.isfinite(high)))
    inside = np.clip(unknown, np.nextafter(low, np.inf), np.nextafter(high, -np.inf))
    found = least_squares(
        lambda p: whitened(problem.residual(p), white),
        inside,
        jac=lambda p: whitened(problem.sensitivity(p), white),
        bounds=(low, high) if bounded else (-np.inf, np.inf),
        method="trf" if bounded else "lm",
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-14,
        max_nfev=MAX_EVALUATIONS,
    )
    return np.asarray(found.x, dtype=float)


def _limits(problem: _Problem, count: int) -> tuple[Array, Array]:
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    given: dict[str, Any] = dict(problem.method.bounds)
    for force in problem.library:
        given |= {
            f"{force.symbol}.{k}": given.get(f"{force.symbol}.{k}", (s.low, s.high))
            for k, s in force.shape.items()
        }
    for at, name in enumerate(problem.names):
        if name in given:
            low[at], high[at] = given[name]
    return low, high


def _labelled(
    problem: _Problem, decay: xr.Dataset, library: ForceLibrary, unknown: Array, filter_: Array
) -> xr.Dataset:
    residual = problem.residual(unknown)
    table = whitened(problem.sensitivity(unknown), filter_)
    white = whitened(residual, filter_)
    if not np.all(np.isfinite(table)) or np.max(np.abs(residual)) > np.max(np.abs(problem.angle)):
        raise DecayError(
            "No motion of these forces follows the record; offer other forces or a shorter window."
        )
    noise = float(np.sqrt(white @ white / max(1, len(white) - len(unknown))))
    size = np.linalg.norm(table, axis=0)
    spread = noise**2 * np.linalg.pinv((table / size).T @ (table / size)) / np.outer(size, size)
    count, named = len(problem.library), len(problem.names)
    keep = [*range(count), *([named] if problem.free else [])]
    covariance = np.zeros((count + 1, count + 1))
    covariance[np.ix_(range(len(keep)), range(len(keep)))] = spread[np.ix_(keep, keep)]
    extra = {
        "start_angle": (unknown[-3], "rad", "angle of the model at the first sample"),
        "start_rate": (unknown[-2], "rad/s", "rate of the model at the first sample"),
        "offset": (unknown[-1], "rad", "zero of the sensor about the decay's equilibrium"),
        "noise_of_sample": (float(np.std(residual)), "rad", "standard deviation of the residual"),
    }
    model = problem.model(unknown)
    estimate = Estimate(unknown[:count], covariance, model.reference_frequency, noise, extra)
    method = replace(problem.method, shapes=model.shapes)
    result = identification(method, decay, problem.library, estimate, offered=library)
    if "shape" in result:
        errors = dict(zip(problem.method.fit_shapes, np.sqrt(np.diag(spread))[count:named], strict=True))
        values = [errors.get(name, np.nan) for name in result.shape_parameter.values.tolist()]
        result["shape_standard_error"] = result.shape_standard_error.copy(data=values)
    return result.assign_attrs(noise_model=f"autoregression of order {len(filter_) - 1}")
