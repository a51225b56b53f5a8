"""The verdict in sentences: is the record explained, do its runs differ, and what follows."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing import Block, Layer, layout
from sysid_trib.printing.sureness import NOT_FOLLOWED, not_followed
from sysid_trib.results import judged
from sysid_trib.results.effects import SIGNIFICANT_ERRORS, at_bound
from sysid_trib.results.variables import record_groups, signal_units

# Group with the test of each model of a discovery, and its variables in the JSON.
GROUP = "homogeneity"
TESTED = ("chi_square", "degrees_of_freedom", "p_value")

# Sentences for each verdict on the magnitude of the random force in all runs.
DENSITY_VERDICTS = {
    "unknown": "The size of the random force cannot be compared between the runs.",
    "disagree": "The size of the random force differs between the runs (p {}).",
    "agree": "No difference between the runs was found in the size of the random force (p {}): it may be a "
    "property of the experiment.",
}


def runs_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Return the results of each run, and the test of their differences (see `run_agreement`)."""
    if "runs" not in tree:
        return
    runs = tree["runs"].to_dataset()
    rows = []
    for name, row in layout.by_label(runs, "quantity").items():
        cells = layout.values_with_errors(row.value, row.standard_error)
        by_run = {f"run {at}": cell for at, cell in enumerate(cells, 1)}
        rows.append({"quantity": name, **by_run, "p": layout.p_value_text(row.p_value.item(), "")})
    table = layout.text_table(rows, ("quantity",))
    yield Block((), Layer.EXPLAIN, "Agreement of the runs", table, "Each run alone")
    yield Block([*runs_sentences(runs)], title="Agreement of the runs")


def runs_sentences(runs: xr.Dataset) -> Iterator[str]:
    """Describe runs that cannot be used alone, the test of all differences, and the differing force."""
    for run, why in enumerate(runs.reason.values.tolist(), 1):
        if why:
            yield f"Run {run} alone does not determine the coefficients: {why}"
    if runs.attrs["verdict"] == "unknown":
        yield "The difference between the runs cannot be tested."
    else:
        p_values = runs.p_value.fillna(1.0).to_series()
        worst = f"{p_values.idxmin()} (p {layout.p_value_text(p_values.min())})"
        yield _test_of_runs(runs, worst if runs.attrs["verdict"] == "disagree" else "", "total_")
    if density := runs.attrs.get("density_verdict"):
        yield DENSITY_VERDICTS[density].format(layout.p_value_text(runs.density_p_value.item()))


