"""Which effects stand by themselves, and which lean on each other and may imitate what has no name."""

from collections.abc import Sequence

import numpy as np

from sysid_trib.discrepancy.baseline import Baseline, orthonormal_basis, project_out

# An effect leans on others if less than this part of its response is outside of what they can move.
LEANS = 0.5
# Leaning effects are told apart if each is determined to so many standard errors: two arbitrary ones that a
# fit combines to imitate a third nearly cancel, and are not.
DETERMINED = 30.0


def collinear_effects(baseline: Baseline, added: Sequence[str]) -> list[str]:
    """Effects of a model that lean on others and are not well enough determined for their names to stand.

    Notes
    -----
    Several flexible forces fit nearly anything: that they do is no evidence for any of them. Of each effect,
    the part of its response beside the start model's is compared with the part beside the other effects too.
    """
    if len(added) < 2:
        return []
    parameters = baseline.problem.parameters
    errors = np.sqrt(np.diag(baseline.covariance))
    found = []
    for symbol in added:
        at = parameters.index(symbol)
        alone, beside = (
            float(
                np.linalg.norm(
                    project_out(
                        baseline.table[:, at],
                        orthonormal_basis(parameters.remove(gone).take(parameters, baseline.table)),
                    )
                )
            )
            for gone in (added, [symbol])
        )
        z = abs(baseline.values[at]) / max(errors[at], 1e-300)
        if beside < LEANS * alone and z < DETERMINED:
            found.append(symbol)
    return found
