"""Screening: each candidate as one more column of a model, its gain, and the p-value of this gain."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Mask, root_mean_square
from sysid_trib.discovery import single_columns as single
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.likelihood import Likelihood, likelihood, of_many_rows
from sysid_trib.discovery.engine.run_products import RunProducts
from sysid_trib.discovery.engine.shape_parameters import has_frequency_parameter
from sysid_trib.discovery.engine.trials import TrialEffect, frequencies_of, trials_of
from sysid_trib.discovery.omnibus_test import FAMILIES, independent_tests, omnibus, trial_columns
from sysid_trib.discovery.shapes import climbed, refined
from sysid_trib.forces.force import Force

SAME_EFFECT = "not testable on this record: parameters of the model have the same effect"
NOT_FINITE = "it is not finite on this motion"
TOO_FINE = "not testable on this record: with a random force, the motion is not known finely enough"


@dataclass(frozen=True)
class Screening:
    """Gains of all candidates with a model.

    Attributes
    ----------
    model : FittedModel
    trials : list of TrialEffect
    reasons : list of str
        Why a trial cannot be tested, else empty.
    gains : (trial,) array of float
        Decrease of the deviance by its column. With and without the column, both variances of each run take
        their most likely values. 0 if physics forbids the sign of its coefficient.
    coefficients, errors, effective_rows : (trial,) array of float
        Coefficient, its standard error, and the number of rows that determine this error.
    outside : (trial,) array of float
        Fraction of its column outside the span of the model's columns.
    correlation : (trial, trial) array of float
        Correlation of the independent parts of two columns.
    relative_force : (trial,) array of float
        RMS of its force, with a coefficient of 1, over the restoring force.
    tests : float
        Number of independent tests of the candidates; the omnibus test counts as as many again.
    products : sequence of RunProducts
        Products of the model's columns, then the trials', then the omnibus test's.
    omnibus_z : (trial_force,) array of float
        Scores of forces of any form: roots of the gain of each alone, with the sign of its coefficient.
    omnibus_p_value : float
        P-value of the test without candidates (see `omnibus`).
    whole : Likelihood
        Likelihood of the model's columns along its path, including the steps of its shapes.
    fine : dict of int to bool
        Whether the known motion resolves a trial, for the trials checked so far.
    """

    model: FittedModel
    trials: list[TrialEffect]
    reasons: list[str]
    gains: Array
    coefficients: Array
    errors: Array
    effective_rows: Array
    outside: Array
    correlation: Array
    relative_force: Array
    tests: float
    products: Sequence[RunProducts]
    omnibus_z: Array
    omnibus_p_value: float
    whole: Likelihood
    fine: dict[int, bool] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Symbols of the model's effects, which candidates may replace."""
        return self.model.effects

    @property
    def first_trial(self) -> int:
        """Column of the first trial in `products`."""
        return 1 + self.model.columns

    @property
    def z(self) -> Array:
        """Root of the gain of each trial, with the sign of its coefficient, (trial,)."""
        return np.sqrt(self.gains) * np.sign(self.coefficients)

    @cached_property
    def p_values(self) -> Array:
        """P-value of each trial: the probability that any trial gains more by chance, (trial,)."""
        gained = zip(self.gains, self.trials, self.effective_rows, strict=True)
        return np.array([self.p_value_of(gain, trial.force, rows) for gain, trial, rows in gained])

    @property
    def widening(self) -> float:
        """Factor by which errors due to noise are too small if the omnibus test rejects; at least 1.

        A missing force changes the coefficients as much as the scores of forces of any form. The mean square
        of these scores is 1 for noise (Birge 1932).
        """
        # `validation.verdict.widening` uses the residual of the free motion, which a random force makes
        # large.
        tested = self.omnibus_z[self.omnibus_z != 0.0]
        rejects = self.omnibus_p_value < self.model.settings.level and len(tested)
        return max(1.0, root_mean_square(np.abs(tested))) if rejects else 1.0

    def best(self, *, testable: bool = True) -> list[int]:
        """Return the trial of largest gain of each candidate, best first; by default only testable ones."""
        best: dict[str, int] = {}
        for at in np.argsort(-self.gains, kind="stable").tolist():
            if not (testable and self.reasons[at]):
                best.setdefault(self.trials[at].force.symbol, at)
        return list(best.values())

    def are_fine(self, trials: Sequence[int]) -> list[bool]:
        """Return the mask of trials that the known motion resolves."""
        unasked = [at for at in trials if at not in self.fine]
        if unasked:
            known = single.are_known_finely(self.model, [self.trials[at] for at in unasked])
            self.fine.update(zip(unasked, known.tolist(), strict=True))
        return [self.fine[at] for at in trials]

    def first_fine(self, order: Sequence[int]) -> list[int]:
        """Return the first trial of each candidate, in a given order, that the known motion resolves."""
        waiting: dict[str, list[int]] = {}
        for at in order:
            waiting.setdefault(self.trials[at].force.symbol, []).append(at)
        firsts = set[int]()
        while waiting:
            fine = self.are_fine([at for at, *_ in waiting.values()])
            firsts |= {at for (at, *_), known in zip(waiting.values(), fine, strict=True) if known}
            later = zip(waiting.items(), fine, strict=True)
            waiting = {symbol: rest for (symbol, (_, *rest)), known in later if rest and not known}
        return [at for at in order if at in firsts]

    @property
    def replacing(self) -> list[int]:
        """Trials that are testable, or would be if they replaced an effect with the same column."""
        return [at for at, reason in enumerate(self.reasons) if reason in ("", SAME_EFFECT)]

    def tolerance(self, at: int, fitted: Sequence[Force]) -> float:
        """Return the relative error allowed for the gain of a trial's column."""
        settings, force = self.model.settings, self.trials[at].force
        # With a random force stronger than the noise, a path follows the record with its sensor errors.
        if force.kind == "sensor" and np.max(self.model.likelihood.ratios) > 1.0:
            return 1.0
        near = any(force.family == other.family for other in fitted)
        return settings.family_tolerance if near else settings.tolerance

    def allows(self, at: int, coefficient: ArrayLike) -> Mask:
        """Return true if physics allows this coefficient, or these coefficients, of a trial."""
        strongest = self.model.settings.strongest
        return single.is_physical(self.trials[at].force, coefficient, self.relative_force[at], strongest)

    def p_value_of(self, gain: float, force: Force, effective_rows: float) -> float:
        """Return the probability of such a gain by chance in any of the tests.

        A fitted frequency adds as many tests as the largest value of a spectrum needs between its lines
        (Davies 1987; Baluev 2008, eq. 6). `effective_rows` : number of rows that determine the coefficient's
        error.
        """
        gain = max(0.0, gain) * float(of_many_rows(effective_rows, 1 + self.model.columns))
        p_value = self.tests * float(scipy.stats.chi2.sf(gain, 1))
        if has_frequency_parameter(force):
            lines = 0.5 * sum(run.rows for run in self.products)
            p_value += FAMILIES * lines * float(np.sqrt(np.pi / 6.0 * gain) * np.exp(-0.5 * gain))
        return min(1.0, p_value)

    def p_value_with(self, others: Sequence[int], column: int, gain: float | None = None) -> float:
        """Return the p-value of the gain of a column of `products` with others, or of a given gain."""
        bare = likelihood(self.products, others)
        deviance, _, _, rows = single.each_column(self.products, others, [column], bare)[:, 0].tolist()
        trials = self.trials if column >= self.first_trial else self.model.trials
        force = trials[column - (self.first_trial if column >= self.first_trial else 1)].force
        return self.p_value_of(bare.deviance - deviance if gain is None else gain, force, rows)

    def gain_of(self, symbols: Sequence[str]) -> float:
        """Return the decrease of the deviance due to effects of the model, along its path."""
        without = likelihood(self.products, self.model.columns_without(symbols))
        return without.deviance - self.whole.deviance

    def p_value_of_effect(self, symbol: str, gain: float | None = None) -> float:
        """Return the p-value of the gain of an effect along the path of its model, or of a given gain."""
        gain = self.gain_of((symbol,)) if gain is None else gain
        column = 1 + self.model.columns_of(symbol)[0]
        return self.p_value_with(self.model.columns_without((symbol,)), column, gain)


