"""Candidates of several shapes: they are seen and fitted though no value of their grids is near."""

from dataclasses import replace

import pytest
from discovery import EFFECTS, W, start_model, with_effect

from sysid_trib.discovery import shapes as shape_climb
from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import screen
from sysid_trib.discovery.shapes import climbed
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect, trials_of

LUGRE, DAHL = EFFECTS.select(["lugre", "dahl"])
SHAPES = {"lugre.s": 0.008, "lugre.r": 1.5, "lugre.u": 0.04}


def screened(seed):
    return screen(start_model([with_effect({"lugre": 0.01}, shapes=SHAPES, seed=seed)]), [LUGRE, DAHL])


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_fit_of_three_shapes_settles_at_the_truth(seed):
    screening = screened(seed)
    fits = Fits(screening.model)
    trial_of = {screening.trials[at].force.symbol: screening.trials[at] for at in screening.best()}
    found, dahl = (fits.of(screening.model, (), [trial_of[name]]) for name in ("lugre", "dahl"))
    assert found.deviance < dahl.deviance - DEFAULTS.far
    # The start model's frequency is higher, by the bristles.
    truth = TrialEffect(LUGRE, SHAPES).referred(found.rows[0].path.frequency / W).shapes
    errors = found.shape_errors()
    for name, value in found.trials[-1].shapes.items():
        assert abs(value - truth[name]) < 4.0 * errors[name], name


def test_where_a_fit_fails_it_starts_from_others():
    model, truth = screened(0).model, TrialEffect(LUGRE, SHAPES)
    # Without a peak in reach of the record it is a Dahl friction, and its fit stays one.
    astray = TrialEffect(LUGRE, {"lugre.s": 0.0014, "lugre.r": 5.0, "lugre.u": 1.0})
    worst = Fits(model).of(model, (), [truth]).deviance + DEFAULTS.far
    fits = Fits(model)
    assert fits.of(model, (), [astray], worst).deviance > worst
    fitted = fits.of(model, (), [replace(astray, starts=(truth,))], worst)
    assert fitted.deviance < worst
    assert fits.of(model, (), [astray], worst) is fitted
    assert fits.failed == []


def test_its_column_gains_more_than_those_of_the_grid():
    screening = screened(0)
    model, gains = screening.model, screening.gains
    (top,) = climbed(model, [LUGRE])
    grid = trials_of([LUGRE], (), model.rows[0].path.frequency)
    of_shapes = {str(t.shapes): gain for t, gain in zip(screening.trials, gains.tolist(), strict=True)}
    assert of_shapes[str(top.shapes)] > 1.2 * max(of_shapes[str(trial.shapes)] for trial in grid)


def test_nothing_is_climbed_where_nothing_is_hidden_nor_along_frequencies():
    model = start_model([with_effect({}, seed=3)])
    assert climbed(model, [LUGRE]) == []
    pushed = start_model([with_effect({"lugre": 0.01}, shapes=SHAPES, seed=0)])
    assert climbed(pushed, EFFECTS.select(["ambient", "resonator", "dahl"])) == []


def test_it_is_seen_in_the_place_of_another_though_no_coarse_combination_is_near():
    """Friction of short bristles: its fits beside the start model may fail, those beside Dahl do not."""
    shapes = {"lugre.s": 0.003, "lugre.r": 1.0, "lugre.u": 0.02}
    start = start_model([with_effect({"lugre": 0.01}, shapes=shapes, seed=0)])
    dahl = Fits(start).of(start, (), [TrialEffect(DAHL, {"dahl.s": 0.005})])
    of_dahl, grid = shape_climb._gain_of(dahl, ["dahl"]), trials_of([LUGRE], (), W)
    assert shape_climb._gains(dahl, grid, ["dahl"]).max() < 0.2 * of_dahl
    (top,) = climbed(dahl, [LUGRE], ("dahl",))
    assert shape_climb._gains(dahl, [top], ["dahl"])[0] > of_dahl
