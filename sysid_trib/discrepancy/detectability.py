"""What a record could show: the weakest effect it would detect, and effects that it could not tell apart."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.discrepancy.model_probabilities import APART
from sysid_trib.discrepancy.score_tests import Scores
from sysid_trib.results.variables import PER_FORCE_UNIT, text_variable, variable

Array = NDArray[np.float64]

# An effect of this many standard errors is detected; of this many, its name is asked for.
DETECTED = 5.0
NAMED = 20.0


def detectability(found: Scores) -> xr.Dataset:
    """Detectable strength of each candidate, and which are alike, from sensitivities outside of the model's.

    Returns
    -------
    Dataset over `candidate`: `detectable`, the coefficient that would stand out by five standard errors (at
    the best value of its shape parameters, of those tried; nan if not testable), `independent_fraction` of
    its sensitivities that those of the model cannot make, `testable` and the `reason` why not; and
    `cosine(candidate, other)` between sensitivities, `alike` where two differ by less than a credible set
    spans if one of them has 20 standard errors.
    """
    symbols = list(dict.fromkeys(probe.force.symbol for probe in found.probes))
    at = [_best(found, symbol) for symbol in symbols]
    forces = [found.probes[i].force for i in at]
    testable = np.array([not found.reasons[i] for i in at])
    directions = found.directions[:, at]
    cosine = np.abs(directions.T @ directions)
    np.fill_diagonal(cosine, 1.0)
    nearest = np.sqrt(1.0 - APART / NAMED**2)
    alike = (cosine > nearest) & testable[:, None] & ~np.eye(len(symbols), dtype=bool)
    size = found.size[at]
    detectable = np.where(testable, DETECTED / np.where(size > 0.0, size, 1.0), np.nan)
    one, both = "candidate", ("candidate", "other")
    reasons = [found.reasons[i] for i in at]
    fraction = "part of its sensitivities that the model's cannot make"
    return xr.Dataset(
        {
            "detectable": variable(one, detectable, "coefficient of five standard errors", PER_FORCE_UNIT),
            "independent_fraction": variable(one, found.share[at], fraction, "1"),
            "testable": variable(one, testable, "whether the record can test it"),
            "reason": text_variable(one, reasons, "why it cannot be tested"),
            "alike": variable(both, alike, "whether the record could not tell the two apart"),
            "cosine": variable(both, cosine, "cosine between the sensitivities", "1"),
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
