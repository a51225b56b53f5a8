"""Products of the columns of all runs for ratios of both noises near the likeliest ones."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

from sysid_trib.likelihood_fit.likelihood import Likelihood, likelihood
from sysid_trib.likelihood_fit.run_products import RunProducts

# Of a likely ratio, 0 where none is known; see `products_of`.
ProductsNear: TypeAlias = Callable[[float], RunProducts]
# Rounds in which the likeliest ratios of several runs are looked for beside each other.
TURNS = 6


def likeliest_near(
    runs: Sequence[ProductsNear], near: Sequence[float], columns: Sequence[int]
) -> tuple[list[RunProducts], Likelihood]:
    """Products of each run where they tell the likelihood exactly, and the likelihood of some columns.

    Parameters
    ----------
    runs : sequence of callable
        Products of each run, of ratios about a likely one.
    near : sequence of float
        Likely ratios, 0 where none is known.
    columns : sequence of int
        Of the table, from 1.

    Notes
    -----
    Between ratios that are far from each other a spline may be off by several units of the deviance, in which
    models are compared. Ratios all over the span are tried where none is known to be likely, and where the
    random force vanishes beside one that is.
    """
    everywhere = [not ratio for ratio in near]
    products = [run(ratio) for run, ratio in zip(runs, near, strict=True)]
    likeliest = likelihood(products, columns)
    for _ in range(TURNS):
        settled = True
        for at, ratio in enumerate(likeliest.ratios.tolist()):
            vanished = not ratio and not everywhere[at]
            if vanished or not products[at].is_close(ratio):
                everywhere[at] |= vanished
                products[at] = runs[at](ratio)
                settled = False
        if settled:
            break
        likeliest = likelihood(products, columns)
    return products, likeliest
