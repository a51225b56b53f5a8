"""What chance gains: where few rows tell the noise, and where a force acts more finely than is known."""

from dataclasses import replace

import numpy as np
import pytest
from discovery import CONTACT, EFFECTS, EVERY, TIME, start_model, with_effect
from helpers import NOISE, W
from scipy.stats import chi2, t as student

from sysid_trib.discovery import omnibus_test
from sysid_trib.discovery.columns_beside import each_beside
from sysid_trib.discovery.omnibus_test import trial_columns, trial_names
from sysid_trib.discovery.screen import TOO_FINE, screen
from sysid_trib.discovery.simulated_gains import known_directions, known_finely, outside_of
from sysid_trib.likelihood.likelihood import likelihood, of_many_rows
from sysid_trib.likelihood.row_noise import covariance_band
from sysid_trib.likelihood.run_products import RowNoise, products_of
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect
from sysid_trib.likelihood.weak_form import build_weak_form, noise_operator

SAMPLES, LEVEL = 160, 0.01
FORM = build_weak_form(np.arange(SAMPLES) * 0.25)
OPERATOR = noise_operator(FORM, np.ones(SAMPLES), np.full(SAMPLES, 0.02))
BAND = covariance_band(OPERATOR @ OPERATOR.T)
ROW_NOISE = RowNoise(BAND, BAND, FORM, LEVEL)
QUINTIC = TrialEffect(EVERY["quintic"], {})
NARROW = TrialEffect(EVERY["stribeck"], {"stribeck.s": 1e-3})


@pytest.mark.parametrize("rows", [10.0, 25.0, 80.0, 1000.0])
@pytest.mark.parametrize("t", [2.0, 4.0, 6.0])
def test_a_gain_of_few_rows_has_the_tail_of_students_t(rows, t):
    gain = (rows + 3.0) * np.log1p(t**2 / rows)
    expected = 2.0 * student.sf(t, rows)
    assert np.log(chi2.sf(gain * of_many_rows(rows, 3), 1)) == pytest.approx(np.log(expected), abs=0.06)


def test_more_rows_leave_less_to_chance():
    assert 0.0 < of_many_rows(2.0, 9) < of_many_rows(12.0, 9) < of_many_rows(1e9, 9) <= 1.0


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


def test_chance_gains_no_more_than_is_told_where_few_rows_tell_a_random_force():
    gains, rows = gains_of_chance(ratio=0.1, draws=400)
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


def test_the_best_trial_that_is_too_fine_gives_way_to_the_next():
    (force,) = EFFECTS.select(["stribeck"])
    found = screen(start_model([pushed(1)]), [force])
    order = np.argsort([trial.shapes["stribeck.s"] for trial in found.trials]).tolist()
    assert not found.are_fine(order[:1])[0]
    (first,) = found.first_fine(order)
    assert found.are_fine([first]) == [True]
    assert not any(found.are_fine(order[: order.index(first)]))
    fine = np.array(found.are_fine(range(len(order))))
    found_too_fine = screen(start_model([pushed(1)]), [force], ())
    asked = [at for at, known in found_too_fine.fine.items() if not known]
    assert all(not fine[at] for at in asked)
    assert all(found_too_fine.reasons[at] == TOO_FINE and found_too_fine.gains[at] == 0.0 for at in asked)


def alike_but_for_a_narrow_peak(rows, part):
    """Columns of a quintic force, and of the same with a little friction in a narrow range of speeds."""
    wide, narrow = rows.coarse_columns([QUINTIC, NARROW]).T
    return np.stack([wide, wide + part * narrow], axis=1)


@pytest.mark.parametrize(("name", "expected"), [("pushed", 1), ("free", 2)])
def test_columns_may_be_known_and_their_difference_not(name, expected):
    model = start_model([{"pushed": pushed(1), "free": with_effect({}, seed=1)}[name]])
    possible = model.possible_rows(np.random.default_rng(0))
    sizes = []
    for trial in (QUINTIC, NARROW):
        outside, _ = outside_of(model, [rows.coarse_columns([trial]) for rows in model.rows])
        sizes.append(np.linalg.norm(outside))
    part = 0.1 * sizes[0] / sizes[1]
    along = [alike_but_for_a_narrow_peak(rows, part) for rows in model.rows]
    aside = [alike_but_for_a_narrow_peak(rows, part) for rows in possible]
    assert np.all(known_finely(model, along, aside))
    mixtures = known_directions(model, along, aside)
    assert mixtures.shape == (2, expected)
    outside, _ = outside_of(model, [columns @ mixtures for columns in along])
    products = outside.T @ outside
    assert products == pytest.approx(np.diag(np.diag(products)), abs=1e-6 * products.max())


def test_the_omnibus_test_leaves_out_what_a_model_makes_itself():
    model = start_model([with_effect({}, seed=1)])
    along = [trial_columns(rows.path) for rows in model.rows]
    mixtures = known_directions(model, along, along)
    of_model = [name in ("r^1 cos 1 phi", "r^1 sin 1 phi") for name in trial_names()]
    assert np.all(mixtures[of_model] == 0.0)
    assert 30 < mixtures.shape[1] <= 34


@pytest.mark.parametrize(("strongest", "missing"), [(1.0, True), (1e-9, False)])
def test_a_missing_force_of_no_name_is_no_stronger_than_one_of_a_name(strongest, missing, monkeypatch):
    for other in ("_strongest_line", "_largest_part"):
        monkeypatch.setattr(omnibus_test, other, lambda residuals: 1.0)
    run = with_effect({"even_spring": 0.01}, seed=1, base={"zeta": 4e-3})
    model = start_model([run], CONTACT.select(["zeta"]), replace(DEFAULTS, strongest=strongest))
    along = trial_columns(model.rows[0].path)
    products = [model.rows[0].products(np.column_stack([model.tables[0], along]))]
    whole = likelihood(products, range(1, 1 + model.columns))
    even = [trial_names().index(name) for name in ("r^2", "r^2 cos 2 phi")]
    mixtures = (np.eye(along.shape[1]) / np.linalg.norm(along, axis=0))[:, even]
    test = omnibus_test.omnibus(products, [along], np.zeros(along.shape[1], bool), mixtures, model, whole)
    assert (test.p_value < 1e-6) == missing
