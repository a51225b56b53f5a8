"""What varies between runs: which coefficient is common, which goes with a condition, which scatters."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.results.references import (
    ASYMPTOTIC_FREQUENCY,
    comparable,
    comparison_covariance,
    comparison_values,
)
from sysid_trib.results.variables import Variables, text_variable, variable, with_error
from sysid_trib.validation.random_effects import DEVIATIONS, LIMIT, RandomEffects, precision
from sysid_trib.validation.run_conditions import columns_of, conditions_table, listed

# Of each quantity, over all of them (Bonferroni): below it a condition acts, or runs scatter.
VARIES_LEVEL = 0.01
UNIT = "see the coordinate unit"
COMMON, UNDECIDED_RUNS = "common", "too few runs"


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
        Identifications of a run each, with the same forces; or `value(run, quantity)` and
        `standard_error(run, quantity)`, as `run_agreement` gives them, nan where a run says nothing.
    conditions : mapping or DataFrame, optional
        Columns of one entry a run: numbers (load, humidity) act linearly, texts (material) by groups.
    laboratories : str, optional
        The column that says which laboratory, or operator, or rig, a run is of: compared by ISO 5725-2,
        and no condition.

    Returns
    -------
    Dataset
        Over `quantity` (each force, and the asymptotic frequency): `between_run`, the standard deviation of
        what scatters between runs beyond their stated errors and the conditions, with `between_run_lower` and
        `between_run_upper` (95 %); `scatter_p_value` of no such scatter, `homogeneity_p_value` of one value
        for all runs; `verdict`: common, varies with ..., scatters, too few runs. Over `run` the values at one
        reference frequency with their errors, `shrunken` estimates, which use all runs, and `z`, how far a
        run is from what all others and its conditions let expect, over scatter and error. Over `term`
        `effect`: the mean (at the mean of numerical conditions, and of the first group), and by how much it
        rises per unit of a condition, or in another group; `condition_p_value` over `condition`. With
        `laboratories` also `repeatability`, `between_laboratory` and `reproducibility` (standard deviations
        of values as measured, with their intervals of 95 %), and the limits of the first and the last.

    Raises
    ------
    UsageError
        Fewer than two runs, no force in all of them, conditions of another number of runs, or without a
        value, or that do not vary or cannot be told apart.

    Notes
    -----
    Each quantity by itself: value = mean + conditions + scatter + error, the variances of the errors known
    (random-effects meta-regression). Spread by Paule and Mandel, its interval by Q-profile (Viechtbauer
    2007); tests of conditions after Knapp and Hartung (2003); shrunken estimates average over what is not
    known of the spread; distances are from the fit and the scatter of all other runs (Viechtbauer and Cheung
    2010). A condition acts where its p-value is below 1 % over the number of quantities.

    Examples
    --------
    >>> import numpy as np, xarray as xr, sysid_trib as st
    >>> value = [[1.0], [1.1], [2.0], [2.2], [3.1], [3.0]]
    >>> error = np.full((6, 1), 0.1)
    >>> coords = {"quantity": ["lambda"]}
    >>> dims = ("run", "quantity")
    >>> runs = xr.Dataset({"value": (dims, value), "standard_error": (dims, error)}, coords)
    >>> st.campaigns.between_runs(runs, {"load": [1, 1, 2, 2, 3, 3]}).verdict.item()
    'varies with load'
    """
    estimates = results if isinstance(results, xr.Dataset) else _estimates(results)
    if estimates.sizes.get("run", 0) < 2:
        raise UsageError("Two runs at least show what varies between them; give more.")
    table = conditions_table(conditions, estimates.sizes["run"])
    laboratory = None
    if laboratories is not None:
        if laboratories not in table:
            raise UsageError(f"The conditions have no column '{laboratories}'; they have {listed(table)}.")
        laboratory = table.pop(laboratories).astype(str).to_numpy()
    columns, condition_of = columns_of(table)
    names = estimates.quantity.values.tolist()
    level = VARIES_LEVEL / len(names)
    of_quantities = [
        _quantity(estimates.sel(quantity=name), columns, condition_of, laboratory, level) for name in names
    ]
    dims = ("run", "quantity")
    values = estimates.value.transpose(*dims).values, estimates.standard_error.transpose(*dims).values
    both = with_error("value", dims, values, "value of this run by itself", UNIT)
    both["standard_error"] = both.pop("value_standard_error")
    together = xr.concat(of_quantities, "quantity", combine_attrs="override").assign(both)
    attrs = estimates.attrs | {"level": VARIES_LEVEL}
    return together.transpose("run", "quantity", ...).assign_coords(estimates.coords).assign_attrs(attrs)


