"""Whether runs of one experiment agree, and how two identifications differ."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import chi2, norm

from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.methods import method_of
from sysid_trib.results.common_reference import FREQUENCY, in_model, quantities, stated_covariance
from sysid_trib.results.schema import library_of

Array = NDArray[np.float64]

# Below this probability of a larger difference by chance runs are said to disagree.
LEVEL = 0.01
# A force without a degree in v is compared only where the frequencies are as near as this.
NEAR = 0.01


def run_agreement(decays: Sequence[xr.Dataset], together: xr.Dataset) -> xr.Dataset:
    """Test whether the runs of one experiment have the same forces.

    Parameters
    ----------
    decays : the runs.
    together : the identification of all of them, whose method is run on each alone.

    Returns
    -------
    Dataset. Over `run` and `quantity` (each force, and the asymptotic frequency where it was fitted) the
    `value` from that run alone at the common reference frequency, with its `standard_error`; over `quantity`
    `chi_square` of the values about their weighted mean, `degrees_of_freedom`, `p_value`; and the same of all
    quantities with their covariances (`total_...`). nan for a run that alone cannot decide: `reason(run)`.
    attrs: `verdict` agree, disagree or unknown.

    Notes
    -----
    Cochran's Q. Large where a force changes from run to run (wear), or is of another form than the model's:
    then it changes with amplitude.
    """
    method, library = method_of(together), library_of(together, whole=True)
    kept = [s for s in together.force.values.tolist() if in_model(together, s)]
    frequency = together.reference_frequency.item()
    free = together.reference_frequency_standard_error.item() > 0.0
    names = [*kept, FREQUENCY] if free else kept
    values = np.full((len(decays), len(names)), np.nan)
    covariances = np.full((len(decays), len(names), len(names)), np.nan)
    reasons = []
    for at, decay in enumerate(decays):
        try:
            alone = method.identify(decay, library)
        except SysidTribError as error:
            reasons.append(str(error))
            continue
        values[at] = quantities(alone, kept, frequency)[: len(names)]
        covariances[at] = stated_covariance(alone, kept)[: len(names), : len(names)]
        reasons.append("")
    return _tested(names, values, covariances, reasons)


def _tested(names: Sequence[str], values: Array, covariances: Array, reasons: Sequence[str]) -> xr.Dataset:
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    usable = np.isfinite(values).all(axis=1)
    each = [
        _homogeneity(values[usable][:, [j]], covariances[usable][:, [j]][:, :, [j]])
        for j in range(len(names))
    ]
    total = _homogeneity(values[usable], covariances[usable])
    own = {"units": "1; rad/s for the frequency"}
    variables: dict[str, Any] = {
        "value": (("run", "quantity"), values, own | {"long_name": "from this run alone"}),
        "standard_error": (("run", "quantity"), errors, own | {"long_name": "its standard error"}),
        "reason": ("run", list(reasons), {"long_name": "why this run alone decides nothing"}),
    }
    for at, (name, told) in enumerate(
        (
            ("chi_square", "chi-square about the weighted mean"),
            ("degrees_of_freedom", "degrees of freedom"),
            ("p_value", "probability of a larger chi-square by chance"),
        )
    ):
        attrs = {"units": "1", "long_name": told}
        variables[name] = ("quantity", [one[at] for one in each], attrs)
        variables[f"total_{name}"] = ((), total[at], attrs)
    p_value = total[2]
    verdict = "unknown" if np.isnan(p_value) else "agree" if p_value >= LEVEL else "disagree"
    return xr.Dataset(variables, {"quantity": list(names)}, {"verdict": verdict})


def _homogeneity(values: Array, covariances: Array) -> tuple[float, float, float]:
    """Chi-square of (run, quantity) about their weighted mean, degrees of freedom, p-value."""
    if len(values) < 2:
        return np.nan, 0.0, np.nan
    # Coefficients differ by orders of magnitude: in units of their errors the matrices are well conditioned.
    unit = np.sqrt(np.mean(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    values, covariances = values / unit, covariances / np.outer(unit, unit)
    weights = np.linalg.pinv(covariances)
    mean = np.linalg.pinv(weights.sum(axis=0)) @ np.einsum("rij,rj->i", weights, values)
    gap = values - mean
    statistic = float(np.einsum("ri,rij,rj->", gap, weights, gap))
    freedom = (len(values) - 1) * values.shape[1]
    return statistic, float(freedom), float(chi2.sf(statistic, freedom))


def difference(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """What is in one identification beyond another: a contact run minus a contactless one, say.

    Parameters
    ----------
    first, second : identifications of different records. A force that one of them lacks is zero there.

    Returns
    -------
    Dataset. Over `force`: `difference` first - second, both at the first's reference frequency,
    `standard_error`, `z`, `p_value`, `first`, `second`, and `covariance(force, other_force)`; nan for a force
    without a degree in v where the frequencies differ by more than 1 %. Scalars: `stiffness_difference` =
    (w_inf/w_inf')^2 - 1, the paper's alpha if the second has no contact, with its standard error;
    `chi_square` of all differences, `degrees_of_freedom`, `p_value_of_all`; `reference_frequency` (rad/s).

    Raises
    ------
    UsageError
        One is no identification.

    Notes
    -----
    The records share no noise: covariances add, those of the frequencies included.
    """
    for result in (first, second):
        if not isinstance(result, xr.Dataset) or "coefficient" not in result:
            raise UsageError("difference wants two identifications, as identify returns them.")
    own = [[s for s in r.force.values.tolist() if in_model(r, s)] for r in (first, second)]
    symbols = list(dict.fromkeys([*own[0], *own[1]]))
    values = [r.coefficient.sel(force=kept).values for r, kept in zip((first, second), own, strict=True)]
    factor, power = _to_reference(second, own[1], first.reference_frequency.item())
    place = [
        np.array([[s == k for k in kept] for s in symbols], float).reshape(-1, len(kept)) for kept in own
    ]
    moved = factor * values[1]
    # By (coefficients, w_inf) of the first, then of the second; w and w_inf move together.
    slope = moved * power / second.reference_frequency.item()
    jacobian = np.hstack(
        [place[0], (place[1] @ slope)[:, None], -place[1] * factor, -(place[1] @ slope)[:, None]]
    )
    both = block_diag(*(stated_covariance(r, kept) for r, kept in zip((first, second), own, strict=True)))
    return _labelled(
        (first, second), symbols, (place[0] @ values[0], place[1] @ moved), jacobian @ both @ jacobian.T
    )


def _to_reference(result: xr.Dataset, kept: Sequence[str], frequency: float) -> tuple[Array, Array]:
    """Factors of coefficients to a reference frequency, powers of the ratio of frequencies."""
    ratio = result.reference_frequency.item() / frequency
    degrees = [f.speed_degree for f in library_of(result).select(kept)]
    # A force without a degree keeps its size, w^2 c; its shape moves with the frequency, if only a little.
    power = np.array([2.0 if q is None else 2.0 - q for q in degrees])
    lost = np.array([q is None for q in degrees], dtype=bool) & (abs(ratio - 1.0) > NEAR)
    return np.where(lost, np.nan, ratio**power), power


def _labelled(
    results: tuple[xr.Dataset, xr.Dataset], symbols: Sequence[str], sides: tuple[Array, Array], spread: Array
) -> xr.Dataset:
    gap, error = sides[0] - sides[1], np.sqrt(np.diag(spread))
    known = np.isfinite(gap)
    unit = np.where(known & (error > 0.0), error, 1.0)
    scaled, weights = gap / unit, spread / np.outer(unit, unit)
    statistic = float(scaled[known] @ np.linalg.pinv(weights[np.ix_(known, known)]) @ scaled[known])
    z = np.divide(gap, error, out=np.full_like(gap, np.nan), where=error > 0.0)
    limits = [r.asymptotic_frequency.item() for r in results]
    parts = [r.asymptotic_frequency_standard_error.item() / w for r, w in zip(results, limits, strict=True)]
    ratio = (limits[0] / limits[1]) ** 2
    own = {"units": "see the force's unit"}
    columns = {
        "difference": (gap, own | {"long_name": "first minus second"}),
        "standard_error": (error, own | {"long_name": "standard error of the difference"}),
        "z": (z, {"units": "1", "long_name": "difference over its standard error"}),
        "p_value": (2.0 * norm.sf(np.abs(z)), {"units": "1", "long_name": "chance of a larger difference"}),
        "first": (sides[0], own | {"long_name": "first"}),
        "second": (sides[1], own | {"long_name": "second, at the first's reference frequency"}),
    }
    scalars = {
        "stiffness_difference": (ratio - 1.0, "1", "ratio of the squared asymptotic frequencies, less 1"),
        "stiffness_difference_standard_error": (2.0 * ratio * np.hypot(*parts), "1", "its standard error"),
        "reference_frequency": (
            results[0].reference_frequency.item(),
            "rad/s",
            "reference of the coefficients",
        ),
        "chi_square": (statistic, "1", "chi-square of all differences"),
        "degrees_of_freedom": (float(known.sum()), "1", "number of differences"),
        "p_value_of_all": (float(chi2.sf(statistic, known.sum())), "1", "chance of a larger chi-square"),
    }
    variables: dict[str, Any] = {name: ("force", values, attrs) for name, (values, attrs) in columns.items()}
    variables["covariance"] = (("force", "other_force"), spread, own | {"long_name": "covariance"})
    variables |= {k: ((), value, {"units": u, "long_name": told}) for k, (value, u, told) in scalars.items()}
    attrs = {
        f"{name}_record": r.attrs["record_source"]
        for name, r in zip(("first", "second"), results, strict=True)
    }
    return xr.Dataset(variables, {"force": list(symbols), "other_force": list(symbols)}, attrs)
