"""Which forces are kept: by significance, or by a sparsifying pysindy optimiser."""

import numpy as np
import pysindy
import pytest
from helpers import (
    EIGHT_MORE,
    FIVE,
    SIX,
    W,
    decay,
    library_of_formulas,
    names,
    paper_run,
    share_range,
    values,
)

from sysid_trib.errors import UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.likelihood.optimizers import ConstraintMap, SignificanceSelection
from sysid_trib.likelihood.rows import Rows
from sysid_trib.likelihood.solution import select
from sysid_trib.methods import Direct
from sysid_trib.results.schema import model_of

PAPER = paper_run()
FOURTEEN = ForceLibrary("fourteen", (*PAPER.model.library.forces, *library_of_formulas(**EIGHT_MORE).forces))
STRICT = Direct(W, significance=0.01)


def selected(optimizer, columns, y, nuisance=None):
    """What an optimiser keeps of white rows with one nuisance."""
    nuisances = np.ones((len(y), 1)) if nuisance is None else nuisance
    count = columns.shape[1]
    unbounded = np.full(count, np.inf)
    free = ConstraintMap(np.arange(count), np.eye(count), np.zeros(count), -unbounded, unbounded)
    return select(Rows(y, columns, nuisances, np.ones(count)), [optimizer], free)


def significant(columns, y, level):
    return selected(SignificanceSelection(level, removed_columns=1), columns, y)


@pytest.mark.in_full
def test_exactly_the_true_five_of_fourteen_are_kept():
    seeds, exact = 40, PAPER.angle
    results = [STRICT.identify(decay(PAPER.time, exact, seed), FOURTEEN) for seed in range(seeds)]
    kept = [names(FOURTEEN.symbols, result.active.values) for result in results]
    assert np.mean([found == set(FIVE) for found in kept]) >= share_range(seeds, 0.90, 0.05)[0]
    assert all(found >= set(FIVE) for found in kept)


def test_a_dropped_force_has_coefficient_zero_and_the_error_it_would_have_had():
    record = PAPER.decay(4)
    result = STRICT.identify(record, PAPER.model.library)
    alpha = result.sel(force="alpha")
    assert (alpha.active.item(), alpha.coefficient.item()) == (False, 0.0)
    assert "alpha" not in model_of(result).coefficients
    with_alpha = Direct(W).identify(record, PAPER.model.library)
    assert alpha.standard_error.item() == pytest.approx(
        with_alpha.standard_error.sel(force="alpha").item(), rel=0.05
    )
    without = Direct(W).identify(record, PAPER.model.library.select(FIVE))
    np.testing.assert_allclose(values(result, FIVE), values(without, FIVE), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(result.standard_error.sel(force=list(FIVE)), without.standard_error, rtol=1e-3)


def test_by_default_every_force_is_kept():
    result = Direct(W).identify(PAPER.decay(4), PAPER.model.library)
    assert result.active.values.all()
    assert np.all(result.coefficient.values != 0.0)


@pytest.mark.parametrize(
    "optimizer",
    [
        pysindy.STLSQ(threshold=3e-5, alpha=0.0),
        pysindy.SR3(reg_weight_lam=1e-9, relax_coeff_nu=1.0, regularizer="l0", max_iter=1000, tol=1e-12),
    ],
    ids=lambda optimizer: type(optimizer).__name__,
)
def test_a_sparsifying_optimiser_drops_what_is_small_and_comes_back_unchanged(optimizer):
    before = dict(optimizer.get_params())
    result = Direct(W, optimizer=optimizer).identify(PAPER.decay(4), PAPER.model.library)
    assert optimizer.get_params() == before
    assert not hasattr(optimizer, "coef_")
    kept = names(result.force.values, result.active.values)
    assert "alpha" not in kept
    assert kept >= {"zeta", "delta", "nu", "epsilon"}
    np.testing.assert_array_equal(result.coefficient.values[~result.active.values], 0.0)


def test_a_threshold_is_a_force_in_rad():
    """A force is dropped by its size along the motion, not by its coefficient."""
    sizes = {
        s: abs(c) * np.sqrt(np.mean(PAPER.model.library[s].value(*motion()) ** 2)) for s, c in SIX.items()
    }
    middle = np.sqrt(sizes["zeta"] * sizes["epsilon"])
    low, high = sorted(("zeta", "epsilon"), key=sizes.get)
    result = Direct(W, optimizer=pysindy.STLSQ(threshold=middle, alpha=0.0)).identify(
        PAPER.decay(4), PAPER.model.library
    )
    kept = names(result.force.values, result.active.values)
    assert high in kept
    assert "lambda" not in kept
    assert low not in kept


def motion():
    from sysid_trib.simulation.simulate import trajectory

    found = trajectory(PAPER.model, PAPER.time, PAPER.start, 0.0)
    return found.position, found.rate / W


def test_strong_form_selects_as_well():
    threshold = pysindy.STLSQ(threshold=1e-3, alpha=0.0)
    result = Direct(W, form="strong", optimizer=threshold).identify(
        PAPER.decay(4), PAPER.model.library.select(["lambda", "zeta", "epsilon", "alpha"])
    )
    assert names(result.force.values, result.active.values) >= {"zeta"}
    assert "lambda" not in names(result.force.values, result.active.values)


@pytest.mark.slow
def test_nothing_is_kept_of_noise():
    random = np.random.default_rng(0)
    kept = [
        significant(random.normal(size=(300, 8)), random.normal(size=300), 0.01).any() for _ in range(200)
    ]
    assert np.mean(kept) <= share_range(200, 0.01)[1]


def test_significance_finds_a_pair_that_cancels():
    # Each alone explains next to nothing; adding one by one would stop before the first.
    random = np.random.default_rng(1)
    a, b = random.normal(size=(2, 500))
    columns = np.column_stack([a, a + 0.05 * b, random.normal(size=500)])
    y = 20.0 * (columns[:, 1] - columns[:, 0]) + 0.3 * random.normal(size=500)
    assert significant(columns, y, 0.01).tolist() == [True, True, False]


@pytest.mark.slow
def test_a_looser_level_keeps_more():
    random = np.random.default_rng(3)
    columns = random.normal(size=(200, 30))
    y = random.normal(size=200)
    kept = [int(significant(columns, y, level).sum()) for level in (1e-3, 0.5, 0.999)]
    assert kept == sorted(kept)
    assert kept[0] == 0 < kept[2]


def test_nuisances_are_never_thresholded():
    random = np.random.default_rng(2)
    columns, nuisance = random.normal(size=(100, 2)), random.normal(size=(100, 1))
    y = columns @ [1.0, 0.05] + 0.01 * nuisance[:, 0]
    found = selected(pysindy.STLSQ(threshold=0.2, alpha=0.0), columns, y, nuisance)
    assert found.tolist() == [True, False]


@pytest.mark.parametrize("level", [0.0, 1.0, -0.1, float("nan")])
def test_level_is_a_probability(level):
    with pytest.raises(UsageError, match="between 0 and 1"):
        Direct(W, significance=level)
