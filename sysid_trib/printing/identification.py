"""A cross-checked identification: is the record explained, do the methods agree, what follows."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.physics.si_units import MU, SI, si_of
from sysid_trib.printing import ALWAYS, Block, Layer, layout, verdict
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.physics import physics_json, physics_sentences, si_block, weight_sentences
from sysid_trib.printing.sureness import random_force_json, random_force_sentences, sureness_blocks
from sysid_trib.results.schema import library_of
from sysid_trib.results.variables import record_groups, signal_units
from sysid_trib.validation import findings

# Between the level at which methods disagree and this one they agree, but barely.
BARELY = 0.05
# More errors than one of several differences that agree as a whole should have without a word.
AS_A_WHOLE = 2.0
COEFFICIENTS, CONSEQUENCES = "Coefficients", "What follows from the model"
NO_STIFFNESS = (
    "In a single record, {0} cannot be separated from the frequency: give --omega0 (frequency without "
    "contact) to identify {0}."
)
NO_CONSEQUENCES = "Weights, crossovers and arrest are not given: the model {} the record."


def identification_blocks(tree: xr.DataTree, sources: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of a result of `cross_check`, with the group `runs` of several runs.

    Parameters
    ----------
    tree : DataTree
        The result.
    sources : sequence of str
        What each record is.
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
        Block(consequences(tree), details, CONSEQUENCES),
    ]


def _coefficient_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """The coefficients, where a method gave any, and the equation of the answer."""
    if (main := findings.main_result(tree)) is not None:
        yield Block([verdict.reference_sentence(findings.second_of(tree))], Layer.EXPLAIN, COEFFICIENTS)
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
    # The largest amplitude that is known: an identification without a cross-check keeps no record.
    start = np.abs(np.ravel(result.start_angle.values)) if "start_angle" in result else np.array([])
    if np.any(start > 0.0):
        yield Block(physics_sentences(result, start), title=CONSEQUENCES)


def identification_table(tree: xr.DataTree) -> Table:
    """Coefficients by both methods with errors, how many errors apart they are, and what their models leave.

    A method that failed has no column. Errors are the total ones, of the noise and of the model.
    """
    checked, results = tree["comparison"].to_dataset(), findings.kept_results(tree)
    kept = checked.sel(model=list(results))
    # With one method there is no difference.
    z = dict(checked.z.to_series()) if len(results) > 1 else {}
    ratios = {name: f"{findings.residual_over_noise(tree, name):.3g} x noise" for name in results}
    noise = f"noise: {findings.record_noise(tree):.2g} {signal_units(tree)}"
    below = [{"force": "residual (RMS)", "formula": noise, **ratios}]
    stochastic = [bool(random_force_of(result)) for result in results.values()]
    further = {
        ("beyond the noise", "from (s)"): np.where(stochastic, np.nan, kept.departure_time.values),
        ("one sample ahead", "x stated error"): np.where(stochastic, kept.residual_over_noise.values, np.nan),
    }
    for (what, unit), values in further.items():
        if np.isfinite(values).any():
            cells = (f"{x:.3g}" if np.isfinite(x) else "-" for x in values)
            below.append({"force": what, "formula": unit, **dict(zip(results, cells, strict=True))})
    return layout.coefficient_table(results, z, below)


def consequences(tree: xr.DataTree) -> list[str]:
    """Return the consequences of the preferred result, in sentences; energies in J if possible.

    Nothing follows from a model that does not hold.
    """
    if not findings.holds(tree):
        undetermined = findings.verdict_of(tree) == "undetermined"
        return [NO_CONSEQUENCES.format("is not decided by" if undetermined else "does not explain")]
    result, at = tree[findings.answer_of(tree)].to_dataset(), findings.times_of_amplitudes(tree)
    return physics_sentences(result, findings.amplitudes(tree), si_of(tree), time=at)


def _weight(tree: xr.DataTree) -> list[str]:
    """Describe the forces behind the decay, by the preferred method, if its model is adequate."""
    result = verdict.answer_result(tree) if findings.holds(tree) else None
    at = findings.times_of_amplitudes(tree)
    return [] if result is None else weight_sentences(result, findings.amplitudes(tree), time=at)


def _answer(tree: xr.DataTree) -> str:
    """Name the preferred method where a test decides it."""
    decided = findings.verdict_of(tree) in ("approximate", "not explained") and not findings.failures(tree)
    answer = f"Answer: {findings.answer_of(tree)}, by its prediction of parts that were held out. "
    return answer if decided else ""


def _how_methods_agree(tree: xr.DataTree) -> Iterator[str]:
    """Describe the agreement of the methods and its test; nothing where one failed."""
    checked = tree["comparison"].to_dataset()
    attrs, p_value = checked.attrs, checked.p_value.item()
    pair = f"{attrs['first'].capitalize()} and {attrs['second']}"
    if findings.failures(tree):
        return
    if attrs["verdict"] == "unknown":
        yield f"{pair} cannot be compared: the error of their difference could not be computed."
        return
    explained, z = attrs.get("verdict_on_record", "").startswith("explained"), abs(checked.z.to_series())
    if attrs["verdict"] == "disagree":
        how = "disagree"
    elif p_value < BARELY:
        how = "agree, but barely"
    elif z.max() > AS_A_WHOLE:
        agree = "agree" if explained else "differ by no more than their errors"
        how = f"{agree} as a whole; {z.idxmax()} differs by {z.max():.2g} errors"
    else:
        how = f"{'agree within' if explained else 'differ by no more than'} their errors"
    yield f"{pair} {how}."
    stated = attrs.get("errors") == "stated"
    yield (
        f"Their differences: chi-square {checked.chi_square.item():.3g} for "
        f"{checked.degrees_of_freedom.item()} of them, p = {p_value:.2g} "
        f"({'the stated errors add' if stated else 'both methods see the same noise'})."
    )


# Remarks of a method on itself, by its attribute: what it says unless the remark applies, and the sentence.
REMARKS = {
    "first_order_bias_removed": ("yes", "The first-order bias of {} was not removed: {}."),
    "refined": (
        "True",
        "The columns of {} come from the smoothed record: the motion of its model does not follow the "
        "record.",
    ),
    "correlation_lags": (
        "0",
        "The residuals of {} are correlated; its errors take that into account (Newey and West).",
    ),
}


def _remarks(tree: xr.DataTree) -> Iterator[str]:
    """Describe limits of the methods: biases, correlation, constraints, and forces not identified."""
    results = findings.kept_results(tree)
    for method, result in results.items():
        for name, (usual, text) in REMARKS.items():
            said = str(result.attrs.get(name, usual))
            if said != usual:
                yield text.format(method, said[2:].strip(": .") or "as asked")
    yield from verdict.constraint_sentences(results.values())
    yield from verdict.identifiability_warnings(tree["comparison"].to_dataset().attrs)


def _stiffness(tree: xr.DataTree) -> Iterator[str]:
    """Report that a linear stiffness of the library cannot be identified."""
    second = findings.second_of(tree)
    stiffness = library_of(second, whole=True).role("x")
    if stiffness is not None and stiffness.symbol not in second.force:
        yield NO_STIFFNESS.format(stiffness.symbol)


def _own_quantity(tree: xr.DataTree) -> Iterator[str]:
    """Name the method that compares the measured quantity itself, with its bias; none of an angle."""
    for name, result in findings.kept_results(tree).items():
        if measured := result.attrs.get("compared_in"):
            biases = ", ".join(layout.values_with_errors(result.bias, result.bias_standard_error))
            times = int(tree[record_groups(tree)[0]].attrs.get("integrations", 0))
            yield (
                f"{name.capitalize()} compares the {measured} itself, with a bias of {biases} "
                f"{result.bias.attrs['units']} about the mean of its swing; the other method is of the "
                f"integral, residuals are of the {measured}{('', ' over w', ' over w^2')[times]}."
            )
            return


def identification_json(tree: xr.DataTree) -> dict[str, Any]:
    """A result of `cross_check` as plain data, see `identification_blocks`."""
    checked, failed = tree["comparison"].to_dataset(), findings.failures(tree)
    answer, si, methods, models = findings.answer_of(tree), si_of(tree), {}, {}
    withheld: dict[str, Any] = dict.fromkeys(layout.KEYS["identification"]) | {"coefficients": {}}
    for name in (checked.attrs["first"], checked.attrs["second"]):
        result = findings.with_error_parts(tree[name].to_dataset())
        held_out = {"held_out_rms": result.get("held_out_rms", np.nan)}
        methods[name] = withheld if name in failed else layout.mapped(result, "identification", held_out)
        methods[name] = methods[name] | {"failed": failed.get(name, "")}
        models[name] = layout.mapped(checked.sel(model=name), "motion") | {
            "residual_rms": findings.residual_of(tree, name),
            "residual_over_noise": findings.residual_over_noise(tree, name),
        }
    follows: dict[str, Any] = {"refused": consequences(tree)[0]}
    if findings.holds(tree):
        result, at = tree[answer].to_dataset(), findings.times_of_amplitudes(tree)
        follows = physics_json(result, findings.amplitudes(tree), si, time=at)
    compared = layout.mapped(checked, "cross_check")
    data = {
        **layout.records_json(tree),
        **random_force_json(tree),
        "answer": None if answer in failed else answer,
        "methods": methods,
        "cross_check": compared | {"models": models, "noise": findings.record_noise(tree)} | checked.attrs,
        "consequences": follows,
        "sufficient_forces": [
            {s: {"value": value, "standard_error": error} for s, (value, error) in forces.items()}
            for forces in findings.fewer_forces(tree)
        ],
    }
    if "runs" in tree:
        data["runs"] = verdict.runs_json(tree["runs"].to_dataset())
    if si is not None:
        friction = {MU: f"{MU}±"} if MU in si else {}
        data[SI] = layout.mapped(si, layout.KEYS["si"] | friction)
    return data
