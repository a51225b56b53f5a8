"""Rows about a motion, and exact fits along smoothed motions: laws, recovered truths, errors."""

import numpy as np
import pytest
import xarray as xr
from discovery import (
    BASE,
    EFFECTS,
    EVERY,
    TIME,
    WHITE,
    coefficients_of,
    deviations,
    errors_of,
    exact,
    library,
    model_of,
    rows_about,
    start_model,
    trials_with,
    with_effect,
)
from helpers import FIVE, NOISE, W, decay, rms, rms_range
from kicked_motion import kicked_motion, smooth_forces

from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.parts import homogeneity
from sysid_trib.forces.library import parse_library
from sysid_trib.likelihood.model_fit import fit_model
from sysid_trib.likelihood.paths import path_of
from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.likelihood.run_rows import nuisances
from sysid_trib.likelihood.start_model import refitted
from sysid_trib.likelihood.trials import TrialEffect, trials_of
from sysid_trib.likelihood.weak_form import cholesky_factor, whiten
from sysid_trib.validation import cramer_rao_bound

FRICTION = FIVE | {"lambda": 2e-4}
# A spline alone would round the jumps of strong dry friction and have its reversals late.
STRONG_FRICTION = FIVE | {"lambda": 5e-4}
# Narrower than a cell of the motion, or singular there: no derivative to hold them against.
SINGULAR = {"stribeck", "stribeck_exponential"}
# At the ends the operator is made for noise, not for changes that have grown for many periods.
INSIDE = slice(6, -6)
# Of wander: the angle after the record, over the noise of a sample.
WANDER = 5.0
DENSITY = (WANDER * NOISE * 2.0 * W) ** 2 / TIME[-1]


@pytest.mark.parametrize(
    ("coefficients", "shapes"),
    [
        (FIVE, {}),
        (FRICTION, {}),
        (STRONG_FRICTION, {}),
        (FIVE | {"sensor_curve": 0.05, "shutter": 0.02}, {}),
        (FIVE | {"dahl": 3e-3}, {"dahl.s": 0.05}),
        (FIVE | {"power_damping": 0.01, "equilibrium_drift": 1e-3}, {"power_damping.p": 1.7}),
        (FIVE | {"partial_slip": 0.05}, {}),
    ],
    ids=lambda value: " ".join(value) or "-",
)
def test_rows_of_an_exact_motion_vanish(coefficients, shapes):
    model = model_of(coefficients, shapes)
    rows = rows_about(model, TIME)
    trials, truth = trials_with(model)
    remainder = rows.target - rows.columns(trials) @ truth[:-1]
    white = whiten(cholesky_factor(rows.band), remainder) / NOISE
    # What is wrong with them is less than a standard error, whatever it looks like.
    assert np.sum(white**2) < 1.0


@pytest.mark.parametrize("solid", [-2.3e-5, 3e-4])
def test_a_column_is_what_a_candidate_does_to_the_record(solid):
    """Rows of the change of the record about the motion without it, by the operator of small deviations."""
    base, time = FIVE | {"lambda": solid}, TIME[:320]
    before = exact(model_of(base), time)
    rows = rows_about(model_of(base), time)
    wrong = {}
    for force in EFFECTS:
        if force.symbol in SINGULAR:
            continue
        model = model_of(base | {force.symbol: 0.0})
        trial = trials_with(model)[0][-1]
        column = rows.columns([trial])[:, 0]
        step = 1e-3 * NOISE / max(rms(column).item(), 1e-6)
        change = (exact(model_of(base | {force.symbol: step}), time) - before) / step
        difference = -(rows.operator @ change) - column
        white = whiten(cholesky_factor(rows.band), np.column_stack([difference, column]))
        wrong[force.symbol] = np.divide(*np.linalg.norm(white, axis=0))
    assert max(wrong.values()) < 0.03, wrong


def test_stiffness_and_zeros_are_columns_too():
    rows, before = rows_about(model_of(FIVE)), exact(model_of(FIVE))
    stiffness, zero = nuisances(rows, 0, 1, True).T
    np.testing.assert_allclose(zero, -(rows.operator @ np.ones(len(TIME))))
    library_with = model_of(FIVE | {"alpha": 1e-7})
    changed = -(rows.operator @ (exact(library_with) - before)) / 1e-7
    assert np.linalg.norm((changed - stiffness)[INSIDE]) < 2e-2 * np.linalg.norm(stiffness)


