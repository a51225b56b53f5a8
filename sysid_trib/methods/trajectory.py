"""Trajectory fit: maximum likelihood of the angle itself, with exact switching and sticking."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.to_identify import forces_to_identify
from sysid_trib.methods.direct import Direct
from sysid_trib.noise.autoregression import autoregression, whitened
from sysid_trib.records.runs import Decays, as_runs, root_mean_square, run_noise, start_variables
from sysid_trib.results.schema import Estimate, identification, model_of
from sysid_trib.simulation.model import Model
from sysid_trib.trajectory_fit.initial_conditions import first_guess
from sysid_trib.trajectory_fit.least_squares import fitted, grown, rms
from sysid_trib.trajectory_fit.problem import Problem, Record

Array = NDArray[np.float64]

# Rounds in which noise and fit of several runs, or of coloured noise, follow each other.
ROUNDS = 3


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
    The window grows over the records unless the start already follows them; sensitivities are differences of
    exact motions, so that switching times and the stop take part. Of several runs each counts by its own
    noise, which is what it leaves.
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

    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several runs.

        Raises
        ------
        DecayError
            No motion of the model can be fitted to the decay.
        """
        asked = forces_to_identify(library, self.reference_frequency)
        _check_names(self, asked)
        decays = as_runs(decay)
        records = [(d.time.values.astype(float), d.angle.values.astype(float)) for d in decays]
        problem = Problem(
            asked,
            tuple(Record(time, angle) for time, angle in records),
            self.reference_frequency,
            self.fit_shapes,
            self.shapes,
            self.bounds,
        )
        unknown = fitted(problem, grown(problem, _beginning(self, problem, decays, library)))
        for _ in range(ROUNDS if self.noise == "coloured" or len(decays) > 1 else 0):
            problem = _weighted(problem, unknown, coloured=self.noise == "coloured")
            unknown = fitted(problem, unknown)
        return _labelled(self, problem, decays, library, unknown)


def _check_names(method: Trajectory, library: ForceLibrary) -> None:
    shapes = {f"{force.symbol}.{name}" for force in library for name in force.shape}
    for name in (*method.fit_shapes, *method.bounds):
        if name not in shapes and (name in method.fit_shapes or name not in library.symbols):
            raise UsageError(f"There is no force or shape parameter '{name}' among the unknowns.")


def _beginning(
    method: Trajectory, problem: Problem, decays: Sequence[xr.Dataset], library: ForceLibrary
) -> Array:
    """First guess of all unknowns: from the start model, or from direct identification."""
    start = method.start
    if start is None:
        quick = Direct(reference_frequency=method.reference_frequency, shapes=method.shapes)
        found = quick.identify(decays, library)
        start = model_of(found)
        own = np.stack([np.ravel(found[k]) for k in ("start_angle", "start_rate", "offset")], axis=1)
    else:
        frequency = start.reference_frequency
        own = np.array([(*first_guess(r.time, r.angle, frequency), 0.0) for r in problem.records])
    coefficients = [start.coefficients.get(symbol, 0.0) for symbol in problem.library.symbols]
    defaults = {f"{f.symbol}.{k}": v for f in library for k, v in f.shape_values(method.shapes).items()}
    shapes = [start.shapes.get(name, defaults[name]) for name in method.fit_shapes]
    frequencies = [start.reference_frequency] if problem.free else []
    return np.array([*coefficients, *shapes, *frequencies, *own.ravel()])


def _weighted(problem: Problem, unknown: Array, *, coloured: bool) -> Problem:
    """Each run with the weight of the noise that it leaves, and with the colour of it where asked for."""
    records = []
    for record, left in zip(problem.records, problem.residuals(unknown), strict=True):
        filter_ = autoregression(left) if coloured else np.ones(1)
        records.append(replace(record, filter_=filter_, weight=1.0 / rms(whitened(left, filter_))))
    # Relative to their RMS noise, so that what is left is an angle.
    common = root_mean_square([1.0 / record.weight for record in records])
    return replace(problem, records=tuple(replace(r, weight=common * r.weight) for r in records))


def _labelled(
    method: Trajectory, problem: Problem, decays: Sequence[xr.Dataset], library: ForceLibrary, unknown: Array
) -> xr.Dataset:
    residuals = problem.residuals(unknown)
    table, white = problem.white_sensitivity(unknown, residuals), problem.white(residuals)
    lost = any(
        np.max(np.abs(left)) > np.max(np.abs(record.angle))
        for left, record in zip(residuals, problem.records, strict=True)
    )
    if lost or not np.all(np.isfinite(table)):
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
    own = problem.own(unknown)
    spreads = [float(np.std(left)) for left in residuals]
    extra = {
        **start_variables([(angle, rate) for angle, rate, _ in own], own[:, 2]),
        **run_noise([noise / record.weight for record in problem.records]),
        "noise_of_sample": (spreads, "rad", "standard deviation of the residual"),
    }
    model = problem.model(unknown)
    estimate = Estimate(unknown[:count], covariance, model.reference_frequency, noise, extra)
    labelled = replace(method, shapes=model.shapes)
    result = identification(labelled, decays, problem.library, estimate, offered=library)
    if "shape" in result:
        errors = dict(zip(method.fit_shapes, np.sqrt(np.diag(spread))[count:named], strict=True))
        values = [errors.get(name, np.nan) for name in result.shape_parameter.values.tolist()]
        result["shape_standard_error"] = result.shape_standard_error.copy(data=values)
    orders = ", ".join(str(len(record.filter_) - 1) for record in problem.records)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}")
