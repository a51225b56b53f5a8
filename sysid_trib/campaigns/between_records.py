"""Variation between runs: conditions as columns, common coefficients, and coefficients with scatter."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.results.variables import described
from sysid_trib.validation.common_reference import ASYMPTOTIC_FREQUENCY, comparable
from sysid_trib.validation.random_effects import DEVIATIONS, LIMIT, RandomEffects, precision
from sysid_trib.validation.refits import at_reference

# Family-wise level for each quantity (Bonferroni): with a smaller p-value a condition acts, or runs scatter.
VARIES_LEVEL = 0.01
COMMON, UNDECIDED_RUNS = "common", "too few runs"


def _conditions_table(conditions: Mapping[str, ArrayLike] | pd.DataFrame | None, runs: int) -> pd.DataFrame:
    """Return the table of conditions, a row per run; raise an error for missing rows or values."""
    try:
        table = pd.DataFrame({} if conditions is None else conditions).reset_index(drop=True)
    except ValueError as error:
        raise UsageError(f"The conditions are not a table: {error}.") from None
    if len(table.columns) and len(table) != runs:
        raise UsageError(f"The conditions have {len(table)} rows for {runs} runs; give one row a run.")
    for name in table:
        if (missing := table[name].isna().to_numpy()).any():
            raise UsageError(
                f"Condition '{name}' has no value for run {int(np.argmax(missing)) + 1}; "
                "complete it, or leave the run out."
            )
    return table.reindex(range(runs))


def _design(table: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Return the columns of the fit by term, and the condition of each; that of the mean is ''.

    There is one column for a numerical condition, and one for each group of texts except the first, which is
    the reference. All columns are centred, so that the mean is that of all runs.
    """
    columns, condition_of = [pd.DataFrame({"mean": np.ones(len(table))})], [""]
    for name, column in table.items():
        if pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column):
            of_condition = column.astype(float).to_frame(str(name))
        else:
            texts = column.astype(str)
            groups = texts.astype(pd.CategoricalDtype(texts.unique()))
            of_condition = pd.get_dummies(groups, prefix=name, prefix_sep="=", drop_first=True, dtype=float)
        columns.append(of_condition - of_condition.mean())
        condition_of += [str(name)] * of_condition.shape[1]
    return pd.concat([part.reset_index(drop=True) for part in columns], axis=1), condition_of


