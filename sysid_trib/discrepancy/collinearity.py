"""Which effects are separately identifiable, and which are collinear and may imitate what has no name."""

from collections.abc import Sequence

import numpy as np

from sysid_trib.discrepancy.baseline import Baseline, orthonormal_basis, project_out

# An effect is collinear if less than this part of its sensitivities is outside of those of the others.
INDEPENDENT = 0.5
# Collinear effects can still be named if each is determined to so many standard errors: two arbitrary ones
# that a fit combines to imitate a third nearly cancel, and are not.
DETERMINED = 30.0


def collinear_effects(baseline: Baseline, added: Sequence[str]) -> list[str]:
    """Effects of a model that are collinear with others and not well enough determined to be named.

    Parameters
    ----------
    baseline : Baseline
        The model fitted.
    added : sequence of str
        Symbols of its effects beside the start model.

    Notes
    -----
    Several flexible forces fit nearly anything: that they do is no evidence for any of them. Of each effect,
    the part of its sensitivities outside of the start model's is compared with the part outside of the other
    effects' too.
    """
    if len(added) < 2:
        return []
    parameters = baseline.problem.parameters
    errors = np.sqrt(np.diag(baseline.covariance))
    collinear = []
    for symbol in added:
        at = parameters.index(symbol)
        outside_start, outside_others = (_outside(baseline, at, removed) for removed in (added, [symbol]))
        z = abs(baseline.values[at]) / max(errors[at], 1e-300)
        if outside_others < INDEPENDENT * outside_start and z < DETERMINED:
            collinear.append(symbol)
    return collinear


def _outside(baseline: Baseline, at: int, removed: Sequence[str]) -> float:
    """Size of a parameter's sensitivities outside of the others', without the forces `removed`."""
    parameters = baseline.problem.parameters
    others = parameters.remove(removed).take(parameters, baseline.table)
    return float(np.linalg.norm(project_out(baseline.table[:, at], orthonormal_basis(others))))
