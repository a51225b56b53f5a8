"""A record as equations about a smoothed motion: integrals of Eq. 1 against narrow test functions.

For a path x near the motion, d = record - zero - errors of the sensor - x, and A the operator of small
deviations,

    A d + integral psi (x'' + (1 + kappa) x + sum c h) = A noise + integral psi (random force).

Every force and every error of the sensor is a column of these rows. The path is a spline plus the fine motion
due to the forces themselves, which may switch or reverse within a sample. No simulation is needed, because
the difference between path and motion has an effect of second order only.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline, PPoly

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.discovery.engine import stepped_states
from sysid_trib.discovery.engine.trials import Settings, TrialEffect
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import Force, channels_of
from sysid_trib.likelihood import force_columns, sensor_noise, weak_form
from sysid_trib.records.inputs import KnownInput, values_of_inputs
from sysid_trib.records.roles import INPUT
from sysid_trib.records.smoothing import SplinesAt, least_squares_spline
from sysid_trib.simulation import internal_states

# Trials with their coefficients.
Terms: TypeAlias = Sequence[tuple[TrialEffect, float]]
# Fractions of a cell between two points, at which a force that switches in the cell is averaged.
CELL_PARTS = (np.arange(32) + 0.5) / 32.0 - 0.5
# Most values of forces along a path that are kept at once; for long records they would fill the memory.
NUMBERS_AT_ONCE = 2**22
# Fine motion before any force is known.
NO_FINE_MOTION = PPoly(np.zeros((3, 1)), [0.0, 1.0])


@dataclass(frozen=True)
class RecordPath:
    """A record and a smoothed motion near it.

    Attributes
    ----------
    time, angle : (sample,) array of float, s and rad
        The record.
    frequency : float, rad/s
        Frequency to which coefficients refer; tau = frequency * time.
    form : WeakForm
    spline : BSpline
        The path without its fine motion, over tau.
    sensor : NoiseModel
        Noise of the sensor; its level is a first estimate only.
    origin : float, s
        Time from which the `t` of formulas counts.
    intervals : int
        Number of intervals between the knots of path and test functions; it stays the same when the frequency
        changes.
    settings : Settings
    sticking : (row,) array of bool
        Rows without information on the forces, because a reaction holds the motion there.
    frequency_free : bool
        Whether the frequency is fitted.
    fine : PPoly
        Fine motion: it starts at rest and is due to the forces that gave the path, each constant in the cell
        about a point.
    ratio : float
        Most likely ratio of the random force to the sensor's noise so far; 0 if not known.
    held : Terms
        Forces that are always present, such as a pendulum's gravity, with their coefficients; they are not
        columns.
    inputs : mapping of str to KnownInput
        Inputs that drive the motion.
    before : RecordPath, optional
        The record up to and including the first sample, for forces that depend on the history.
    """

    time: Array
    angle: Array
    frequency: float
    form: weak_form.WeakForm
    spline: BSpline
    sensor: sensor_noise.NoiseModel
    origin: float
    intervals: int
    settings: Settings
    sticking: Mask
    frequency_free: bool = True
    fine: PPoly = NO_FINE_MOTION
    ratio: float = 0.0
    held: Terms = ()
    inputs: Mapping[str, KnownInput] = field(default_factory=dict)
    before: "RecordPath | None" = None

    @property
    def elapsed(self) -> Array:
        """The `t` of formulas, (sample,), s."""
        return self.time - self.origin

    def elapsed_at(self, tau: Array) -> Array:
        """Return the `t` of formulas, (point,), s."""
        return tau / self.frequency + float(self.time[0]) - self.origin

    def given_at(self, trials: Iterable[TrialEffect], tau: Array) -> dict[str, Array]:
        """Return the inputs in the formulas of trials, (point,) each."""
        channels = channels_of(trial.force for trial in trials)
        return values_of_inputs(self.inputs, channels, tau / self.frequency, self.frequency)

    @cached_property
    def at_samples(self) -> tuple[Array, Array]:
        """x and x' at the samples, (sample,) each, rad."""
        return self._at(self.form.splines), self._at(self.form.splines, 1)

    def _at(self, splines: SplinesAt, order: int = 0) -> Array:
        """Return the path or a derivative by tau at points that many paths have in common, (point,), rad."""
        return splines.of(self.spline, order) + self.fine(splines.points, order)

    @cached_property
    def _between(self) -> tuple[SplinesAt, sp.csr_matrix]:
        return weak_form.points_between(self.form.tau, self.intervals, self.settings.points_per_period)

    @property
    def integrals(self) -> sp.csr_matrix:
        """Matrix that integrates values at the points where forces are evaluated, (row, point)."""
        return self._between[1]

    @cached_property
    def points(self) -> tuple[Array, Array, Array, Array]:
        """tau, x, v and the `t` of formulas where forces are evaluated, (point,) each."""
        splines, _ = self._between
        tau = splines.points
        return tau, self._at(splines), self._at(splines, 1), self.elapsed_at(tau)

    @cached_property
    def motion(self) -> stepped_states.GivenMotion:
        """Path for history-dependent forces, with the record before it."""
        if self.before is None:
            return stepped_states.GivenMotion(*self.points)
        early, *others = self.before.points
        pairs = zip((early - early[-1], *others), self.points, strict=True)
        return stepped_states.GivenMotion(*(np.concatenate([first[:-1], last]) for first, last in pairs))

    @cached_property
    def _forcing(self) -> Array | float:
        """An input that is an acceleration, (point,), rad."""
        known = self.inputs.get(INPUT)
        return 0.0 if known is None else known.of(self.points[0] / self.frequency) / self.frequency**2

    @cached_property
    def known_part(self) -> Array:
        """Integrals of x'', of x and of the held forces, (row,)."""
        splines, integrals = self._between
        half = 0.5 * (splines.points[1] - splines.points[0])
        # The mean of the acceleration in the cell about each point.
        rise = self.fine(splines.points + half, 1) - self.fine(splines.points - half, 1)
        acceleration = splines.of(self.spline, 2) + rise / (2.0 * half)
        return np.asarray(integrals @ (acceleration - self._forcing)) + self.stiffness_column

    @cached_property
    def stiffness_column(self) -> Array:
        """Integrals of x and of the always present forces, which scale with the frequency squared, (row,)."""
        return np.asarray(self.integrals @ (self.points[1] + self._force(self.held)))

    def tangent(self, terms: Terms, stiffness: float) -> tuple[Array, Array]:
        """Return stiffness and damping of small deviations from a model's motion, (point,) each."""
        acting = [*terms, *((trial, (1.0 + stiffness) * c) for trial, c in self.held)]
        tau, x, v, time = self.points
        given = self.given_at([trial for trial, _ in acting], tau)
        of_x, of_v = force_columns.derivatives_along(
            ((trial.force, c, trial.shapes) for trial, c in acting), (time, x, v), given
        )
        for trial, c in acting:
            if trial.force.kind == "force" and not trial.force.memoryless and c:
                past_x, past_v = stepped_states.tangent_along(self.motion, trial.force, trial.shapes)
                of_x, of_v = of_x + c * past_x[-len(tau) :], of_v + c * past_v[-len(tau) :]
        return 1.0 + stiffness + of_x, of_v

    def operator(self, tangent: tuple[Array, Array]) -> sp.csr_matrix:
        """Return the operator of small deviations of a motion, (row, sample).

        It uses means of stiffness and damping about each sample, because both may jump between samples.
        """
        points = len(tangent[0])
        parts = (points - 1) // (len(self.time) - 1)
        weights = 1.0 - np.abs(np.arange(1 - parts, parts)) / parts
        whole = np.convolve(np.ones(points), weights, "same")
        means = (np.convolve(values, weights, "same") / whole for values in tangent)
        return weak_form.noise_operator(self.form, *(np.asarray(mean[::parts]) for mean in means))

    def columns(self, trials: Sequence[TrialEffect], operator: sp.csr_matrix) -> Array:
        """Return the rows of each trial with coefficient 1, (row, trial); nan if a force fails."""
        columns = np.empty((self.form.rows, len(trials)))
        of_force = [at for at, trial in enumerate(trials) if trial.force.kind == "force"]
        few = max(1, NUMBERS_AT_ONCE // len(self.points[0]))
        for part in (of_force[first : first + few] for first in range(0, len(of_force), few)):
            columns[:, part] = self.integrals @ self.force_values([trials[at] for at in part])
        for at, trial in enumerate(trials):
            if trial.force.kind == "sensor":
                columns[:, at] = -(operator @ self.sensor_errors([(trial, 1.0)]))
        return columns

    def sensor_errors(self, terms: Terms) -> Array:
        """Return the errors of the sensor at the samples, (sample,), rad."""
        errors = np.zeros(len(self.time))
        for trial, c in terms:
            if trial.force.kind == "sensor":
                errors += c * trial.force.value(*self.at_samples, self.elapsed, shapes=trial.shapes)
        return errors

    def sensor_slopes(self, terms: Terms) -> tuple[Array, Array]:
        """Return the derivatives of sensor errors by the angle and by its rate, (sample,) each."""
        forces = ((trial.force, c, trial.shapes) for trial, c in terms)
        return force_columns.derivatives_along(forces, (self.elapsed, *self.at_samples), kind="sensor")

    def _force(self, terms: Terms) -> Array:
        """Return the sum of the forces of a model along the path, (point,), rad."""
        acting = [(trial, c) for trial, c in terms if trial.force.kind == "force"]
        return self.force_values([trial for trial, _ in acting]) @ np.array([c for _, c in acting])

    def force_values(self, trials: Sequence[TrialEffect]) -> Array:
        """Return forces of coefficient 1 along the path, (point, trial), rad; nan if a force fails."""
        values = np.full((len(self.points[0]), len(trials)), np.nan)
        with_past: dict[str, list[int]] = {}
        for at, trial in enumerate(trials):
            if trial.force.memoryless:
                values[:, at] = self._memoryless(trial)
            else:
                with_past.setdefault(trial.force.symbol, []).append(at)
        for rows in with_past.values():
            force, shapes = trials[rows[0]].force, [trials[at].shapes for at in rows]
            together = stepped_states.values_along(self.motion, force, shapes)
            together = self._collocated(force, shapes) if together is None else together
            values[:, rows] = together[-len(values) :]
        return values

    def _memoryless(self, trial: TrialEffect) -> Array:
        force, (tau, x, v, time) = trial.force, self.points
        values = np.array(force.value(x, v, time, shapes=trial.shapes, hidden=self.given_at([trial], tau)))
        if force.surfaces:
            cells, fine, motion = self._crossed_cells(trial)
            within = force.value(*motion, shapes=trial.shapes, hidden=self.given_at([trial], fine))
            values[cells] = within.reshape(len(cells), len(CELL_PARTS)).mean(axis=1)
        return values

    @cached_property
    def _cells(self) -> dict[bytes, tuple[Index, Array, tuple[Array, Array, Array]]]:
        return {}

    def _crossed_cells(self, trial: TrialEffect) -> tuple[Index, Array, tuple[Array, Array, Array]]:
        """Return the cells in which a force switches, with tau, x, v and time at points within them."""
        tau, x, v, time = self.points
        shapes = trial.force.shape_values(trial.shapes)
        names = {"x": x, "v": v, "t": time} | self.given_at([trial], tau) | shapes
        crossed = np.zeros(len(tau) - 1, dtype=bool)
        for surface in trial.force.surfaces:
            crossed |= np.diff(np.signbit(surface.evaluate(names) + np.zeros(len(tau))))
        packed = np.packbits(crossed).tobytes()
        if packed not in self._cells:
            cells = np.flatnonzero(np.append(crossed, False) | np.append(False, crossed))
            fine = (tau[cells, None] + (tau[1] - tau[0]) * CELL_PARTS).ravel()
            x, v = (np.asarray(self.spline(fine, order) + self.fine(fine, order)) for order in (0, 1))
            self._cells[packed] = cells, fine, (x, v, self.elapsed_at(fine))
        return self._cells[packed]

    def _collocated(self, force: Force, shapes: Sequence[Mapping[str, float]]) -> Array:
        motion = self.motion
        x, v = motion.at_samples["x"], motion.at_samples["v"]
        columns = np.full((len(x), len(shapes)), np.nan)
        for column, of in zip(columns.T, shapes, strict=True):
            with suppress(SysidTribError):
                hidden = internal_states.states_along(force, motion.tau, x, v, of, time=motion.time)
                column[:] = force.value(x, v, motion.time, shapes=of, hidden=hidden)
        return columns

    def follow(self, motion: Array, terms: Terms) -> "RecordPath":
        """Return the path through a motion at the samples, (sample,), with the fine motion due to forces."""
        tau, acceleration = self.points[0], self._forcing - self._force(terms) - self._force(self.held)
        cells = np.concatenate([tau[:1], 0.5 * (tau[1:] + tau[:-1]), tau[-1:]])
        fine = PPoly(acceleration[None], cells).antiderivative(2)
        return replace(self, fine=fine).through(motion)

    def rescaled(self, frequency: float) -> "RecordPath":
        """Return the rows with coefficients that refer to another frequency."""
        form = weak_form.build_weak_form(frequency * (self.time - self.time[0]), self.intervals)
        part = frequency / self.frequency
        fine = PPoly(self.fine.c / part ** np.array([[2], [1], [0]]), part * self.fine.x)
        before = self.before and self.before.rescaled(frequency)
        path = replace(self, frequency=frequency, form=form, fine=fine, before=before)
        return path.through(self.at_samples[0])

    def through(self, motion: Array) -> "RecordPath":
        """Return the path through a motion at the samples, (sample,), rad."""
        tau = self.form.tau
        spline, _ = least_squares_spline(tau, motion - self.fine(tau), self.intervals)
        return replace(self, spline=spline)
