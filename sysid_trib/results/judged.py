"""Properties of a result: stored when it is made, and read from its tree."""

from math import floor, log10

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import UsageError
from sysid_trib.results.effects import significant, sufficient_forces
from sysid_trib.results.kinds import contents_text, has_input, identifications_of, kind_of
from sysid_trib.results.variables import group_names, record_groups

# A residual above this multiple of the noise (RMS) is large.
LARGE = 1.5
# Default held-out part of `discover`.
LAST_THIRD = "the last third"
VERDICTS = ("explained", "explained with a random force", "approximate", "not explained", "undetermined")
EXPLAINED_VERDICTS = ("explained", "explained with a random force")
UNEXPLAINED = ("approximate", "not explained")
JUDGED = "judged"
# Attribute of a discovery: outcome of its search; the verdict on its final model is that of the judge.
SEARCH_OUTCOME = "search_outcome"
SEARCH_OUTCOMES = ("explained", "unknown effect", "nothing missing")


def judged_of(tree: xr.DataTree) -> xr.Dataset:
    """Return the judged variables of each model of a result, over `model`."""
    return tree[JUDGED].to_dataset()


def comparison_of(tree: xr.DataTree) -> xr.Dataset:
    """Return the table of methods of `compare` with their judged variables, nan for one without a result."""
    table = tree["comparison"].to_dataset()
    judged = judged_of(tree)[["residual_rms", "residual_over_noise", "failure", "verdict"]]
    judged = judged.reindex(model=table.model.values, fill_value={"failure": "", "verdict": ""})
    return table.merge(judged)


def residual_of(tree: xr.DataTree, model: str) -> float:
    """Return the RMS of record minus motion of a model over all runs, rad; nan if the model diverges."""
    return float(judged_of(tree).residual_rms.sel(model=model))


def record_noise(tree: xr.DataTree) -> float:
    """Return the sensor's noise of the records in a result, rad: RMS over the runs."""
    return root_mean_square([tree[group].noise.item() for group in record_groups(tree)])


def residual_over_noise(tree: xr.DataTree, model: str) -> float:
    """Return the residual of a model over the sensor's noise of the record."""
    return float(judged_of(tree).residual_over_noise.sel(model=model))


def held_out_excess(tree: xr.DataTree) -> float:
    """Return the held-out residual of the final model of a discovery over the sensor noise.

    It is zero in three cases: the held-out residual is hardly larger than that of the fitted parts; the final
    models were fitted to the whole records; or the records are driven, whose noise a spline does not show.
    """
    if is_refitted(tree) or has_input(tree[record_groups(tree)[0]].to_dataset()):
        return 0.0
    ratio = float(tree["holdout"].rms[-1]) / record_noise(tree)
    return ratio if ratio > LARGE * max(1.0, residual_over_noise(tree, "after")) else 0.0


def is_refitted(tree: xr.DataTree) -> bool:
    """Return true if the final models of a discovery were fitted to the whole records."""
    return bool(tree["refitted"])


def verdict_of(tree: xr.DataTree) -> str:
    """Return the verdict on the record, one of `VERDICTS`: that of the preferred model."""
    return str(judged_of(tree).attrs["verdict"])


def has_unknown_effect(tree: xr.DataTree) -> bool:
    """Return true if the search of a discovery ended with an effect that it could not name."""
    return str(tree.attrs[SEARCH_OUTCOME]) == "unknown effect"


def follows(tree: xr.DataTree) -> bool:
    """Return true if the preferred model follows the record, so that consequences can be computed."""
    return is_explained(tree) or verdict_of(tree) == "approximate"


def is_explained(tree: xr.DataTree) -> bool:
    """Return true if the residual of the preferred model is noise, of the sensor or with a random force."""
    return verdict_of(tree) in EXPLAINED_VERDICTS


def is_unexplained(tree: xr.DataTree) -> bool:
    """Return true if the residual of the preferred model is more than noise."""
    return verdict_of(tree) in UNEXPLAINED


def preferred_of(tree: xr.DataTree) -> str:
    """Return the name of the preferred model."""
    return str(judged_of(tree).attrs["preferred"])


def last_of(tree: xr.DataTree) -> xr.Dataset:
    """Return the last of the judged identifications, from the method at the statistical bound."""
    return tree[judged_of(tree).model.values[-1]].to_dataset()


def failures(tree: xr.DataTree) -> dict[str, str]:
    """Return the models whose motions diverge, and why."""
    reasons = judged_of(tree).failure
    return {name: why for name, why in zip(reasons.model.values, reasons.values.tolist(), strict=True) if why}


