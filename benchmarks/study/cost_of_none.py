"""What not to know that nothing pushes costs: errors beside an estimated random force over those with none.

The record of `pushed` that nothing pushes (white noise, 60 samples a period, the same seeds), linear about
its motion: nothing of a method but the statistics is left. Of each record the ratio of both variances has its
greatest restricted likelihood, at zero or above it, and generalised least squares the coefficients. No method
that takes the ratio from the record does better at this; how far its own figure (`pushed` with a file of the
method and of its -off) is from this one is the method's.
"""

from argparse import Namespace

import numpy as np
from scipy.interpolate import CubicSpline

import sysid_trib as st
from benchmarks.study.common import rms, shown
from benchmarks.study.pushed import FREE
from sysid_trib.likelihood.ratio_posterior import probability_of_none
from sysid_trib.likelihood.variance_ratio import ratio_span
from sysid_trib.motion_fit.linearised import linearised_about
from sysid_trib.simulation.motions import FREQUENCY
from sysid_trib.validation.random_force_test import TrialModel, trial_model

# e-folds between two ratios that are tried, and how many of them: up to a wander of 3 noise levels.
STEP, E_FOLDS = 0.25, 9.0


def records_about_motion(seeds: range) -> tuple[TrialModel, int, np.ndarray]:
    """The noise of each seed about the motion, the number of parameters, and the ratios to try."""
    case, model = FREE[0], FREE[0].model
    motion, w = st.simulate(model, case.time, case.start), model.reference_frequency
    path = np.column_stack([motion.angle.values, motion.rate.values / w])
    own = np.array([path[0, 0], w * path[0, 1], 0.0])
    by = (*model.coefficients, FREQUENCY)
    linear = linearised_about(model, (case.time, motion.angle.values), path, own, by)
    noise = [np.random.default_rng(seed).standard_normal(len(path)) for seed in seeds]
    kicks = linear.steps.diffusion[:, 1, 1]
    low, _ = ratio_span(float(kicks.sum()), float(np.median(kicks)))
    ratios = np.append(0.0, low * np.exp(np.arange(0.0, E_FOLDS, STEP)))
    no_trial = np.zeros((len(path) - 1, 2, 0))
    return trial_model(linear, no_trial, np.column_stack(noise)), len(model.coefficients) + 1, ratios


def estimates(trial: TrialModel, ratio: float) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Restricted deviance and parameters (parameter, record) at a ratio, determinant, freedom."""
    columns, _, records, log_determinant = trial.white(ratio)
    records = records[:, 1:]
    q, r = np.linalg.qr(columns)
    rest = records - q @ (q.T @ records)
    freedom = len(rest) - len(r)
    determinant = log_determinant + 2.0 * np.sum(np.log(np.abs(np.diag(r))))
    deviance = freedom * np.log(np.sum(rest**2, axis=0) / freedom) + determinant
    return deviance, np.linalg.solve(r, q.T @ records), determinant, freedom


def averaged(deviance: np.ndarray, values: np.ndarray, determinant: np.ndarray, freedom: int) -> np.ndarray:
    """Mean of the parameters over all ratios, (parameter, record), as `average_over_ratios` has it."""
    spline = CubicSpline(STEP * np.arange(len(determinant) - 1), determinant[1:])
    slope, bend = (spline(spline.x, order) for order in (1, 2))
    prior = np.sqrt(np.maximum(slope - bend - slope**2 / freedom, 0.0))
    least = deviance[1:].min(axis=0)
    weight = prior[:, None] * np.exp(0.5 * (least - deviance[1:]))
    gain = deviance[0] - np.minimum(least, deviance[0])
    none = np.array([probability_of_none(of, freedom) for of in gain])
    weight = np.vstack([none, (1.0 - none) * weight / weight.sum(axis=0)])
    return np.asarray(np.einsum("rn,rpn->pn", weight, values))


def main(asked: Namespace) -> None:
    trial, parameters, ratios = records_about_motion(range(asked.seeds))
    each_ratio = zip(*(estimates(trial, r) for r in ratios), strict=True)
    deviance, values, determinant, freedom = (np.stack(each) for each in each_ratio)
    likely = np.argmin(deviance, axis=0)
    chosen = np.take_along_axis(values, likely[None, None, :], axis=0)[0]
    mean, without = averaged(deviance, values, determinant, int(freedom[0])), values[0]
    rows = []
    for title, of in (("at the most likely ratio", chosen), ("mean over the ratios", mean)):
        ratio = (rms(of, 1) / rms(without, 1))[:parameters]
        none = f"{100.0 * np.mean(likely == 0):.0f}"
        rows.append([str(len(likely)), none, title, f"{rms(ratio):.3f}", f"{ratio.max():.3f}"])
    shown("", ("records", "no random force (%)", "estimate", "RMS error / off", "worst"), rows)
