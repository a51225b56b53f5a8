"""Which effects are separately identifiable, and which others nearly cancel: these may imitate another."""

from collections.abc import Sequence

import numpy as np

from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.run_products import RunProducts
from sysid_trib.screening.columns_beside import projected


def collinear_effects(
    model: FittedModel, products: Sequence[RunProducts], effects: Sequence[str]
) -> list[str]:
    """Effects of a model that are collinear with others and not well enough determined to be named.

    Parameters
    ----------
    model : FittedModel
    products : sequence of RunProducts
        The model's columns come first.
    effects : sequence of str
        Symbols beside the start model's.

    Notes
    -----
    Several flexible forces fit nearly anything: that they do is no evidence for any of them.
    """
    if len(effects) < 2:
        return []
    every = {symbol: set(model.columns_of(symbol)) for symbol in effects}
    errors = np.sqrt(np.diag(model.likelihood.covariance))
    collinear = []
    for symbol in effects:
        at = model.columns_of(symbol)[0]
        others = set().union(*every.values())
        sizes = [
            projected(
                products, model.likelihood, [1 + c for c in range(model.columns) if c not in gone], [1 + at]
            )[0].item()
            for gone in (others, every[symbol])
        ]
        z = abs(model.coefficients[at]) / max(errors[at], 1e-300)
        if sizes[1] < model.settings.independent * sizes[0] and z < model.settings.determined:
            collinear.append(symbol)
    return collinear
