"""How far two identifications of one decay differ, and what they cannot tell apart."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.averaging.identifiability import exactly_dependent, indistinguishable, without_signature
from sysid_trib.results.common_reference import ASYMPTOTIC_FREQUENCY, comparable, comparison_values
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.results.variables import chi_square_test, variable
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion
from sysid_trib.validation.homogeneity import MIXED_UNITS
from sysid_trib.validation.progress import Tell
from sysid_trib.validation.simulated_pairs import Scatter, scatter


def comparison(
    runs: Sequence[xr.Dataset],
    results: Sequence[xr.Dataset],
    motions: Sequence[Sequence[FittedMotion | None]],
    *,
    draws: int,
    seed: int,
    tell: Tell,
) -> xr.Dataset:
    """Difference of two identifications, force by force and as a whole (see `cross_check`).

    `motions` : of each result, in each run.
    """
    second = results[1]
    kept = comparable(*results)
    # The second's model is the truth of the simulated records, or the first's if that has no motion.
    # Where a bias could not be removed, what to expect is not known.
    failed = any(str(r.attrs.get("first_order_bias_removed", "")).startswith("no:") for r in results)
    computed = [[motion for motion in of_result if motion is not None] for of_result in motions]
    pairs = zip(results[::-1], computed[::-1], strict=True)
    moving = [pair for pair in pairs if len(pair[1]) == len(runs)]
    truth = moving[0][0] if moving else second
    frequency = truth.reference_frequency.item()
    difference = np.subtract(*(comparison_values(result, kept, frequency) for result in results))
    count = len(difference)
    known = Scatter.missing(count, 0)
    if moving and not failed:
        known = scatter(runs, results, moving[0], kept, draws=draws, seed=seed, tell=tell)
    error = np.sqrt(np.diag(known.covariance))
    excess = difference - known.expected
    # One method with and without its bias: nothing else differs.
    z = np.divide(excess, error, out=np.zeros_like(excess), where=error != 0.0)
    chi_square, p_value = known.chi_square(difference)
    variables = {
        "difference": variable("quantity", difference, "first method minus second", MIXED_UNITS),
        "expected_difference": variable(
            "quantity", known.expected, "difference of the methods' biases", MIXED_UNITS
        ),
        "standard_error": variable("quantity", error, "standard error of the difference", MIXED_UNITS),
        "z": variable("quantity", z, "excess over its standard error", "1"),
        **chi_square_test((), chi_square, count, "chi-square of all differences", p_value),
    }
    compared = xr.Dataset(variables, {"quantity": [*kept, ASYMPTOTIC_FREQUENCY]})
    compared.attrs["errors"] = "stated" if known.stated else "simulated"
    # Where the motion is pushed some records may not be identified.
    return compared.assign_attrs(simulated_records=known.records)


def ties(runs: Sequence[xr.Dataset], result: xr.Dataset) -> dict[str, str]:
    """Forces that averaging, or any method, cannot tell apart by principle."""
    library = library_of(result)
    shapes = model_of(result).shapes
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)

    def as_text(groups: Sequence[Sequence[str]]) -> str:
        return "; ".join(" = ".join(group) for group in groups)

    return {
        "averaging_cannot_tell_apart": as_text(indistinguishable(library, 0.02 * size, size, shapes=shapes)),
        "averaging_cannot_see": ", ".join(without_signature(library, 0.02 * size, size, shapes=shapes)),
        "no_method_can_tell_apart": as_text(exactly_dependent(library, size, shapes=shapes)),
    }
