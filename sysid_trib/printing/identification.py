"""A cross-checked identification: is the record explained, do the methods agree, what follows."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.printing import ALWAYS, Block, Layer, layout, verdict
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.physics import physics_json, physics_sentences, si_block, weight_sentences
from sysid_trib.printing.sureness import random_force_json, random_force_sentences, sureness_blocks
from sysid_trib.results import judged
from sysid_trib.results.kinds import MU, SI, si_of
from sysid_trib.results.models import library_of
from sysid_trib.results.random_force import random_force_of
from sysid_trib.results.variables import record_groups, signal_units

# Methods agree, but only barely, if the p-value is between the level of the test and this value.
BARELY = 0.05
# If all differences together agree, a single one above this number of errors is mentioned.
AS_A_WHOLE = 2.0
COEFFICIENTS, FOLLOWS_TITLE = "Coefficients", "Consequences of the model"
NO_STIFFNESS = (
    "In a single record, {0} cannot be separated from the frequency: give --omega0 (frequency without "
    "contact) to identify {0}."
)
NO_CONSEQUENCES = "Weights, crossovers and arrest are not given: {}."


def identification_blocks(tree: xr.DataTree, sources: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of a result of `cross_check`, with the group `runs` of several runs.

    Parameters
    ----------
    tree : DataTree
        The result.
    sources : sequence of str
        Descriptions of the records.
    """
    agree, remarks = [*_how_methods_agree(tree)], [*_remarks(tree)]
    stochastic, details = [*random_force_sentences(tree)], Layer.EXPLAIN
    return [
        Block([verdict.verdict_sentence(tree)], ALWAYS),
        Block([*sources, *_own_quantity(tree)]),
        Block([*verdict.line_sentences(tree), *verdict.effective_sentences(tree)], ALWAYS),
        Block(title="At a glance"),
        *_coefficient_blocks(tree),
        Block([*verdict.error_sentences(tree)], ALWAYS),
        Block([*agree[:1], *stochastic, *remarks, *_weight(tree)], Layer.DEFAULT),
        *sureness_blocks(tree),
        Block([*verdict.test_sentences(tree), *agree, *remarks, *_stiffness(tree)], details),
        *verdict.runs_blocks(tree),
        Block(stochastic, details, "Random force"),
        Block(consequences(tree), details, FOLLOWS_TITLE),
    ]


def _coefficient_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Yield the coefficients if a method gave any, and the equation of the preferred model."""
    if (main := judged.main_result(tree)) is not None:
        yield Block([verdict.reference_sentence(judged.last_of(tree))], Layer.EXPLAIN, COEFFICIENTS)
        yield Block((), ALWAYS, COEFFICIENTS, identification_table(tree))
        yield from si_block(tree)
        yield Block([f"{_answer(tree)}Equation: {equation_text(main)}."], title=COEFFICIENTS)


def estimate_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Return the blocks of a single identification, a result of `identify`."""
    result = tree.to_dataset()
    method, noise = result.attrs["method"], {"force": f"noise ({signal_units(result)})"}
    noise |= {"formula": "standard deviation", method: f"{result.noise.item():.2g}"}
    table = layout.coefficient_table({method: result}, below=[noise])
    yield Block([verdict.reference_sentence(result)], title=COEFFICIENTS, table=table)
    if sentences := physics_sentences(tree, result):
        yield Block(sentences, title=FOLLOWS_TITLE)


def identification_table(tree: xr.DataTree) -> Table:
    """Return coefficients by both methods, their difference in errors, and the residuals of their models.

    A method that failed has no column. Errors are total errors, from noise and model.
    """
    table, results = judged.judged_of(tree), judged.kept_results(tree)
    kept = table.sel(model=list(results))
    # With one method there is no difference.
    z = dict(tree["agreement"].z.to_series()) if len(results) > 1 else {}
    ratios = {name: f"{judged.residual_over_noise(tree, name):.3g} x noise" for name in results}
    noise = f"noise: {judged.record_noise(tree):.2g} {signal_units(tree)}"
    below = [{"force": "residual (RMS)", "formula": noise, **ratios}]
    stochastic = [bool(random_force_of(result)) for result in results.values()]
    further = {
        ("residual exceeds noise", "from (s)"): np.where(stochastic, np.nan, kept.departure_time.values),
        ("one-step prediction", "RMS / stated error"): np.where(
            stochastic, kept.tested_over_noise.values, np.nan
        ),
    }
    for (what, unit), values in further.items():
        if np.isfinite(values).any():
            cells = (f"{x:.3g}" if np.isfinite(x) else "-" for x in values)
            below.append({"force": what, "formula": unit, **dict(zip(results, cells, strict=True))})
    return layout.coefficient_table(results, z, below)


def consequences(tree: xr.DataTree) -> list[str]:
    """Return the consequences of the preferred model in sentences; energies in J if the inertia is known.

    No consequences are stated for a model that does not follow the record.
    """
    if not judged.follows(tree):
        return [NO_CONSEQUENCES.format(_why_none(tree))]
    return physics_sentences(tree, tree[judged.preferred_of(tree)].to_dataset())


def _why_none(tree: xr.DataTree) -> str:
    undetermined = judged.verdict_of(tree) == "undetermined"
    return (
        "the record does not determine the model" if undetermined else "the model does not explain the record"
    )


def _weight(tree: xr.DataTree) -> list[str]:
    """Describe the forces that cause the decay in the preferred model, if it follows the record."""
    result = judged.preferred_result(tree) if judged.follows(tree) else None
    return [] if result is None else weight_sentences(tree, result)


