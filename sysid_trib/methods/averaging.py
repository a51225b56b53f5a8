"""The paper's identification: amplitude decay and frequency shift against the signatures of the forces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy.sparse as sp
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib.decays.half_sines import envelope
from sysid_trib.errors import DecayError, SysidTribError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.to_identify import forces_to_identify
from sysid_trib.records.runs import Decays, as_runs, root_mean_square, run_noise
from sysid_trib.regression.averaged import averaged_equations, noise_of_equations
from sysid_trib.regression.weak_form import whiten, whitener
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.initial_conditions import first_guess, fit_start

Array = NDArray[np.float64]

MAX_CORRECTIONS = 20


@dataclass(frozen=True)
class Averaging:
    """Least squares of da/dt and w(a) on the forces' signatures (Le Bot et al. 2019, Sec. 2.3).

    Parameters
    ----------
    frequency : `fit` has the asymptotic frequency as one more unknown; `last` is the paper's rule, the last
        half periods' frequency, with its plain least squares.
    correct : whether the first-order bias is removed: the identified model is simulated, its motion goes
        through the same averaging, and what that got wrong is subtracted, until nothing moves.
    reference_frequency : w in rad/s, held; the library's force of formula `x` is then an unknown.
    weighted : generalised least squares with the covariance of the half-sine fits (never with `last`).
    shapes : values of shape parameters, which are held.
    curve : what gives the extrema, `half-sines` or the `analytic-signal` (see `envelope`).

    Notes
    -----
    With the columns L = <h sin phi> and M = <h cos phi>/a, unknowns w and w c: da/dt = L (w c) and
    w(a) = w + M (w c). A force with both signatures has one unknown in both.
    """

    frequency: Literal["fit", "last"] = "fit"
    correct: bool = True
    reference_frequency: float | None = None
    weighted: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)
    curve: Literal["half-sines", "analytic-signal"] = "half-sines"

    def __post_init__(self) -> None:
        if self.frequency not in ("fit", "last"):
            raise UsageError(f"frequency='{self.frequency}' is neither 'fit' nor 'last'.")

    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several runs.

        Raises
        ------
        DecayError
            The decay cannot support the request: too short, or forces of the same signature.
        UsageError
            The paper's rule for several runs: each has its own last frequency.
        """
        asked = forces_to_identify(library, self.reference_frequency)
        runs = [_Run(run, _measured(self, run)) for run in as_runs(decay)]
        if self.frequency == "last" and len(runs) > 1:
            raise UsageError("frequency='last' is a rule for one record; take 'fit' for several runs.")
        found = _first_order(self, [run.measured for run in runs], asked)
        values, corrected, birge_ratio = found.values, "no", found.birge_ratio
        if self.correct:
            values, corrected, birge_ratio = _corrected(self, runs, asked, found)
        noises = [float(run.measured.noise) for run in runs]
        extra: dict[str, tuple[ArrayLike, str, str]] = {
            "birge_ratio": (birge_ratio, "1", "Birge ratio of the averaged equations"),
            **run_noise(noises),
        }
        spread = found.covariance * max(1.0, birge_ratio) ** 2
        noise = root_mean_square(noises)
        estimate = Estimate(values[:-1], spread, float(values[-1]), noise, extra)
        result = identification(self, decay, asked, estimate, offered=library)
        bias = found.values - values
        result["first_order_bias"] = (
            "force",
            bias[:-1],
            {"units": "1", "long_name": "first-order bias removed"},
        )
        return result.assign_attrs(first_order_bias_removed=corrected)


@dataclass(frozen=True)
class _Run:
    """One decay and its envelope."""

    decay: xr.Dataset
    measured: xr.Dataset


@dataclass(frozen=True)
class _Averaged:
    """First-order estimate of (coefficients, reference frequency): values, their covariance by the noise.

    `residuals` : (equation,) of each run, what is left, of unit variance if it is noise; `freedom` : their
    degrees.
    """

    values: Array
    covariance: Array
    residuals: list[Array]
    freedom: int

    @property
    def birge_ratio(self) -> float:
        """RMS of the residual."""
        return _birge_ratio(self.residuals, self.freedom)


def _birge_ratio(residuals: Sequence[Array], freedom: int) -> float:
    return float(np.sqrt(sum(float(r @ r) for r in residuals) / freedom))