def without_collinear(table: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Remove the conditions that are confounded with earlier ones.

    Parameters
    ----------
    table : DataFrame
        Conditions that vary, one row per run.

    Returns
    -------
    table : DataFrame
        Conditions with separable effects.
    collinear : dict of str to str
        Each of the other conditions, and those with which it is confounded:
        `'load'`, or `'load', 'speed' together`.
    """
    kept: list[str] = []
    collinear = {}
    for name in table:
        if not _goes_with(table, name, kept):
            kept.append(name)
            continue
        partners = [other for other in kept if _goes_with(table, name, [other])]
        collinear[str(name)] = f"'{partners[0]}'" if partners else f"{_listed(table[kept])} together"
    return table[kept], collinear


def _goes_with(table: pd.DataFrame, name: str, others: Sequence[str]) -> bool:
    """Return true if a condition is a linear combination of a mean and effects of others."""
    design = _design(table[[*others, name]])[0].to_numpy()
    sized = design / np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    return bool(np.linalg.matrix_rank(sized) < min(sized.shape))


def _listed(table: pd.DataFrame) -> str:
    """Return the names of the conditions as a list in words."""
    return ", ".join(f"'{name}'" for name in table) or "none"


def between_runs(
    results: Sequence[xr.Dataset] | xr.Dataset,
    conditions: Mapping[str, ArrayLike] | pd.DataFrame | None = None,
    *,
    laboratories: str | None = None,
) -> xr.Dataset:
    """Compare runs that were identified one by one: a hierarchical fit of their coefficients.

    Parameters
    ----------
    results : sequence of Dataset, or Dataset
        Identifications of one run each, with the same forces; or `value(run, quantity)` and
        `standard_error(run, quantity)`, as from `run_agreement`, nan if a run has no estimate.
    conditions : mapping or DataFrame, optional
        Columns with one entry per run: numbers (load, humidity) act linearly, texts (material) as groups.
    laboratories : str, optional
        The column with the laboratory, operator or rig of each run; these are compared according to ISO
        5725-2 and are not a condition.

    Returns
    -------
    Dataset
        Over `quantity` (each force, and the asymptotic frequency): `between_run`, the standard deviation of
        the scatter between runs beyond their stated errors and the conditions, with `between_run_lower` and
        `between_run_upper` (95 %); `scatter_p_value` for no such scatter, `homogeneity_p_value` for one value
        for all runs; `verdict`: common, varies with ..., scatters, too few runs. Over `run`: values at one
        reference frequency with their errors, `shrunken` estimates, which use all runs, and `z`, the
        deviation of a run from the value expected from all others and its conditions, over scatter and error.
        Over `term`: `effect`, which is the mean (at the mean of numerical conditions, and of the first
        group), and the increase per unit of a condition, or in another group; `condition_p_value` over
        `condition`. With `laboratories` also `repeatability`, `between_laboratory` and `reproducibility`
        (standard deviations of values as measured, with 95 % intervals), and the limits of the first and the
        last.

    Raises
    ------
    UsageError
        There are fewer than two runs, no common force, or conditions that have another number of runs, lack a
        value, do not vary or are confounded.

    Notes
    -----
    Each quantity is treated separately: value = mean + conditions + scatter + error, where the variances of
    the errors are known (random-effects meta-regression). The variance of the scatter is estimated by the
    method of Paule and Mandel, its interval by Q-profile (Viechtbauer 2007); conditions are tested after
    Knapp and Hartung (2003); shrunken estimates are averages over the uncertainty of this variance;
    deviations are relative to the fit and the scatter of all other runs (Viechtbauer and Cheung 2010). A
    condition acts if its p-value is below 1 % over the number of quantities.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> import xarray as xr
    >>> value, error = [[1.0], [1.1], [2.0], [2.2], [3.1], [3.0]], np.full((6, 1), 0.1)
    >>> data = {"value": (("run", "quantity"), value), "standard_error": (("run", "quantity"), error)}
    >>> runs = xr.Dataset(data, {"quantity": ["lambda"]})
    >>> st.campaigns.between_runs(runs, {"load": [1, 1, 2, 2, 3, 3]}).verdict.item()
    'varies with load'
    """
    estimates = results if isinstance(results, xr.Dataset) else _estimates(results)
    if estimates.sizes.get("run", 0) < 2:
        raise UsageError("Variation between runs needs at least two runs; give more.")
    table = _conditions_table(conditions, estimates.sizes["run"])
    laboratory = None
    if laboratories is not None:
        if laboratories not in table:
            raise UsageError(f"The conditions have no column '{laboratories}'; they have {_listed(table)}.")
        laboratory = table.pop(laboratories).astype(str).to_numpy()
    for name, column in table.items():
        if len(set(column)) < 2:
            raise UsageError(f"Condition '{name}' is the same in all runs; leave it out.")
    for name, others in without_collinear(table)[1].items():
        raise UsageError(
            f"Condition '{name}' is confounded with {others} in these runs; leave one of them out."
        )
    design = _design(table)
    names = estimates.quantity.values.tolist()
    level = VARIES_LEVEL / len(names)
    runs = [estimates.sel(quantity=name) for name in names]
    of_quantities = [_quantity(of_run, design, laboratory, level) for of_run in runs]
    both = {name: estimates[name].transpose("run", "quantity").values for name in ("value", "standard_error")}
    together = xr.concat(of_quantities, "quantity", combine_attrs="override")
    together = together.assign(described("between_runs", both))
    attrs = estimates.attrs | {"level": VARIES_LEVEL}
    return together.transpose("run", "quantity", ...).assign_coords(estimates.coords).assign_attrs(attrs)


def _estimates(results: Sequence[xr.Dataset]) -> xr.Dataset:
    """Return the values and errors of identifications at their mean reference frequency."""
    for result in results:
        if not isinstance(result, xr.Dataset) or "coefficient" not in result:
            raise UsageError("between_runs needs identifications, as identify returns them.")
    kept = comparable(*results) if len(results) else []
    if not kept:
        raise UsageError("These runs have no free coefficient in common; identify them with the same forces.")
    units = {symbol: {str(r.unit.sel(force=symbol).item()) for r in results} for symbol in kept}
    if mixed := [symbol for symbol, of in units.items() if len(of) > 1]:
        listed_units = ", ".join(sorted(units[mixed[0]]))
        raise UsageError(f"The runs have {mixed[0]} in different units: {listed_units}.")
    frequency = float(np.mean([r.reference_frequency.item() for r in results]))
    values, covariances = at_reference(results, kept, frequency)
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    dims, of_units = ("run", "quantity"), [*(units[symbol].pop() for symbol in kept), "rad/s"]
    sources = [", ".join(result.attrs["record_source"]) for result in results]
    coords = {"quantity": [*kept, ASYMPTOTIC_FREQUENCY], "unit": ("quantity", of_units), "run": sources}
    data = {"value": (dims, values), "standard_error": (dims, errors)}
    return xr.Dataset(data, coords, {"reference_frequency": frequency})


def _quantity(
    of_runs: xr.Dataset, columns: tuple[pd.DataFrame, list[str]], laboratory: Array | None, level: float
) -> xr.Dataset:
    """Return all variables of one quantity; `columns` : of `_design`."""
    values, errors = of_runs.value.values.astype(float), of_runs.standard_error.values.astype(float)
    known = np.isfinite(values) & np.isfinite(errors) & (errors > 0.0)
    (table, condition_of), design = columns, columns[0].to_numpy()
    terms, conditions = list(table), list(dict.fromkeys(condition_of[1:]))
    effects, shrunken = np.full((2, len(terms)), np.nan), np.full((2, len(values)), np.nan)
    p_values, interval, off = (np.full(count, np.nan) for count in (len(conditions), 3, len(values)))
    scatter_p_value, homogeneity_p_value = np.nan, np.nan
    verdict = UNDECIDED_RUNS
    if known.sum() > design.shape[1] and np.linalg.matrix_rank(design[known]) == design.shape[1]:
        # In units of the errors, independent of the quantity's unit.
        unit = float(np.median(errors[known]))
        scaled = values[known] / unit, errors[known] / unit
        fit = RandomEffects(*scaled, design[known])
        scatter_p_value, weighted = fit.homogeneity_p_value, fit.with_scatter(fit.tau)
        interval = unit * np.array([fit.tau, *fit.tau_interval])
        homogeneity_p_value = RandomEffects(*scaled, design[known, :1]).homogeneity_p_value
        effects = unit * np.stack([weighted.effects, np.sqrt(np.diag(weighted.widened_covariance))])
        off[known] = fit.deleted_residuals()
        for at, name in enumerate(conditions):
            p_values[at] = weighted.p_value(np.flatnonzero(np.array(condition_of) == name))
        shrunken[:, known] = unit * np.stack(fit.shrunken())
        acting = [name for name, p in zip(conditions, p_values, strict=True) if p < level]
        varies = [f"varies with {' and '.join(acting)}"] if acting else []
        verdict = ", ".join([*varies, *["scatters"] * bool(scatter_p_value < level)]) or COMMON
    said = {
        "effect": tuple(effects),
        "shrunken": tuple(shrunken),
        "z": off,
        "condition_p_value": p_values,
        **_with_interval("between_run", interval),
        "scatter_p_value": scatter_p_value,
        "homogeneity_p_value": homogeneity_p_value,
        "verdict": verdict,
    }
    if laboratory is not None:
        for name, interval in zip(DEVIATIONS, precision(values[known], laboratory[known]), strict=True):
            said |= _with_interval(name, interval)
            if name != "between_laboratory":
                said[f"{name}_limit"] = LIMIT * interval[0]
    return xr.Dataset(described("between_runs", said), {"term": terms, "condition": conditions})


def _with_interval(name: str, interval: Array) -> dict[str, float]:
    """Return a value and the limits of its 95 % interval."""
    return {f"{name}{end}": value for end, value in zip(("", "_lower", "_upper"), interval, strict=True)}
