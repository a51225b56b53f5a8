"""What chance gains: where few rows tell the noise, and where a force acts more finely than is known."""

import numpy as np
import pytest
from discovery import EFFECTS, TIME, start_model, with_effect
from helpers import NOISE, W
from scipy.stats import chi2, t as student

from sysid_trib.discovery.columns_beside import each_beside
from sysid_trib.discovery.screen import screen
from sysid_trib.likelihood.likelihood import likelihood, of_many_rows
from sysid_trib.likelihood.row_noise import covariance_band
from sysid_trib.likelihood.run_products import RowNoise, products_of
from sysid_trib.likelihood.weak_form import build_weak_form, noise_operator

SAMPLES, LEVEL = 160, 0.01
FORM = build_weak_form(np.arange(SAMPLES) * 0.25)
OPERATOR = noise_operator(FORM, np.ones(SAMPLES), np.full(SAMPLES, 0.02))
BAND = covariance_band(OPERATOR @ OPERATOR.T)
ROW_NOISE = RowNoise(BAND, BAND, FORM, LEVEL)


@pytest.mark.parametrize("rows", [10.0, 25.0, 80.0, 1000.0])
@pytest.mark.parametrize("t", [2.0, 4.0, 6.0])
def test_a_gain_of_few_rows_has_the_tail_of_students_t(rows, t):
    gain = (rows + 3.0) * np.log1p(t**2 / rows)
    expected = 2.0 * student.sf(t, rows)
    assert np.log(chi2.sf(gain * of_many_rows(rows, 3), 1)) == pytest.approx(np.log(expected), abs=0.06)


def dense(band):
    """A covariance from its diagonals."""
    below = sum(np.diag(row[: band.shape[1] - k], -k) for k, row in enumerate(band))
    return below + np.tril(below, -1).T


def gains_of_chance(ratio, draws):
    """What a column without effect gains beside both noises, and its effective rows, (draw,) each."""
    random, tau = np.random.default_rng(5), FORM.tau[: FORM.rows]
    slow = np.linspace(-1.0, 1.0, FORM.rows)
    waves = [slow**k * wave(tau) for k in range(3) for wave in (np.cos, np.sin)]
    factor = np.linalg.cholesky(dense(BAND) + ratio * dense(FORM.gram))
    gains, rows = np.empty((2, draws))
    for draw in range(draws):
        noise = LEVEL * factor @ random.standard_normal(FORM.rows)
        run = products_of(ROW_NOISE, np.column_stack([noise, *waves]))
        without = likelihood([run], range(1, 6))
        beside = each_beside([run], range(1, 6), [6], without)
        gains[draw], rows[draw] = without.deviance - beside.deviance[0], beside.effective_rows[0]
    return np.maximum(gains, 0.0), rows


@pytest.mark.slow
def test_chance_gains_no_more_than_is_told_where_few_rows_tell_a_random_force():
    gains, rows = gains_of_chance(ratio=0.1, draws=200)
    assert np.median(rows) < 0.6 * FORM.rows
    assert np.mean(chi2.sf(gains, 1) < 0.01) > 0.02
    assert np.mean(chi2.sf(gains * of_many_rows(rows, 6), 1) < 0.01) < 0.02
    assert np.mean(chi2.sf(gains * of_many_rows(rows, 6), 1) < 0.1) > 0.05


def pushed(seed, size=3.0):
    """A record with a random force that shows."""
    rng = np.random.default_rng(seed)
    run = with_effect({}, seed=seed)
    step = W * (TIME[1] - TIME[0])
    # Pushes of a free swing of the mean frequency: a random walk of its two free motions.
    tau = W * TIME
    pushes = size * NOISE * np.sqrt(step) * rng.standard_normal(len(tau))
    inside = np.cumsum(pushes * np.cos(tau)), np.cumsum(pushes * np.sin(tau))
    run["angle"] = run.angle + np.sin(tau) * inside[0] - np.cos(tau) * inside[1]
    return run


@pytest.mark.in_full
def test_a_drawn_deviation_has_the_uncertainty_of_the_motion():
    model = start_model([pushed(1)])
    rows, ratio = model.rows[0], float(model.likelihood.ratios[0])
    still = (np.zeros(len(TIME)),) * 2
    random = np.random.default_rng(2)
    drawn = np.array([rows.possible_deviation(1.0, still, ratio, random) for _ in range(300)])
    design = rows.path.form.splines.design()
    force = np.linalg.inv(ratio * dense(rows.path.form.gram))
    felt = (rows.operator @ design).toarray()
    covariance = np.linalg.inv((design.T @ design).toarray() + felt.T @ force @ felt)
    expected = np.sqrt(np.einsum("ij,jk,ik->i", design.toarray(), covariance, design.toarray()))
    assert ratio > 0.0
    assert np.mean(drawn, axis=0) == pytest.approx(0.0, abs=5.0 * expected.max() / np.sqrt(300.0))
    np.testing.assert_allclose(np.sqrt(np.mean(drawn**2, axis=0)), expected, rtol=0.25)


def test_what_acts_more_finely_than_a_pushed_motion_is_known_is_not_tested():
    (force,) = EFFECTS.select(["stribeck"])
    known = {}
    for name, run in {"pushed": pushed(1), "free": with_effect({}, seed=1)}.items():
        found = screen(start_model([run]), [force])
        shapes = [trial.shapes["stribeck.s"] for trial in found.trials]
        known[name] = dict(zip(shapes, found.are_fine(range(len(shapes))), strict=True))
    assert not known["pushed"][min(known["pushed"])]
    # Wider than the speed it is what viscous friction can make, but for little.
    assert all(fine for s, fine in known["pushed"].items() if 0.05 < s < 0.3)
    assert all(known["free"].values())