def test_a_record_without_noise_gives_the_truth():
    coefficients = FRICTION
    model = start_model([decay(TIME, exact(model_of(coefficients)))])
    assert model.settled
    assert model.rows[0].path.frequency == pytest.approx(W, rel=1e-5)
    bound = cramer_rao_bound(model_of(coefficients), TIME, 0.3, 0.0, NOISE, free=True)
    errors = bound.standard_error.sel(force=list(coefficients)).values
    found = np.array([coefficients_of(model)[symbol] for symbol in coefficients])
    # What the spline of a path cannot follow is a small part of an error beside noise.
    assert np.all(np.abs(found - list(coefficients.values())) < 0.5 * errors)


@pytest.mark.parametrize("coefficients", [FIVE, FRICTION], ids=["smooth", "dry friction"])
def test_errors_are_the_bound_and_cover_the_truth(coefficients):
    seeds, before = 6, exact(model_of(coefficients))
    models = [start_model([decay(TIME, before, seed)]) for seed in range(seeds)]
    z = np.array([deviations(model, coefficients) for model in models])
    low, high = rms_range(seeds)
    assert np.all((rms(z) > low) & (rms(z) < high))
    bound = cramer_rao_bound(model_of(coefficients), TIME, 0.3, 0.0, NOISE, free=True)
    bound = bound.standard_error.sel(force=list(coefficients)).values
    mine = np.median([[errors_of(model)[symbol] for symbol in coefficients] for model in models], axis=0)
    # The zero of the sensor is one unknown more; its level, and a random force, are estimated.
    np.testing.assert_allclose(mine / bound, 1.0, atol=0.1)
    assert np.median([model.sensor(0).standard_deviation for model in models]) == pytest.approx(
        NOISE, rel=0.03
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "shapes"),
    [
        ({"power_damping": 0.02}, {"power_damping.p": 1.4}),
        ({"dahl": 4e-3}, {"dahl.s": 0.06}),
        ({"iwan": 0.05}, {"iwan.s": 0.15}),
        ({"sensor_curve": 0.01}, {}),
        ({"shutter": 0.01}, {}),
        ({"damping_drift": 4e-4}, {}),
    ],
    ids=lambda value: " ".join(value),
)
def test_forces_sensors_and_shapes_are_fitted_alike(effects, shapes):
    base = {"zeta": 5e-3, "epsilon": 0.2}
    run = with_effect(effects, seed=2, base=base, shapes=shapes)
    model = start_model([run], library(*base, *effects))
    assert model.settled
    assert np.all(np.abs(deviations(model, base | effects)) < 4.5)
    found = {name: value for trial in model.trials for name, value in trial.shapes.items()}
    for name, true in shapes.items():
        assert abs(found[name] - true) < 4.5 * model.shape_errors()[name]
        # What is started from is not the truth.
        symbol, _, key = name.partition(".")
        assert abs(EVERY[symbol].shape[key].default - true) > 5.0 * model.shape_errors()[name]


def test_a_shape_is_held_at_the_end_of_its_range():
    (force,) = parse_library(
        {
            "force": [
                {
                    "symbol": "power",
                    "formula": "abs(v)**p*sign(v)",
                    "shape": {"p": {"default": 1.0, "low": 0.5, "high": 1.5}},
                }
            ]
        },
        "test",
    )
    base = {"zeta": 2e-3, "epsilon": 0.2}
    run = with_effect({"delta": 0.05}, seed=3, base=base)
    model = start_model([run], type(BASE)("of a test", (*library("epsilon"), force)))
    assert model.settled
    assert model.trials[1].shapes["power.p"] == pytest.approx(1.5)
    # A value that is held has no step and no error.
    column = model.columns_of("power")[1]
    assert model.likelihood.coefficients[column] == 0.0
    assert model.shape_errors()["power.p"] == 0.0