def _answer(tree: xr.DataTree) -> str:
    """Name the preferred method if a test decides it."""
    decided = judged.is_unexplained(tree) and not judged.failures(tree)
    preferred = f"Preferred method: {judged.preferred_of(tree)} (it predicts the held-out parts better). "
    return preferred if decided else ""


def _how_methods_agree(tree: xr.DataTree) -> Iterator[str]:
    """Describe the agreement of the methods and its test; nothing if one failed."""
    checked = tree["agreement"].to_dataset()
    attrs, p_value = checked.attrs, checked.p_value.item()
    pair = f"{attrs['first'].capitalize()} and {attrs['second']}"
    if judged.failures(tree):
        return
    if attrs["verdict"] == "unknown":
        yield f"{pair} cannot be compared: the error of their difference could not be computed."
        return
    explained, z = judged.is_explained(tree), abs(checked.z.to_series())
    if attrs["verdict"] == "disagree":
        how = "disagree"
    elif p_value < BARELY:
        how = "agree, but barely"
    elif z.max() > AS_A_WHOLE:
        agree = "agree" if explained else "differ by no more than their errors"
        how = f"{agree} as a whole; {z.idxmax()} differs by {z.max():.2g} standard errors"
    else:
        how = f"{'agree within' if explained else 'differ by no more than'} their errors"
    yield f"{pair} {how}."
    stated = attrs.get("errors") == "stated"
    how = "the sum of the stated variances" if stated else "the influence of each sample on both methods"
    yield (
        f"All differences together: chi-square {checked.chi_square.item():.3g} for "
        f"{checked.degrees_of_freedom.item()} degrees of freedom, p = {p_value:.2g} (errors by {how})."
    )


def _remarks(tree: xr.DataTree) -> Iterator[str]:
    """Describe the limits of the methods: biases, correlation, constraints, forces not identified."""
    results = judged.kept_results(tree)
    for method, result in results.items():
        if not result.get("first_order_bias_removed", True):
            reason = result.attrs.get("first_order_bias_reason", "").rstrip(".") or "as asked"
            yield f"The first-order bias of {method} was not removed: {reason}."
        if not result.get("refined", True):
            yield (
                f"The regressors of {method} come from the smoothed record, because the motion of its model "
                "does not follow the record."
            )
        if result.attrs.get("correlation_lags", 0):
            yield (
                f"The residuals of {method} are correlated; its errors take that into account "
                "(Newey and West)."
            )
    yield from verdict.constraint_sentences(results.values())
    yield from verdict.identifiability_warnings(tree["agreement"].to_dataset().attrs)


def _stiffness(tree: xr.DataTree) -> Iterator[str]:
    """State that a linear stiffness cannot be identified, if the library has one."""
    second = judged.last_of(tree)
    stiffness = library_of(second, whole=True).role("x")
    if stiffness is not None and stiffness.symbol not in second.force:
        yield NO_STIFFNESS.format(stiffness.symbol)


def _own_quantity(tree: xr.DataTree) -> Iterator[str]:
    """Describe which method is fitted to the measured quantity itself, with the bias of the sensor."""
    for name, result in judged.kept_results(tree).items():
        if measured := result.attrs.get("compared_in"):
            biases = ", ".join(layout.values_with_errors(result.bias, result.bias_standard_error))
            times = int(tree[record_groups(tree)[0]].attrs.get("integrations", 0))
            yield (
                f"{name.capitalize()} is fitted to the {measured} itself, with a bias of {biases} "
                f"{result.bias.attrs['units']} about the mean of its swing; the other method uses the "
                f"integral. Residuals are those of the {measured}{('', ' over w', ' over w^2')[times]}."
            )
            return


def identification_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return a result of `cross_check` as plain data, see `identification_blocks`."""
    compared, failed = tree["agreement"].to_dataset(), judged.failures(tree)
    answer, si, methods = judged.preferred_of(tree), si_of(tree), {}
    withheld: dict[str, Any] = dict.fromkeys(layout.KEYS["identification"]) | {"coefficients": {}}
    for name in judged.judged_of(tree).model.values.tolist():
        result = judged.with_error_parts(tree[name].to_dataset())
        held_out = {"held_out_rms": result.get("held_out_rms", np.nan)}
        methods[name] = withheld if name in failed else layout.mapped(result, "identification", held_out)
        methods[name] = methods[name] | {"failed": failed.get(name, "")}
    follows: dict[str, Any] = {"refused": NO_CONSEQUENCES.format(_why_none(tree))}
    if judged.follows(tree):
        follows = physics_json(tree)
    data = {
        **layout.records_json(tree),
        **random_force_json(tree),
        "answer": None if answer in failed else answer,
        "methods": methods,
        **layout.judged_json(tree),
        "cross_check": layout.by_variables(compared) | compared.attrs,
        "noise": judged.record_noise(tree),
        "consequences": follows,
        "sufficient_forces": [
            {s: {"value": value, "standard_error": error} for s, (value, error) in forces.items()}
            for forces in judged.fewer_forces(tree)
        ],
    }
    if "runs" in tree:
        data["runs"] = verdict.runs_json(tree["runs"].to_dataset())
    if si is not None:
        friction = {MU: f"{MU}±"} if MU in si else {}
        data[SI] = layout.mapped(si, layout.KEYS["si"] | friction)
    return data