def screen(model: FittedModel, candidates: Sequence[Force]) -> Screening:
    """Screen candidates with a model, at grids of their shape parameters."""
    settings, (trials, columns) = model.settings, _tried(model, candidates)
    good, columns = single.where_finite(columns)
    along = [trial_columns(rows.path) for rows in model.rows]
    products = single.products_with(model, columns, along)
    # The first column follows the target.
    first, last = 1 + model.columns, 1 + model.columns + len(trials)
    base, offered, trial_forces = range(1, first), range(first, last), range(last, last + along[0].shape[1])
    whole = likelihood(products, base)
    part, rest = single.projected(products, whole, base, [*offered, *trial_forces])
    reasons = ["" if finite else NOT_FINITE for finite in good]
    for at in np.flatnonzero(good & (part[: len(trials)] < settings.testable)):
        reasons[at] = SAME_EFFECT
    able = np.array([not reason for reason in reasons], dtype=bool)
    deviance, coefficients, errors, effective_rows = single.each_column(products, base, offered, whole)
    fitted = able & single.are_physical(model, trials, coefficients, columns)
    gains = np.maximum(0.0, np.where(fitted, whole.deviance - deviance, 0.0))
    correlation = single.correlation_of(rest[: len(trials), : len(trials)])
    tests = FAMILIES * independent_tests(correlation[np.ix_(able, able)], settings.seed)
    z, p_value = omnibus(products, along, part[len(trials) :] >= settings.testable, model, whole)
    screening = Screening(
        model=model,
        trials=trials,
        reasons=reasons,
        gains=gains,
        coefficients=np.where(able, coefficients, 0.0),
        errors=np.where(able, errors, np.nan),
        effective_rows=effective_rows,
        outside=part[: len(trials)],
        correlation=correlation,
        relative_force=single.strengths(model, columns),
        tests=tests,
        products=products,
        omnibus_z=z,
        omnibus_p_value=p_value,
        whole=whole,
    )
    # For each candidate test the trial of largest gain, or the next one if the motion does not resolve it.
    screening.first_fine([at for at in np.argsort(-gains).tolist() if able[at]])
    for too_fine in (at for at, fine in screening.fine.items() if not fine):
        reasons[too_fine], gains[too_fine] = TOO_FINE, 0.0
    return screening