@pytest.mark.slow
def test_several_runs_share_coefficients_alone():
    starts, seeds = (0.3, 0.15), range(3)
    z, errors, levels = [], [], []
    for seed in seeds:
        runs = [
            decay(TIME, exact(model_of(FIVE), start=a) + 1e-3 * at, 100 * at + seed, NOISE * 2.0**at)
            for at, a in enumerate(starts)
        ]
        both = start_model(runs)
        z.append(deviations(both, FIVE))
        errors.append([errors_of(both)["nu"], *(errors_of(start_model([run]))["nu"] for run in runs[:1])])
        levels.append([both.sensor(at).standard_deviation for at in range(2)])
    assert np.median(levels, axis=0) == pytest.approx([NOISE, 2.0 * NOISE], rel=0.1)
    low, high = rms_range(len(seeds))
    assert np.all((rms(np.array(z)) > low) & (rms(np.array(z)) < high))
    assert np.all(np.array(errors)[:, 0] < np.array(errors)[:, 1])


@pytest.mark.slow
def test_runs_that_agree_differ_by_chance_alone():
    """What runs of their own explain of noise is a chi-square of as many degrees of freedom."""
    total, freedom, before = 0.0, 0, exact(model_of(FIVE))
    for seed in range(4):
        told = homogeneity([start_model([decay(TIME, before, seed + 100 * at) for at in range(2)])])
        assert told.degrees_of_freedom.item() == len(FIVE) + 1
        total, freedom = total + told.chi_square.item(), freedom + told.degrees_of_freedom.item()
    low, high = rms_range(freedom)
    assert low**2 < total / freedom < high**2


def test_runs_that_differ_are_told():
    worn = FIVE | {"zeta": FIVE["zeta"] + 2e-4}
    runs = [decay(TIME, exact(model_of(c)), seed) for seed, c in enumerate((FIVE, worn))]
    told = homogeneity([start_model(runs)])
    assert told.differ.item()
    assert told.most.item() == "zeta"


def kicked(seeds, density=DENSITY):
    """Records in a random force."""
    motions, _ = kicked_motion(TIME, W, smooth_forces(FIVE), 0.0, density, seeds)
    return [decay(TIME, x, seed) for seed, x in zip(seeds, motions, strict=True)]


SMOOTH = {symbol: value for symbol, value in FIVE.items() if symbol != "lambda"}


def test_a_random_force_has_its_density_and_coefficients_their_errors():
    seeds = range(6)
    models = [start_model([run], library(*SMOOTH)) for run in kicked(seeds)]
    density = [
        RandomForce.density_of(
            float(m.likelihood.ratios[0] * m.likelihood.variances[0]), m.rows[0].path.frequency
        )
        for m in models
    ]
    logs = np.log(np.array(density) / DENSITY)
    errors = np.array([model.likelihood.ratio_errors[0] for model in models])
    assert abs(np.mean(logs)) < 4.0 * np.std(logs) / np.sqrt(len(seeds)) + 0.05
    low, high = rms_range(len(seeds))
    assert low < rms(logs / errors) < high
    z = np.array([deviations(model, SMOOTH) for model in models])
    assert np.all((rms(z) > low) & (rms(z) < high))


@pytest.mark.slow
def test_noise_alone_needs_no_random_force():
    """Twice the gain of the likelihood is half a chi-square: it is beyond 4 in one of 44."""
    before = exact(model_of(FIVE))
    gains = np.array([start_model([decay(TIME, before, seed)]).likelihood.gains[0] for seed in range(10)])
    assert np.all(gains >= 0.0)
    assert np.count_nonzero(gains > 4.0) <= 2
    assert np.median(gains) < 1.0


def test_a_record_of_any_unit_has_the_same_fit():
    """Times ten times slower, and a held frequency: the coefficients are the same."""
    angle = exact(model_of(FIVE)) + NOISE * np.random.default_rng(1).standard_normal(len(TIME))
    fits = []
    for factor in (1.0, 10.0):
        path = path_of(factor * TIME, angle, W / factor, WHITE)
        trials = [TrialEffect(force, {}) for force in BASE]
        fits.append(fit_model([path], trials, frequency_free=False))
    np.testing.assert_allclose(fits[0].coefficients, fits[1].coefficients, rtol=1e-6, atol=1e-9)
    assert fits[0].deviance == pytest.approx(fits[1].deviance, abs=1e-3)
    assert not fits[0].covariance_with_frequency()[-1].any()


@pytest.mark.parametrize("curve", [-1.2, 1.2])
def test_strong_errors_of_the_sensor_are_fitted(curve):
    """The record rises by a quarter of the angle on one side, nearly twice as fast as it on the other."""
    base = {"zeta": 4e-3, "epsilon": 0.2}
    run = with_effect({"sensor_curve": curve}, seed=2, base=base)
    model = start_model([run], library(*base, "sensor_curve"))
    assert model.settled
    assert np.all(np.abs(deviations(model, base | {"sensor_curve": curve})) < 4.5)