def _first_order(method: Averaging, runs: Sequence[xr.Dataset], library: ForceLibrary) -> _Averaged:
    """The paper's least squares on the half periods of all runs' envelopes."""
    equations = [averaged_equations(measured, library, method.shapes) for measured in runs]
    design, target = (np.concatenate(part) for part in zip(*equations, strict=True))
    last = method.frequency == "last" and method.reference_frequency is None
    fixed = float(runs[0].frequency.values[-1]) if last else method.reference_frequency
    if fixed is not None:
        design, target = design[:, :-1], target - fixed * design[:, -1]
    _check_rank(design, library.symbols, len(target) // 2)
    plain: Array = np.asarray(np.linalg.lstsq(design, target, rcond=None)[0], dtype=float)
    noise = sp.block_diag(
        [noise_of_equations(measured, library, method.shapes, plain[: len(library)]) for measured in runs],
        format="csr",
    )
    factor = whitener(noise)
    rows, y = whiten(factor, design), whiten(factor, target)
    if method.weighted and not last:
        unknown: Array = np.asarray(np.linalg.lstsq(rows, y, rcond=None)[0], dtype=float)
        spread: Array = np.asarray(np.linalg.inv(rows.T @ rows), dtype=float)
    else:
        unknown, inverse = plain, np.linalg.pinv(design)
        reached = inverse @ noise
        if last:
            # The error of the last frequency is in every shift that is taken from it.
            reached = reached - np.outer(inverse[:, 1::2].sum(axis=1), noise[[-1]].toarray())
        spread = np.asarray(reached @ reached.T, dtype=float)
    residual, freedom = y - rows @ unknown, max(1, len(y) - len(unknown))
    if fixed is not None:
        unknown = np.append(unknown, fixed)
        spread = np.pad(spread, (0, 1))
        if last:
            spread[-1, -1] = runs[0].frequency_standard_error.values[-1] ** 2
    values, spread = _to_coefficients(library, unknown, spread, given=method.reference_frequency is not None)
    ends = np.cumsum([len(part) for _, part in equations])[:-1]
    return _Averaged(values, spread, np.split(residual, ends), freedom)


def _check_rank(design: Array, symbols: tuple[str, ...], instants: int) -> None:
    """Refuse what the averaged equations cannot decide, by name."""
    if len(design) < design.shape[1] + 2:
        raise DecayError(
            f"{instants} amplitudes cannot decide {len(symbols)} forces; give a longer record or fewer."
        )
    size = np.linalg.norm(design, axis=0)
    silent = [s for s, n in zip(symbols, size, strict=False) if n < 1e-12 * size.max()]
    if silent:
        raise DecayError(
            f"Force {silent[0]} has no signature in envelope or frequency: averaging cannot see it; "
            "leave it out (--forces) or use the direct method alone."
        )
    _, singular, axes = np.linalg.svd(design / size, full_matrices=False)
    if singular[-1] < 1e-8 * singular[0]:
        tied = [s for s, part in zip((*symbols, "the frequency"), axes[-1], strict=False) if abs(part) > 1e-3]
        raise DecayError(
            f"Averaging cannot tell apart {' and '.join(tied)}: their signatures are the same; leave one out."
        )


def _to_coefficients(
    library: ForceLibrary, unknown: Array, spread: Array, *, given: bool
) -> tuple[Array, Array]:
    """From (w c, w_inf) to (c, w); the averaged frequency at zero amplitude is w_inf, not w."""
    frequency = unknown[-1]
    jacobian = np.eye(len(unknown))
    if not given:
        for formula, factor in (("2*v", 1.0), ("v", 0.5)):
            if force := library.role(formula):
                at = library.symbols.index(force.symbol)
                damping = factor * unknown[at]
                frequency = float(np.hypot(frequency, damping))
                jacobian[-1, at] = factor * damping / frequency
                jacobian[-1, -1] = unknown[-1] / frequency
    coefficients = unknown[:-1] / frequency
    jacobian[:-1, :] -= np.outer(coefficients, jacobian[-1])
    jacobian[:-1, :] /= frequency
    return np.append(coefficients, frequency), jacobian @ spread @ jacobian.T


def _measured(method: Averaging, decay: xr.Dataset) -> xr.Dataset:
    return envelope(decay, method.curve).assign_attrs(first_time=float(decay.time.values[0]))


def _corrected(
    method: Averaging, runs: Sequence[_Run], library: ForceLibrary, found: _Averaged
) -> tuple[Array, str, float]:
    """Values whose simulated motions, averaged alike, give what the records gave, and the Birge ratio."""
    values = found.values
    errors = np.sqrt(np.diag(found.covariance)) * max(1.0, found.birge_ratio) + 1e-300
    frequency = float(values[-1])
    starts = [first_guess(*_first_swings(run.decay, frequency), frequency) for run in runs]
    for _ in range(MAX_CORRECTIONS):
        try:
            moving = [
                _simulated(method, run, library, values, start)
                for run, start in zip(runs, starts, strict=True)
            ]
            again = _first_order(method, moving, library)
        except SysidTribError as error:
            return found.values, f"no: {error}", found.birge_ratio
        step = found.values - again.values
        if method.reference_frequency is not None:
            step[-1] = 0.0
        values = values + step
        if np.all(np.abs(step) < 1e-3 * errors):
            # What half-sines and first order leave is in the simulation as well.
            pairs = zip(found.residuals, again.residuals, strict=True)
            gaps = [one[: len(two)] - two[: len(one)] for one, two in pairs]
            return values, "yes", _birge_ratio(gaps, found.freedom)
    return found.values, "no: the correction did not settle", found.birge_ratio


def _first_swings(decay: xr.Dataset, frequency: float) -> tuple[Array, Array]:
    """Two periods fix the start; a model that is still biased may slip out of phase later."""
    time, angle = decay.time.values, decay.angle.values
    count = int(np.searchsorted(time, time[0] + 4.0 * np.pi / frequency)) + 1
    return time[:count], angle[:count]


def _simulated(
    method: Averaging, run: _Run, library: ForceLibrary, values: Array, start: tuple[float, float]
) -> xr.Dataset:
    """The envelope of the model's motion, at the same half periods and with the record's error bars."""
    decay, measured = run.decay, run.measured
    time = decay.time.values
    coefficients = dict(zip(library.symbols, values[:-1].tolist(), strict=True))
    model = Model(library, coefficients, float(values[-1]), method.shapes)
    motion = fit_start(model, *_first_swings(decay, float(values[-1])), start, offset=None)
    moved = trajectory(model, time, motion.angle, motion.rate).angle
    simulated = _measured(method, xr.Dataset({"angle": ("time", moved)}, {"time": time}))
    shift = int(np.argmin(np.abs(simulated.extremum_time.values - measured.extremum_time.values[0])))
    count = min(measured.sizes["half_period"], simulated.sizes["half_period"] - shift)
    simulated = simulated.isel(
        half_period=slice(shift, shift + count), instant=slice(shift, shift + count - 2)
    )
    for name in ("extremum_standard_error", "extremum_time_standard_error"):
        simulated[name] = measured[name].isel(half_period=slice(0, count))
    return simulated
