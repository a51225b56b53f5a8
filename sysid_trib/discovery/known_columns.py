"""What of columns is outside of a model's, and which columns are known along a motion that noise hides."""

from collections.abc import Sequence

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.run_products import has_products
from sysid_trib.likelihood.trials import TrialEffect


def base_of(model: FittedModel, effects: Sequence[str] = ()) -> Array:
    """Orthonormal base of the model's columns, those of `effects` left out, (row, column)."""
    kept = model.columns_without(effects)
    return np.linalg.qr(np.vstack([table[:, kept] for table in model.white_tables()]))[0]


def outside_of(
    model: FittedModel, columns: Sequence[Array], base: Array | None = None
) -> tuple[Array, Array]:
    """What of columns is outside of the model's, and which part of each.

    Parameters
    ----------
    model : FittedModel
    columns : sequence of (row, column) array of float
        Of each run.
    base : (row, base_column) array of float, optional
        Of the model's columns, or of some: `base_of`; by default of all.

    Returns
    -------
    outside : (row, column) array of float
        In units of the noise.
    part : (column,) array of float
    """
    base = base_of(model) if base is None else base
    white = np.vstack(
        [
            rows.whitened(np.where(has_products(column), column, 0.0), model.likelihood, at)
            for at, (rows, column) in enumerate(zip(model.rows, columns, strict=True))
        ]
    )
    rest = white - base @ (base.T @ white)
    return rest, np.linalg.norm(rest, axis=0) / np.maximum(np.linalg.norm(white, axis=0), 1e-300)


def known_finely(
    model: FittedModel, columns: Sequence[Array], aside: Sequence[Array], effects: Sequence[str] = ()
) -> Mask:
    """True if columns are the same along a motion that is as likely, (column,).

    Parameters
    ----------
    model : FittedModel
    columns, aside : sequence of (row, column) array of float
        Of each run, along its path and along one of `model.possible_rows`.
    effects : sequence of str
        Of the model, which these may replace: with them they need not be told apart.

    Notes
    -----
    With a random force a motion is known as well as the sensor tells it. What a column gains along the path
    is its square correlation with the one along the motion: but for a part that `tolerance` allows.
    """
    base = base_of(model, effects)
    (here, part), (there, _) = (outside_of(model, tables, base) for tables in (columns, aside))
    return _alike(here, there, model.settings.tolerance) | (part < model.settings.testable)


def are_known_finely(model: FittedModel, trials: Sequence[TrialEffect], effects: Sequence[str]) -> Mask:
    """`known_finely` of trials; without a random force of all."""
    if not np.any(model.likelihood.ratios):
        return np.ones(len(trials), dtype=bool)
    # Drawn again, and not kept with each screening: they are as large as the rows of the model.
    possible = model.possible_rows(np.random.default_rng(model.settings.seed))
    here, aside = ([run.coarse_columns(trials) for run in rows] for rows in (model.rows, possible))
    return known_finely(model, here, aside, effects)


def known_directions(model: FittedModel, columns: Sequence[Array], aside: Sequence[Array]) -> Array:
    """Mixtures of columns that are the same along a motion that is as likely, (column, direction).

    Of directions outside of the model's columns that are orthogonal in its noise. Parameters as of
    `known_finely`: columns that differ little may be known though their difference is not.
    """
    base = base_of(model)
    (here, part), (there, _) = (outside_of(model, tables, base) for tables in (columns, aside))
    length = np.where(part < model.settings.testable, np.inf, np.linalg.norm(here, axis=0))
    _, size, mixtures = np.linalg.svd(here / length, full_matrices=False)
    mixtures = mixtures[size > model.settings.testable * size[0]].T / length[:, None]
    return mixtures[:, _alike(here @ mixtures, there @ mixtures, model.settings.tolerance)]


def _alike(here: Array, there: Array, tolerance: float) -> Mask:
    """True if columns correlate but for such a part of their squares, (column,)."""
    along = np.einsum("ij,ij->j", here, there)
    return along >= np.sqrt(1.0 - tolerance) * np.linalg.norm(here, axis=0) * np.linalg.norm(there, axis=0)