def heterogeneity_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe the test whether the final model of a discovery fits all runs; nothing for one run."""
    if GROUP in tree.children:
        last = tree[GROUP].to_dataset().isel(model=-1)
        yield _test_of_runs(last, last.most.item() if last.differ else "")


def step_heterogeneity_sentences(tree: xr.DataTree, at: int) -> Iterator[str]:
    """Report if coefficients that differ between runs explain as much as the effect of a step."""
    before = tree[GROUP].to_dataset().isel(model=at) if GROUP in tree.children else None
    if before is not None and before.chi_square >= before.gain:
        yield (
            f"Differences between the runs (largest in {before.most.item()}) would explain as much or more: "
            f"chi-square {before.chi_square.item():.3g} for {before.degrees_of_freedom.item()} differences, "
            f"{before.gain.item():.3g} for the effect."
        )


def _test_of_runs(test: xr.Dataset, most: str, prefix: str = "") -> str:
    """Return the result of a test for differing runs; the largest difference is in `most`, or in none."""
    chi_square, degrees, p_value = (test[f"{prefix}{name}"].item() for name in TESTED)
    result = f"chi-square {chi_square:.3g} for {degrees:.0f} differences, p {layout.p_value_text(p_value)}"
    if not most:
        return f"No difference between the runs was found: {result}."
    return (
        f"The runs differ: {result}. The largest difference is in {most}: it changes from run to run, or "
        "with amplitude because a force has another form. The common errors are then too small."
    )


# Sentences for each verdict.
EXPLAINED = {
    "explained": "The model explains the record: the residual is noise.",
    "explained with a random force": "The model explains the record with a random force, which depends on "
    "neither angle, speed, amplitude nor time.",
    "undetermined": "The record does not determine the forces: no coefficient, and no combination of them, "
    f"differs from zero by more than {SIGNIFICANT_ERRORS:g} standard errors. It cannot test this model.",
}
LACKING = "A force is missing, or one has a different form."
UNEXPLAINED_SENTENCES = {
    "approximate": f"The model is approximate: {{}}. {LACKING}",
    "not explained": f"The model does not explain the record: {{}}. {LACKING}",
}
EXPLAINED_BUT_LINE = "The model explains the record: the residual is noise and a spectral line."
OF_A_RATE = " (The residual of an integrated rate is always larger than its noise.)"
NOT_SEPARATED = (
    "The record does not separate these forces: each may be zero, but not all of them. Fewer forces "
    "suffice: {}."
)
EFFECTIVE = "The model is incomplete, so these coefficients are effective values"


def verdict_sentence(tree: xr.DataTree) -> str:
    """Return the verdict on the record in words that require no statistics."""
    verdict = judged.verdict_of(tree)
    preferred = judged.preferred_of(tree)
    if verdict not in UNEXPLAINED_SENTENCES:
        with_line = verdict == "explained" and [*line_sentences(tree)]
        return EXPLAINED_BUT_LINE if with_line else EXPLAINED[verdict]
    if "random_force" in tree.children and (reasons := not_followed(tree)):
        return NOT_FOLLOWED.format(f"{reasons[0][0].lower()}{reasons[0][1:]}")
    part = float(tree["judged"].residual_over_motion.sel(model=preferred))
    how_far = "its simulated motion diverges"
    if np.isfinite(part):
        lasts = sum(float(np.ptp(tree[group].time.values)) for group in record_groups(tree))
        periods = lasts * float(tree[preferred].asymptotic_frequency) / (2.0 * np.pi)
        how_far = (
            f"over {periods:.0f} periods its simulated motion differs from the record by "
            f"{100.0 * part:.2g} % (RMS), {judged.residual_over_noise(tree, preferred):.3g} times the noise"
            f"{_small_but_not_white(tree, preferred)}"
        )
    wrong = _departures_sentence(tree, preferred)
    rate = tree[record_groups(tree)[0]].attrs.get("signal") == "rate"
    said = UNEXPLAINED_SENTENCES[verdict].format(f"{how_far}; {wrong}" if wrong else how_far)
    return said + OF_A_RATE * rate


# A residual below this multiple of the noise is not too large. A p-value below this level shows all the same
# that the model is incomplete.
NEAR_NOISE = 1.2
CLEARLY_NOT_WHITE = 0.01


def _small_but_not_white(tree: xr.DataTree, model: str) -> str:
    """Say that a residual as small as the noise is not white; empty if its size already shows that."""
    p_value = float(tree["judged"].p_value.sel(model=model))
    if judged.residual_over_noise(tree, model) > NEAR_NOISE or not p_value < CLEARLY_NOT_WHITE:
        return ""
    return f", but this residual is not white noise (p = {p_value:.2g})"


CURVE_WORDS = {"frequency": "frequency", "damping_ratio": "damping"}


def _departures_sentence(tree: xr.DataTree, model: str) -> str:
    """Describe the amplitudes at which frequency and damping of a model are wrong, in the worst run."""
    groups = [name for name in tree.children if name.startswith("lack_of_fit")]
    of_runs = [tree[group].to_dataset().sel(model=model) for group in groups]
    farthest = max(of_runs, key=lambda of: float(abs(of.departure).max()), default=None)
    if farthest is None:
        return ""
    sizes = abs(farthest.departure).to_series().sort_values(ascending=False, kind="stable")
    said = []
    for curve in sizes.index[sizes > 0.0]:
        low, high = (float(farthest[f"departure_{end}"].sel(curve=curve)) for end in ("low", "high"))
        said.append(f"its {CURVE_WORDS[curve]} is wrong {amplitude_range(low, high, signal_units(tree))}")
    return " and ".join(said)


def amplitude_range(low: float, high: float, unit: str) -> str:
    """Return a range of amplitudes in words: "above 0.4 rad"."""
    if low == 0.0:
        return "at all amplitudes" if np.isinf(high) else f"below {high:.2g} {unit}"
    if np.isinf(high):
        return f"above {low:.2g} {unit}"
    if f"{low:.2g}" == f"{high:.2g}":
        return f"at {low:.2g} {unit}"
    return f"between {low:.2g} and {high:.2g} {unit}"


def test_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe the tests behind the verdict, and the two parts of each error of the preferred model."""
    p_value = layout.p_value_text(float(tree["judged"].p_value.max()))
    said = f"Test that the residual is white noise: p {p_value}."
    result = judged.preferred_result(tree)
    if "random_force" in tree.children and not not_followed(tree):
        p_value = layout.p_value_text(float(tree["judged"].random_force_p[-1]))
        said += f" Test that the random force is independent of motion and time: p {p_value}."
    yield said
    if result is not None and "error_of_model" in result:
        yield error_parts_sentence(judged.preferred_of(tree), result)


def error_parts_sentence(name: str, result: xr.Dataset) -> str:
    """Return the two parts of each error of an identification."""
    parts = zip(result.force.values.tolist(), *judged.error_parts(result), strict=True)
    # Fixed values, and values that follow from the frequency, have no parts.
    texts = ", ".join(f"{force} {noise:.2g} and {model:.2g}" for force, noise, model in parts if noise > 0.0)
    return f"Standard errors of {name}, by the noise and by the model: {texts}."