def kept_results(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """Return the judged identifications by the names of their methods, without failed ones.

    Raises
    ------
    KeyError
        The result contains no judged identification.
    """
    failed = failures(tree)
    names = judged_of(tree).model.values.tolist()
    return {name: tree[name].to_dataset() for name in names if name not in failed}


def preferred_result(tree: xr.DataTree) -> xr.Dataset | None:
    """Return the preferred identification; None if its method failed."""
    return kept_results(tree).get(preferred_of(tree))


def given_results(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """Return the identifications of any result by name, without failed methods."""
    if kind_of(tree) == "discover":
        return {"start model": tree["before"].to_dataset(), "final model": tree["after"].to_dataset()}
    if kind_of(tree) == "compare":
        labels = applied_methods(comparison_of(tree)).model.values.tolist()
        return {label: tree[label].to_dataset() for label in labels}
    return identifications_of(tree) if kind_of(tree) == "difference" else kept_results(tree)


def main_result(tree: xr.DataTree) -> xr.Dataset | None:
    """Return the main identification of a result: the best, final or preferred one; None without one."""
    if kind_of(tree) == "identify":
        return tree.to_dataset()
    if kind_of(tree) in ("", "difference"):
        return None
    named = given_results(tree)
    if kind_of(tree) == "discover":
        return named["final model"]
    if kind_of(tree) == "compare":
        return named[tree["comparison"].attrs["best"]]
    return named.get(preferred_of(tree), next(reversed(named.values()), None))


def best(result: xr.Dataset | xr.DataTree) -> xr.Dataset:
    """Return the preferred identification of any result.

    Parameters
    ----------
    result : Dataset or DataTree
        Result of `identify`, `laws`, `compare`, `discover`, or an identification itself.

    Returns
    -------
    Dataset
        The preferred identification of the result: see `identify`.

    Raises
    ------
    UsageError
        The result contains no identification, or several without a preferred one.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin())
    >>> list(result.children)
    ['record', 'envelope', 'averaging', 'direct', 'judged', 'agreement', 'backbone', 'lack_of_fit']
    >>> st.best(result).attrs["method"]
    'direct'
    """
    if isinstance(result, xr.Dataset):
        if "coefficient" in result and "method" in result.attrs:
            return result
        preferred = None
    else:
        preferred = main_result(result) if isinstance(result, xr.DataTree) else None
    if preferred is not None:
        return preferred
    tree = xr.DataTree(result) if isinstance(result, xr.Dataset) else result
    if isinstance(tree, xr.DataTree) and kind_of(tree) == "difference":
        raise UsageError(
            "A difference prefers none of its identifications; give best one of the two results of which it "
            "is, or take the group sample_first or sample_second of a difference of records."
        )
    raise UsageError(
        f"There is no preferred identification in {contents_text(result)}; give a result of identify, laws, "
        "compare or discover."
    )


def fewer_forces(tree: xr.DataTree) -> list[dict[str, tuple[float, float]]]:
    """Return the fewest sufficient forces, see `sufficient_forces`, if no coefficient is significant."""
    result = preferred_result(tree)
    if result is None or not follows(tree) or significant(result).any():
        return []
    return [forces for forces in sufficient_forces(result) if len(forces) < result.sizes["force"]]


def with_error_parts(result: xr.Dataset) -> xr.Dataset:
    """Return an identification with both parts of its standard errors: `error_of_noise`, `error_of_model`."""
    noise, model = error_parts(result)
    return result.assign(error_of_noise=("force", noise), error_of_model=("force", model))


def amplitudes(tree: xr.DataTree) -> Array:
    """Return the amplitudes of the half periods of all runs, rad."""
    groups = group_names("envelope", len(record_groups(tree)))
    return np.concatenate([tree[group].amplitude.values for group in groups])


def error_parts(result: xr.Dataset) -> tuple[Array, Array]:
    """Return the errors of the coefficients due to the noise and to the model, (force,) each."""
    if "error_of_model" not in result:
        calibration = result["error_of_calibration"].values if "error_of_calibration" in result else 0.0
        stated = np.sqrt(np.maximum(result.standard_error.values**2 - calibration**2, 0.0))
        return stated, np.zeros(result.sizes["force"])
    return result.error_of_noise.values, result.error_of_model.values


def applied_methods(table: xr.Dataset) -> xr.Dataset:
    """Return the methods of a comparison with a coefficient or a frequency, whose models did not fail.

    The method of the best prediction is always included, because the others are compared with it.
    """
    applied = table.coefficient.notnull().any("force") | table.asymptotic_frequency.notnull()
    failed = (table.failure != "") & (table.model != table.attrs["best"])
    return table.isel(model=np.flatnonzero((applied & ~failed).values))


def column_power(column: xr.Dataset) -> int:
    """Return the power of ten of a column: of the best method's value or error, of all without one."""
    best = column.sel(model=column.attrs["best"])
    size = max(abs(best.coefficient.item()), best.standard_error.item())
    if not (np.isfinite(size) and size > 0.0):
        size = float(np.nanmedian(np.abs(column.coefficient.values)))
    power = floor(log10(size)) if np.isfinite(size) and size > 0.0 else 0
    return 0 if -2 < power < 4 else power