def _estimates(results: Sequence[xr.Dataset]) -> xr.Dataset:
    """Values of identifications at their mean reference frequency, with their errors."""
    for result in results:
        if not isinstance(result, xr.Dataset) or "coefficient" not in result:
            raise UsageError("between_runs wants identifications, as identify returns them.")
    kept = comparable(*results) if len(results) else []
    if not kept:
        raise UsageError("These runs have no free coefficient in common; identify them with the same forces.")
    units = {symbol: {str(r.unit.sel(force=symbol).item()) for r in results} for symbol in kept}
    if mixed := [symbol for symbol, of in units.items() if len(of) > 1]:
        listed_units = ", ".join(sorted(units[mixed[0]]))
        raise UsageError(f"The runs have {mixed[0]} in different units: {listed_units}.")
    frequency = float(np.mean([r.reference_frequency.item() for r in results]))
    values = [comparison_values(r, kept, frequency) for r in results]
    errors = [np.sqrt(np.diag(comparison_covariance(r, kept, frequency))) for r in results]
    sources = [", ".join(result.attrs["record_source"]) for result in results]
    dims = ("run", "quantity")
    return xr.Dataset(
        {"value": (dims, np.array(values)), "standard_error": (dims, np.array(errors))},
        {
            "quantity": [*kept, ASYMPTOTIC_FREQUENCY],
            "unit": ("quantity", [*(units[symbol].pop() for symbol in kept), "rad/s"]),
            "run": sources,
        },
        {"reference_frequency": frequency},
    )


def _quantity(
    of_runs: xr.Dataset,
    columns: Mapping[str, Array],
    condition_of: Sequence[str],
    laboratory: Array | None,
    level: float,
) -> xr.Dataset:
    """All that is said of one quantity."""
    values, errors = of_runs.value.values.astype(float), of_runs.standard_error.values.astype(float)
    known = np.isfinite(values) & np.isfinite(errors) & (errors > 0.0)
    terms, conditions = list(columns), list(dict.fromkeys(condition_of[1:]))
    design = np.column_stack(list(columns.values()))
    effects, shrunken = np.full((2, len(terms)), np.nan), np.full((2, len(values)), np.nan)
    p_values, interval, scatter = np.full(len(conditions), np.nan), np.full(3, np.nan), [np.nan, np.nan]
    off = np.full(len(values), np.nan)
    verdict = UNDECIDED_RUNS
    if known.sum() > design.shape[1] and np.linalg.matrix_rank(design[known]) == design.shape[1]:
        # In units of the errors, whatever the quantity's own.
        unit = float(np.median(errors[known]))
        scaled = values[known] / unit, errors[known] / unit
        fit = RandomEffects(*scaled, design[known])
        tau, lower, upper, p_value = fit.heterogeneity()
        interval = unit * np.array([tau, lower, upper])
        scatter = [p_value, RandomEffects(*scaled, design[known, :1]).heterogeneity().p_value]
        effects = unit * np.stack([fit.weighted(tau).effects, fit.effect_errors(tau)])
        off[known] = fit.deleted_residuals()
        for at, name in enumerate(conditions):
            p_values[at] = fit.p_value(tau, np.flatnonzero(np.array(condition_of) == name))
        shrunken[:, known] = unit * np.stack(fit.shrunken())
        acting = [name for name, p in zip(conditions, p_values, strict=True) if p < level]
        verdict = _verdict(acting, p_value < level)
    made: Variables = {
        **with_error("effect", "term", (effects[0], effects[1]), "effect on the quantity", UNIT),
        **with_error("shrunken", "run", (shrunken[0], shrunken[1]), "value with the help of all runs", UNIT),
        "z": variable("run", off, "distance from what others let expect, over scatter and error", "1"),
        "condition_p_value": variable("condition", p_values, "p-value of no effect of the condition", "1"),
        **_with_interval("between_run", "standard deviation between runs", interval),
        "scatter_p_value": variable((), scatter[0], "p-value of no scatter beside the conditions", "1"),
        "homogeneity_p_value": variable((), scatter[1], "p-value of one value in all runs", "1"),
        "verdict": text_variable((), verdict, "what varies between runs"),
    }
    if laboratory is not None:
        made |= _of_laboratories(values[known], laboratory[known])
    return xr.Dataset(made, {"term": terms, "condition": conditions})


def _verdict(acting: Sequence[str], scatters: bool) -> str:
    varies = [f"varies with {' and '.join(acting)}"] if acting else []
    return ", ".join([*varies, *(["scatters"] if scatters else [])]) or COMMON


def _of_laboratories(values: Array, laboratory: Array) -> Variables:
    """Repeatability and reproducibility of a quantity."""
    made: Variables = {}
    for (name, text), interval in zip(DEVIATIONS.items(), precision(values, laboratory), strict=True):
        made |= _with_interval(name, text, interval)
        if name != "between_laboratory":
            text = f"two results differ by less in 95 of 100 cases of {name}"
            made[f"{name}_limit"] = variable((), LIMIT * interval[0], text, UNIT)
    return made


def _with_interval(name: str, long_name: str, interval: Array) -> Variables:
    """A value and the ends of its interval of 95 %."""
    ends = {
        "": long_name,
        "_lower": f"lower end of the {long_name}",
        "_upper": f"upper end of the {long_name}",
    }
    pairs = zip(ends.items(), interval, strict=True)
    return {f"{name}{end}": variable((), value, text + long_name, UNIT) for (end, text), value in pairs}
