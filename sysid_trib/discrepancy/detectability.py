"""What a record could show: the weakest effect it would detect, and effects that it could not tell apart."""

from collections.abc import Iterable
from operator import attrgetter

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force
from sysid_trib.results.variables import PER_FORCE_UNIT, text_variable, variable
from sysid_trib.screening.screen import Screening

# An effect of this many standard errors is detected; of this many, its name is asked for.
DETECTED, NAMED = 5.0, 20.0


def detectability(screening: Screening) -> xr.Dataset:
    """Detectable coefficient of each candidate, and which are alike, from what the model cannot explain.

    Parameters
    ----------
    screening : Screening
        The candidates beside a model.

    Returns
    -------
    xr.Dataset
        Over `candidate`: `detectable`, the coefficient that would stand out by five standard errors (at the
        best value of its shape parameters, of those tried; nan if not testable), `independent_fraction` of
        its column that those of the model cannot make, `testable` and the `reason` why not; and
        `cosine(candidate, other)` between what is outside of the model's columns, `alike` where two differ by
        less than a credible set spans if one of them has 20 standard errors.
    """
    trials = screening.trials
    symbols = list(dict.fromkeys(trial.force.symbol for trial in trials))
    at = [_best(screening, symbol) for symbol in symbols]
    places = np.array(at, dtype=int)
    forces = [trials[i].force for i in at]
    # Where every candidate was added there is none.
    testable = np.array([not screening.reasons[i] for i in at], dtype=bool)
    cosine = np.abs(screening.correlation[np.ix_(places, places)])
    np.fill_diagonal(cosine, 1.0)
    nearest = np.sqrt(1.0 - screening.model.settings.outside_of_set / NAMED**2)
    alike = (cosine > nearest) & testable[:, None] & testable & ~np.eye(len(symbols), dtype=bool)
    detectable = np.where(testable, DETECTED * screening.errors[places], np.nan)
    single, both = "candidate", ("candidate", "other")
    reasons = [screening.reasons[i] for i in at]
    fraction = "part of its column that the model's cannot make"
    texts = texts_of(forces, ("name", "family", "formula", "unit"))
    labels = {name: ("candidate", values) for name, values in texts.items()}
    return xr.Dataset(
        {
            "detectable": variable(single, detectable, "coefficient of five standard errors", PER_FORCE_UNIT),
            "independent_fraction": variable(single, screening.outside[places], fraction, "1"),
            "testable": variable(single, testable, "whether the record can test it"),
            "reason": text_variable(single, reasons, "why it cannot be tested"),
            "alike": variable(both, alike, "whether the record could not tell the two apart"),
            "cosine": variable(both, cosine, "cosine between the columns", "1"),
        },
        {"candidate": symbols, "other": symbols, **labels},
    )


def texts_of(forces: Iterable[Force], names: Iterable[str]) -> dict[str, list[str]]:
    """Texts of forces by the names that results give them."""
    paths = {"unit": "units", "formula": "formula.text"}
    return {name: list(map(attrgetter(paths.get(name, name)), forces)) for name in names}


def _best(screening: Screening, symbol: str) -> int:
    """Of a force's trials that can be tested the one of the least error, in units of its force; else any."""
    of_force = [i for i, trial in enumerate(screening.trials) if trial.force.symbol == symbol]
    good = [i for i in of_force if not screening.reasons[i]]
    size = screening.errors * screening.relative_force
    return min(good, key=lambda i: float(size[i])) if good else of_force[0]
