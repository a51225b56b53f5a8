"""What a record could show: the weakest effect it would detect, and effects that it could not tell apart."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.discrepancy.model_probabilities import APART
from sysid_trib.discrepancy.score_tests import Scores

Array = NDArray[np.float64]

# An effect of this many standard errors is detected; of this many, its name is asked for.
DETECTED = 5.0
NAMED = 20.0


def detectability(found: Scores) -> xr.Dataset:
    """Detectable strength and ties of each candidate, from the responses outside of the model's.

    Returns
    -------
    Dataset over `candidate`: `detectable`, the coefficient that would stand out by five standard errors (at
    the best value of its shape parameters, of those tried; nan if not testable), `share` of its response that
    the model cannot move itself, `reason` why it cannot be tested, `tied_with`; and `tie(candidate, other)`,
    the cosine between responses. Two are tied that differ by less than a tie class spans if one of
    them has 20 standard errors.
    """
    symbols = list(dict.fromkeys(probe.force.symbol for probe in found.probes))
    at = [_best(found, symbol) for symbol in symbols]
    forces = [found.probes[i].force for i in at]
    testable = np.array([not found.reasons[i] for i in at])
    directions = found.directions[:, at]
    cosine = np.abs(directions.T @ directions)
    np.fill_diagonal(cosine, 1.0)
    nearest = np.sqrt(1.0 - APART / NAMED**2)
    ties = [
        "; ".join(s for j, s in enumerate(symbols) if j != i and testable[i] and cosine[i, j] > nearest)
        for i in range(len(symbols))
    ]
    size = found.size[at]
    detectable = np.where(testable, DETECTED / np.where(size > 0.0, size, 1.0), np.nan)
    unit = {"units": "see the coordinate unit"}
    return xr.Dataset(
        {
            "detectable": (
                "candidate",
                detectable,
                unit | {"long_name": "coefficient of five standard errors"},
            ),
            "share": ("candidate", found.share[at], {"units": "1", "long_name": "part outside of the model"}),
            "reason": ("candidate", [found.reasons[i] for i in at], {"long_name": "why it cannot be tested"}),
            "tied_with": ("candidate", ties, {"long_name": "candidates that look the same"}),
            "tie": (("candidate", "other"), cosine, {"units": "1", "long_name": "cosine between responses"}),
        },
        {
            "candidate": symbols,
            "other": symbols,
            "name": ("candidate", [f.name for f in forces]),
            "family": ("candidate", [f.family for f in forces]),
            "formula": ("candidate", [f.formula.text for f in forces]),
            "unit": ("candidate", [f.units for f in forces]),
        },
    )


def _best(found: Scores, symbol: str) -> int:
    """Of a force's probes that can be tested the one with the largest response, else any."""
    mine = [i for i, probe in enumerate(found.probes) if probe.force.symbol == symbol]
    good = [i for i in mine if not found.reasons[i]]
    return max(good, key=lambda i: float(found.size[i])) if good else mine[0]