def line_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe a spectral line in the residual of the preferred method."""
    of_answer = judged.judged_of(tree).sel(model=judged.preferred_of(tree))
    frequency = float(of_answer.spectral_line)
    if np.isfinite(frequency):
        size = layout.in_small_units(float(of_answer.spectral_line_amplitude), signal_units(tree))
        yield (
            f"The residual contains a spectral line at {frequency / (2.0 * np.pi):.4g} Hz of {size}: hum, "
            "perhaps aliased from above half the sampling rate, or another mode. Remove it, or filter it."
        )


def effective_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Report failed methods, and state that coefficients of an incomplete model are effective values."""
    for name, reason in judged.failures(tree).items():
        yield f"{name.capitalize()} failed: {reason}. Its coefficients are not given."
    results = judged.kept_results(tree)
    if not judged.is_unexplained(tree) or not results:
        return
    result = results.get(judged.preferred_of(tree), next(reversed(results.values())))
    noise, model = judged.error_parts(result)
    if np.any(model > 0.0):
        known = noise > 0.0
        ratios = np.hypot(noise, model)[known] / noise[known]
        factor = float(np.max(ratios, initial=1.0))
        yield (
            f"{EFFECTIVE}. Standard errors include the change between parts of the record: they are up to "
            f"{factor:.3g} times the errors from noise alone (--explain)."
        )
    elif "error_of_model" in result:
        yield f"{EFFECTIVE}; between parts of the record they change by no more than their errors."
    else:
        yield f"{EFFECTIVE}, which may be off by far more than their errors."


def error_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe the fewest sufficient forces, equally good ones, and the error of the calibration."""
    result = judged.preferred_result(tree)
    if choices := judged.fewer_forces(tree):
        unit = tree[judged.preferred_of(tree)].to_dataset().unit
        likeliest = ", ".join(
            layout.with_unit(
                f"{symbol} = {layout.value_with_error(*quantity)}", unit.sel(force=symbol).item()
            )
            for symbol, quantity in choices[0].items()
        )
        yield NOT_SEPARATED.format("; or ".join([likeliest, *map(" and ".join, choices[1:])]))
    if result is not None and "error_of_calibration" in result:
        others = np.hypot(*judged.error_parts(result))
        parts = zip(result.force.values, others, result.error_of_calibration.values, strict=True)
        texts = [
            f"{name} {part:.2g} (all other causes {other:.2g})" for name, other, part in parts if part > 0.0
        ]
        yield f"Errors include that of the scale: {', '.join(texts) or 'it changes no coefficient'}."


# Attributes of a comparison that cause warnings, and their sentences.
ENVELOPE = "Methods of the envelope and the frequency, such as averaging, cannot"
UNIDENTIFIABLE = {
    "no_method_identifies": "No method here identifies: {}.",
    "no_method_can_tell_apart": "No method can separate: {}.",
    "averaging_cannot_tell_apart": f"{ENVELOPE} separate: {{}}.",
    "averaging_cannot_see": f"{ENVELOPE} identify: {{}}.",
}


def constraint_sentences(results: Iterable[xr.Dataset]) -> Iterator[str]:
    """List the coefficients that are fixed, tied or at a bound; nothing if there are none."""
    parts = []
    results = list(results)
    for result in results:
        for symbol, row in layout.by_label(result, "force").items():
            if kind := row.coords.get("constraint", xr.DataArray("")).item():
                parts.append(kind if "=" in kind else f"{symbol} is {kind} ({row.coefficient.item():.6g})")
    if parts:
        bounded = list(dict.fromkeys(symbol for result in results for symbol in at_bound(result)))
        allowed = f", but treat those at a bound ({', '.join(bounded)}) as free" if bounded else ""
        listed = "; ".join(dict.fromkeys(parts))
        yield f"Constraints: {listed}. Standard errors assume these constraints{allowed}."


def identifiability_warnings(attrs: Mapping[str, Any]) -> list[str]:
    """List what the methods cannot identify or separate in principle, from attributes of a comparison."""
    return [text.format(attrs[key]) for key, text in UNIDENTIFIABLE.items() if attrs.get(key)]


def reference_sentence(result: xr.Dataset) -> str:
    """Return the frequency to which coefficients refer, and their units."""
    w = result.reference_frequency.item()
    refers = ["Coefficients refer to w of their method"]
    units = ["They are dimensionless"]
    for symbol, row in layout.by_label(result, "force").items():
        if not np.isclose(row.refers_to.item(), w, rtol=1e-12):
            refers.append(f"{symbol} to {row.refers_to.item():.6g} rad/s")
        if row.unit.item() != "1":
            units.append(f"{symbol} in {row.unit.item()}")
    return f"{'; '.join(refers)}. {'; '.join(units)}."


def runs_json(runs: xr.Dataset) -> dict[str, Any]:
    """Return the test of runs of one experiment as plain data."""
    densities = {"random_force": layout.KEYS["densities"]} if "density_verdict" in runs.attrs else {}
    return layout.mapped(runs, layout.KEYS["runs"] | densities)
