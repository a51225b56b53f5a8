"""What a record could show: the weakest effect it would detect, and effects that it could not tell apart."""

from collections.abc import Iterable
from operator import attrgetter

import numpy as np
import xarray as xr

from sysid_trib.discrepancy.model_probabilities import APART
from sysid_trib.discrepancy.score_tests import Scores
from sysid_trib.forces.force import Force
from sysid_trib.results.variables import PER_FORCE_UNIT, text_variable, variable

# An effect of this many standard errors is detected; of this many, its name is asked for.
DETECTED, NAMED = 5.0, 20.0


def detectability(scores: Scores) -> xr.Dataset:
    """Detectable coefficient of each candidate, and which are alike, from what the model cannot explain.

    Parameters
    ----------
    scores : Scores
        The candidates' score tests beside a model.

    Returns
    -------
    xr.Dataset
        Over `candidate`: `detectable`, the coefficient that would stand out by five standard errors (at the
        best value of its shape parameters, of those tried; nan if not testable), `independent_fraction` of
        its sensitivities that those of the model cannot make, `testable` and the `reason` why not; and
        `cosine(candidate, other)` between sensitivities, `alike` where two differ by less than a credible
        set spans if one of them has 20 standard errors.
    """
    symbols = list(dict.fromkeys(trial.force.symbol for trial in scores.trials))
    at = [_best(scores, symbol) for symbol in symbols]
    forces = [scores.trials[i].force for i in at]
    testable = np.array([not scores.reasons[i] for i in at])
    directions = scores.directions[:, at]
    cosine = np.abs(directions.T @ directions)
    np.fill_diagonal(cosine, 1.0)
    nearest = np.sqrt(1.0 - APART / NAMED**2)
    alike = (cosine > nearest) & testable[:, None] & ~np.eye(len(symbols), dtype=bool)
    size = scores.size[at]
    detectable = np.where(testable, DETECTED / np.where(size > 0.0, size, 1.0), np.nan)
    single, both = "candidate", ("candidate", "other")
    reasons = [scores.reasons[i] for i in at]
    fraction = "part of its sensitivities that the model's cannot make"
    texts = texts_of(forces, ("name", "family", "formula", "unit"))
    labels = {name: ("candidate", values) for name, values in texts.items()}
    return xr.Dataset(
        {
            "detectable": variable(single, detectable, "coefficient of five standard errors", PER_FORCE_UNIT),
            "independent_fraction": variable(single, scores.share[at], fraction, "1"),
            "testable": variable(single, testable, "whether the record can test it"),
            "reason": text_variable(single, reasons, "why it cannot be tested"),
            "alike": variable(both, alike, "whether the record could not tell the two apart"),
            "cosine": variable(both, cosine, "cosine between the sensitivities", "1"),
        },
        {"candidate": symbols, "other": symbols, **labels},
    )


def texts_of(forces: Iterable[Force], names: Iterable[str]) -> dict[str, list[str]]:
    """Texts of forces by the names that results give them."""
    paths = {"unit": "units", "formula": "formula.text"}
    return {name: list(map(attrgetter(paths.get(name, name)), forces)) for name in names}


def _best(scores: Scores, symbol: str) -> int:
    """Of a force's trials that can be tested the one of the largest information, else any."""
    mine = [i for i, trial in enumerate(scores.trials) if trial.force.symbol == symbol]
    good = [i for i in mine if not scores.reasons[i]]
    return max(good, key=lambda i: float(scores.size[i])) if good else mine[0]