def _tried(model: FittedModel, candidates: Sequence[Force]) -> tuple[list[TrialEffect], list[Array]]:
    """Return candidates at refined grids of their shapes, and their columns; several shapes are optimised."""
    trials = trials_of(candidates, _lines(model), model.rows[0].path.frequency, model.settings)
    trials, columns, scores = refined(model, trials)
    drives = np.array([trial.force.passive for trial in trials], dtype=bool) & (scores < 0.0)
    gains = np.where(drives, 0.0, scores**2)
    # Keep candidates whose true gain may be the largest, given the error of their screened gain.
    likely = gains >= (1.0 - model.settings.family_tolerance) ** 2 * np.max(gains, initial=0.0)
    promising = {trials[at].force.symbol for at in np.flatnonzero(likely)}
    families = {trial.force.family for trial in model.trials if trial.added}
    several = [force for force in candidates if force.symbol in promising or force.family in families]
    tops = climbed(model, several)
    if not tops:
        return trials, columns
    further = [rows.coarse_columns(tops) for rows in model.rows]
    return [*trials, *tops], [np.column_stack(pair) for pair in zip(columns, further, strict=True)]


def _lines(model: FittedModel) -> list[float]:
    """Return the frequencies (rad/s) of the strongest lines in the residual, and of the model's forces.

    A force at the frequency of a model force has no line in the residual, but may replace the model force.
    """
    # These frequencies are tried without a test; `validation.lack_of_fit.spectral_line` tests one line.
    most, lines = model.settings.lines, list[tuple[float, float]]()
    for rows, residual in zip(model.rows, model.white_residuals(), strict=True):
        count, duration = len(residual), float(np.ptp(rows.path.time[[0, -1]]))
        power = np.abs(np.fft.rfft(residual * np.hanning(count), 4 * count)) ** 2
        frequency = 2.0 * np.pi * np.arange(len(power)) / 4.0 / duration
        peaks, _ = scipy.signal.find_peaks(power, distance=8)
        lines += zip(power[peaks].tolist(), frequency[peaks].tolist(), strict=True)
    reference = model.rows[0].path.frequency
    of_model = [w for trial in model.trials for w in frequencies_of(trial, reference)]
    return of_model + [w for _, w in sorted(lines, reverse=True)[:most]]