@pytest.mark.parametrize(
    ("base", "shutter", "amplitude", "noise", "per_period", "periods"),
    [
        ({"lambda": 2e-4, "zeta": 3.3e-3, "delta": 0.144, "nu": -5.6}, 25.3, 0.03, 1e-4, 24, 16),
        ({"zeta": 0.01, "delta": 0.018, "nu": 0.1, "epsilon": -0.16}, -0.89, 0.77, 3e-4, 25, 14),
    ],
)
def test_a_strong_error_of_the_sensor_is_no_random_force(
    base, shutter, amplitude, noise, per_period, periods
):
    """A path through the record has the error in it: it is led by the model at first."""
    time = np.arange(periods * per_period) * 2.0 * np.pi / W / per_period
    angle = exact(model_of({**base, "shutter": shutter}), time, amplitude)
    angle += noise * np.random.default_rng(1).standard_normal(len(time))
    run = xr.Dataset({"angle": ("time", angle)}, {"time": time})
    start = start_model([run], library(*base))
    fitted = Fits(start).of(start, (), [TrialEffect(EVERY["shutter"], {})])
    assert start.likelihood.ratios[0] > 1e3
    assert fitted.likelihood.ratios[0] == 0.0
    truth = base | {"shutter": shutter}
    referred = refitted(fitted)
    assert np.all(np.abs(deviations(referred, truth)) < 4.5)


def test_a_narrow_resonance_stays_where_it_is_with_another_reference_frequency():
    """Its frequency is in units of the reference, which is off by many of its widths."""
    truth = {"zeta": 4e-3, "resonator": 0.1}
    shapes = {"resonator.k": 2.1, "resonator.d": 5e-3}
    run = with_effect({"resonator": 0.1}, seed=3, base={"zeta": 4e-3}, shapes=shapes)
    trials, first = trials_with(model_of(truth, shapes))
    near = path_of(TIME, run.angle.values, W, WHITE).rescaled(0.94 * W)
    factor = 0.94
    away = fit_model(
        [near],
        [trial.referred(factor) for trial in trials],
        frequency_free=True,
        first=np.append(first[:-1] * factor ** np.array([-1.0, -4.0]), factor**-2 - 1.0),
    )
    again = refitted(away)
    assert away.settled
    assert again.settled
    assert again.deviance == pytest.approx(away.deviance, abs=0.5)
    assert again.rows[0].path.frequency == pytest.approx(W, rel=2e-3)
    k = [model.trials[1].shapes["resonator.k"] * model.rows[0].path.frequency for model in (away, again)]
    assert k[1] == pytest.approx(k[0], rel=1e-3)
    assert abs(k[1] / W - 2.1) < 4.5 * again.shape_errors()["resonator.k"]
    assert np.all(np.abs(deviations(again, truth)) < 4.5)


@pytest.mark.slow
@pytest.mark.parametrize("turns", np.linspace(-0.5, 0.5, 7))
def test_a_phase_is_fitted_wherever_it_is(turns):
    """A phase has no end: from 3 rad on the way to -3 rad is short. Half a turn off, the sign changes."""
    truth, line = 2e-3, {"ambient.W": 1.7 * W, "ambient.p": 2.0 * np.pi * turns}
    run = with_effect({"ambient": truth}, seed=2, base={"zeta": 4e-3}, shapes=line)
    candidates = trials_of([EVERY["ambient"]], [1.7 * W], W)
    off = [np.sin(line["ambient.p"] - trial.shapes["ambient.p"]) for trial in candidates]
    for at in np.argsort(np.abs(off))[:4]:
        path = path_of(TIME, run.angle.values, W, WHITE)
        trials = [TrialEffect(EVERY["zeta"], {}), candidates[at]]
        model = fit_model([path], trials, frequency_free=True)
        phase = model.trials[1].shapes["ambient.p"]
        assert model.settled
        assert not model.at_ends
        assert abs(phase) < 3.2
        expected = truth * np.exp(1j * line["ambient.p"])
        error = errors_of(model)["ambient"] + truth * model.shape_errors()["ambient.p"]
        assert abs(model.coefficients[1] * np.exp(1j * phase) - expected) < 4.5 * error
