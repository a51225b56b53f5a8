"""The laws as sentences, tables and plain data: friction against speed, restoring force over displacement."""

import json
from collections.abc import Iterator, Mapping, Sequence
from math import floor, log10
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from rich.table import Table

from sysid_trib.printing import ALWAYS, Block, Layer, driven, exported, layout
from sysid_trib.results import judged, law_curves
from sysid_trib.results.kinds import MU, is_of_driven
from sysid_trib.results.law_curves import (
    LARGE_DIFFERENCE,
    LAWS_SI,
    NO_BETTER,
    OWN_LAWS,
    PASSIVE,
    PASSIVE_DEFICIT,
    Curve,
)
from sysid_trib.results.models import library_of
from sysid_trib.results.variables import record_groups, signal_units, small_units

FRICTION_TITLE = "Friction against speed"
RESTORING_TITLE = "Restoring force against displacement"
RANGE_TITLE, DETAILS_TITLE = "Agreement and range", "Fit and test of the residual"
FORMULA_TITLE = "Formulas within the bands"
BOTH_TITLE = "Position and speed together"
# Largest number of printed formulas of a law.
FORMULAS_SHOWN = 4
# Places at which a law is shown, as fractions of the largest visited place; both sides if it is not odd.
SHOWN_PARTS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2)
SIDE_PARTS = (0.1, 0.4, 0.7, 1.0, 1.2)
# A motion that exceeds the visited range by this factor leaves it.
LARGER_MOTION = 1.02
REMAINING = (
    "The residual is not a function of speed or displacement alone. It may come from a force with memory, "
    "from one that changes with time or depends on both, or from an error of the sensor. sysid-trib discover "
    "tests for these."
)
NOT_ODD = (
    "The laws are not odd: friction differs between the directions of motion, or the "
    "restoring force between the sides."
)
ODD_COMPARED = "Averages over a cycle depend on the odd parts alone; the methods are compared by these."
ACTIVE_FRICTION = (
    "A passive contact cannot do that. The cause is an error of the sensor within the cycle, or another "
    "force."
)


def laws_blocks(tree: xr.DataTree, sources: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of a result of `laws`; `sources` describe the records."""
    details = Layer.EXPLAIN
    return [
        Block([verdict_sentence(tree)], ALWAYS),
        Block(sources),
        Block([*_no_curve(tree), *_method_sentences(tree)], ALWAYS),
        Block((), ALWAYS, FRICTION_TITLE, law_table(tree, "friction"), _caption(tree, "friction")),
        Block([*_energy_sentences(tree)], ALWAYS, FRICTION_TITLE),
        *_own_blocks(tree),
        *_restoring_blocks(tree),
        Block([*_remarks(tree), *_range_sentences(tree)], title=RANGE_TITLE),
        *_formula_blocks(tree),
        Block([*_interaction_sentences(tree)], title=BOTH_TITLE),
        Block([*_details(tree)], details, DETAILS_TITLE),
    ]


def _own_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Yield the laws of each run that has separate ones."""
    if OWN_LAWS not in tree.children:
        return
    own = tree[OWN_LAWS].to_dataset()
    for law in law_curves.laws_in(_preferred(tree)):
        curves = [law_curves.curve_of(own.sel(run=run), law) for run in own.run.values]
        if all(np.array_equal(curve.values, curves[0].values) for curve in curves):
            # All runs have this law in common.
            continue
        word, unit_at, unit = _words(tree, law)
        both = bool(np.any(curves[0].places < 0.0))
        whole = law_curves.curve_of(_preferred(tree), law)
        places = law_curves.places_shown(whole, SIDE_PARTS if both else SHOWN_PARTS)
        rows = []
        for at, place in enumerate(places):
            row = {word: f"{place:.3g}"}
            for run, curve in zip(own.run.values, curves, strict=True):
                part = curve.at(places)
                text = layout.value_with_error(part.values[at], part.errors[at])
                row[f"run {run}"] = text if part.visited[at] else f"({text})"
            rows.append(row)
        title = "Friction of each run" if law == "friction" else "Restoring force of each run"
        inertia = "inertia" if signal_units(tree) == "rad" else "mass"
        caption = (
            f"{title} over the {inertia} ({unit}) against {word} ({unit_at}), with standard errors; in "
            "parentheses beyond the range of the run. The table above shows the mean of the runs"
        )
        yield Block((), ALWAYS, title, layout.text_table(rows), caption)


def _restoring_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Yield the restoring force if there is one."""
    if law_curves.restores(_preferred(tree)):
        caption = _caption(tree, "restoring")
        yield Block((), ALWAYS, RESTORING_TITLE, law_table(tree, "restoring"), caption)


def verdict_sentence(tree: xr.DataTree) -> str:
    """Describe how closely the motion of the laws follows the record."""
    checked = tree["judged"]
    answer = judged.preferred_of(tree)
    decided = judged.verdict_of(tree)
    curves = not checked.attrs["reason"]
    name = "The laws" if curves else "The record does not determine a curve. Laws of the named forces"
    if decided == "explained":
        return f"{name} explain the record: the residual is noise."
    part = float(checked.residual_over_motion.sel(model=answer))
    near = "their motion diverges"
    if np.isfinite(part):
        near = f"their simulated motion differs from the record by {100.0 * part:.2g} % (RMS)"
        if not is_of_driven(tree):
            lasts = sum(float(np.ptp(tree[group].time.values)) for group in record_groups(tree))
            periods = lasts * float(tree[answer].asymptotic_frequency) / (2.0 * np.pi)
            ratio = judged.residual_over_noise(tree, answer)
            near = f"over {periods:.0f} periods {near}, {ratio:.3g} times the noise"
    how = "follow the record approximately" if decided == "approximate" else "do not follow the record"
    if law_curves.EXPLAINING_OWN in checked.attrs:
        return f"{name} {how}: {near}. {_differing_runs(checked.attrs[law_curves.EXPLAINING_OWN])}"
    # For curves, or if they do not follow the record better.
    return f"{name} {how}: {near}." + f" {REMAINING}" * (curves or checked.attrs["reason"] == NO_BETTER)


def _differing_runs(separate: str) -> str:
    """State that the runs differ, and the option that gives each run its own laws."""
    differ = "Laws explain each run alone, so the runs differ"
    if not separate:
        return (
            f"{differ}. Separate friction and restoring force do not explain them; identify each run alone."
        )
    names = separate.split(", ")
    words = " and ".join(law_curves.LAW_WORDS[name] for name in names)
    option = f"--own {','.join(names)}"
    return f"{differ}: with separate {words} for each run ({option}), the residual is noise."


def _no_curve(tree: xr.DataTree) -> Iterator[str]:
    """Give the reason why the record does not determine a curve, and the coefficients of the named forces."""
    if reason := tree["judged"].attrs["reason"]:
        yield reason
        result = _preferred(tree)
        forces = [result.sel(force=symbol) for symbol in result.force.values]
        fitted = [force for force in forces if force.standard_error.item() > 0.0]
        if fitted:
            values = ", ".join(f"{force.force.item()} = {layout.coefficient_text(force)}" for force in fitted)
            # Only the curves have errors of the model.
            errors = "" if judged.is_explained(tree) else ", with errors from noise alone"
            yield f"Named forces by {judged.preferred_of(tree)}{errors}: {values}."


def _method_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe the preferred method with the reason, the residuals, and failed methods."""
    attrs = tree["judged"].attrs
    results = judged.kept_results(tree)
    if attrs["averaging_failed"]:
        name = "Trajectory" if is_of_driven(tree) else "Averaging"
        yield f"{name} failed: {_ended(attrs['averaging_failed'])} The laws are those of direct alone."
    for name, why in judged.failures(tree).items():
        yield f"{name.capitalize()} failed: {why}. Its laws are not given."
    if len(results) == 2:
        yield f"Preferred method: {judged.preferred_of(tree)} ({_why(tree)})."
    yield from _residual_sentence(tree, list(results))


def _residual_sentence(tree: xr.DataTree, names: Sequence[str]) -> Iterator[str]:
    """Describe the residual of each method."""
    if not names:
        return
    if is_of_driven(tree):
        parts = tree["judged"].residual_over_motion
        texts = [f"{name} {100.0 * parts.sel(model=name).item():.3g} %" for name in names]
        yield f"Residuals (RMS): {' and '.join(texts)} of the motion."
    else:
        noise = layout.in_small_units(judged.record_noise(tree), signal_units(tree))
        texts = [f"{name} {judged.residual_over_noise(tree, name):.3g}" for name in names]
        yield f"Residuals (RMS): {' and '.join(texts)} times the noise, which is {noise}."


def _ended(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _why(tree: xr.DataTree) -> str:
    """Give the reason why a method is preferred."""
    answer = judged.preferred_of(tree)
    results = judged.kept_results(tree)
    (other,) = (name for name in results if name != answer)
    if is_of_driven(tree):
        return "its residual is smaller"
    held_out = {name: float(result.get("held_out_rms", np.nan)) for name, result in results.items()}
    if np.isnan(held_out[answer]):
        at_bound = answer == tree["judged"].model.values[-1]
        return "its residual is noise" + ", and its errors are the smallest" * at_bound
    if np.isnan(held_out[other]):
        return f"{other} predicts no held-out part"
    factor, unit = small_units(signal_units(tree))
    sizes = {name: f"{factor * rms:.3g}" for name, rms in held_out.items()}
    pair = f"residual {sizes[answer]} {unit} (RMS), {other} {sizes[other]} {unit}"
    if held_out[answer] <= held_out[other]:
        return f"it predicts the held-out parts better: {pair}"
    return f"it predicts the held-out parts about as well, and most sensor errors do not affect it: {pair}"


def law_table(tree: xr.DataTree, law: str) -> Table:
    """Return a law by each method at some places, their difference, and the band of the preferred one."""
    answer = judged.preferred_of(tree)
    curves = _chosen_curves(tree, law)
    if not curves:
        return layout.text_table([])
    main = curves[answer]
    deviations = _beyond_known(tree, law, curves)
    scale = 10.0 ** _power(tree, law)
    z = law_curves.difference_over_error(*curves.values()) if len(curves) == 2 else None
    rows = []
    for at, place in enumerate(main.places):
        row = {law_curves.VARIABLE_OF_LAW[law]: f"{place:.3g}"}
        if law == "restoring":
            row["whole"] = f"{main.values[at]:.4g}"
        for name, curve in deviations.items():
            row[name] = layout.value_with_error(curve.values[at] / scale, curve.errors[at] / scale)
        if z is not None:
            row["difference / error"] = f"{z[at]:+.1f}"
        row[f"95 % band of {answer}"] = _band(
            deviations[answer].low[at] / scale, deviations[answer].high[at] / scale
        )
        row["range"] = "visited" if main.visited[at] else "extrapolated"
        rows.append(row)
    return layout.text_table(rows, ("range",), ("range",))


def _beyond_known(tree: xr.DataTree, law: str, curves: Mapping[str, Curve]) -> dict[str, Curve]:
    """Return the whole friction, and the restoring force without its known part."""
    if law == "friction":
        return dict(curves)
    result = _preferred(tree)
    return {
        name: curve.without(law_curves.known_part(result, curve.places)[0]) for name, curve in curves.items()
    }


def _chosen_curves(tree: xr.DataTree, law: str) -> dict[str, Curve]:
    """Return the law by each method at the places that are shown."""
    answer = judged.preferred_of(tree)
    curves = law_curves.curves_of(judged.kept_results(tree), law, answer)
    if answer not in curves:
        return {}
    both = bool(np.any(curves[answer].places < 0.0))
    places = law_curves.places_shown(curves[answer], SIDE_PARTS if both else SHOWN_PARTS)
    return {name: curve.at(places) for name, curve in curves.items()}


def _words(tree: xr.DataTree, law: str) -> tuple[str, str, str]:
    """Return the argument of a law, its unit, and the unit of the force over the inertia."""
    unit = signal_units(tree)
    return (
        ("speed", f"{unit}/s", f"{unit}/s^2") if law == "friction" else ("displacement", unit, f"{unit}/s^2")
    )


def _caption(tree: xr.DataTree, law: str) -> str:
    """Return the caption above a table: its contents and units."""
    unit = signal_units(tree)
    power = _power(tree, law)
    w = _preferred(tree).reference_frequency.item()
    _, unit_at, unit_of = _words(tree, law)
    inertia = "inertia" if unit == "rad" else "mass"
    scaled = f"1e{power:+03d} {unit_of}" if power else unit_of
    if law == "friction":
        return f"Friction over the {inertia} ({scaled}) against speed ({unit_at}), with standard errors"
    held = law_curves.known_part(_preferred(tree), np.zeros(1))[1]
    known = " and ".join(["the straight line w^2 x", *held])
    return (
        f"Restoring force over the {inertia} ({unit_of}) against displacement ({unit_at}), with standard "
        f"errors. Column whole: all of it; the other columns: without {known}, w = {w:.6g} rad/s"
        f"{f', in {scaled}' * bool(power)}"
    )


def _power(tree: xr.DataTree, law: str) -> int:
    """Return the power of ten of the columns of a table."""
    curves = _beyond_known(tree, law, _chosen_curves(tree, law))
    if not curves:
        return 0
    size = float(np.median(np.abs(curves[judged.preferred_of(tree)].values)))
    power = floor(log10(size)) if size > 0.0 else 0
    return 0 if -3 < power < 4 else power


def _band(low: float, high: float) -> str:
    """Return the limits of a band, rounded to a tenth of its width."""
    width = abs(high - low)
    if not np.isfinite(width):
        return "-"
    digits = max(0, 1 - floor(log10(width))) if width > 0.0 else 4
    return f"{low:.{digits}f} to {high:.{digits}f}"


def _spans(spans: Sequence[tuple[float, float]], unit: str) -> str:
    """Return the ranges of speeds or displacements as text."""
    texts = [f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}" for low, high in spans]
    return f"{' and '.join(texts)} {unit}"


def _preferred(tree: xr.DataTree) -> xr.Dataset:
    return tree[judged.preferred_of(tree)].to_dataset()


def _energy_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe where friction feeds energy in, or would without the constraint of passivity."""
    if PASSIVE in tree["judged"].attrs:
        yield _passivity(tree)
    spans = law_curves.feeding(_preferred(tree))
    unit = _words(tree, "friction")[1]
    if spans["certainly"]:
        said = f"Friction feeds energy in at {_spans(spans['certainly'], unit)}, with all of its 95 % band."
        yield f"{said} {ACTIVE_FRICTION}"
    if spans["seemingly"]:
        yield (
            f"Friction is negative at {_spans(spans['seemingly'], unit)}, but its band contains positive "
            "values: the record does not determine whether it feeds energy in there."
        )
    if spans["beyond"]:
        yield (
            f"The extrapolated friction law would feed energy in at {_spans(spans['beyond'], unit)}, outside "
            "the range of the record: do not use it there."
        )


def _passivity(tree: xr.DataTree) -> str:
    """Describe the speeds at which the passivity constraint is active."""
    result = _preferred(tree)
    acting = json.loads(tree["judged"].attrs[PASSIVE])
    if not acting:
        return "The passivity constraint is not active: friction dissipates energy at every speed shown."
    places = result.speed.values
    largest = float(np.max(places[result.speed_visited.values]))
    speeds = np.array(acting)
    # At zero speed friction jumps; its limit there is not among the speeds shown.
    at_jump = np.abs(speeds) <= 2.0 * law_curves.NEXT_TO_ZERO
    where = ["next to zero speed"] if np.any(at_jump) else []
    if not np.all(at_jump):
        near = np.argmin(np.abs(places[:, None] - largest * speeds[~at_jump]), axis=0)
        spans = law_curves.stretches(places, np.isin(np.arange(len(places)), near))
        where.append(f"at {_spans(spans, _words(tree, 'friction')[1])}")
    deficit = tree["judged"].attrs[PASSIVE_DEFICIT]
    cause = (
        "The probable cause is an error of the sensor within the cycle, or another force."
        if deficit > LARGE_DIFFERENCE
        else "The record does not determine whether friction feeds energy in."
    )
    return (
        f"The passivity constraint is active {' and '.join(where)}: without it, friction would be negative, "
        f"by up to {deficit:.2g} standard errors. {cause}"
    )


def _remarks(tree: xr.DataTree) -> Iterator[str]:
    """Describe the agreement of the methods, even parts, and fitted errors of the sensor."""
    results = judged.kept_results(tree)
    if len(results) == 2:
        yield from _differences(tree)
    attrs = tree["judged"].attrs
    result = _preferred(tree)
    two_sided = (np.any(result[place].values < 0.0) for place in law_curves.VARIABLE_OF_LAW.values())
    if any(two_sided):
        yield NOT_ODD + f" {ODD_COMPARED}" * ("averaging" in results)
    if attrs["sensor"]:
        yield _sensor_sentence(tree, attrs["sensor"].split(", "))


def _differences(tree: xr.DataTree) -> Iterator[str]:
    """Describe where the laws of both methods differ significantly."""
    largest: dict[str, float] = {}
    for law, word in (("friction", "friction"), ("restoring", "the restoring force")):
        if law == "restoring" and not law_curves.restores(_preferred(tree)):
            continue
        places, z = law_curves.apart(judged.kept_results(tree), law)
        far = law_curves.stretches(places, np.abs(z) > LARGE_DIFFERENCE)
        largest[word.removeprefix("the ")] = float(np.max(np.abs(z)))
        if far:
            unit = _words(tree, law)[1]
            yield (
                f"The methods disagree in {word} at {_spans(far, unit)}, by up to {np.max(np.abs(z)):.3g} "
                "combined standard errors."
            )
    if max(largest.values()) <= LARGE_DIFFERENCE:
        texts = " and ".join(f"{size:.2g} ({word})" for word, size in largest.items())
        yield f"The methods agree: they differ by at most {texts} combined standard errors."
    elif "averaging" in judged.kept_results(tree):
        yield (
            "Direct uses the motion within each cycle, and averaging uses the change from cycle to cycle. A "
            "missing force biases the two methods differently."
        )


def _formula_blocks(tree: xr.DataTree) -> Iterator[Block]:
    """Yield a table of the sums of library forces that stay within the band of each law."""
    if tree["judged"].attrs["reason"]:
        return
    for law, words in (("friction", "the friction law"), ("restoring", "the restoring-force law")):
        name = f"{law}_formulas"
        if law == "restoring" and not law_curves.restores(_preferred(tree)):
            continue
        if name not in tree.children:
            sentence = f"No sum of up to three library forces stays within the band of {words}."
            yield Block([sentence], title=FORMULA_TITLE)
            continue
        listed = tree[name].to_dataset()
        count = min(FORMULAS_SHOWN, listed.sizes["alternative"])
        rows = [{"formula": _formula_text(listed.isel(alternative=at))} for at in range(count)]
        caption = f"Formulas within the band of {words}, divided by w^2"
        if "held_out_rms" in listed:
            unit = signal_units(tree)
            for row, rms in zip(rows, listed.held_out_rms.values[:count].tolist(), strict=True):
                row["residual"] = _residual_text(rms, unit)
            of_laws = _residual_text(listed.held_out_rms_of_laws.item(), unit)
            caption += f"; residual (RMS) on the held-out last third, {of_laws} for the curves"
        yield Block((), title=FORMULA_TITLE, table=layout.text_table(rows, ("formula",)), caption=caption)


def _interaction_sentences(tree: xr.DataTree) -> Iterator[str]:
    """State whether the force is a sum of both laws, and which readings the record does not separate."""
    if "readings" in tree.children:
        yield from _reading_sentences(tree["readings"].to_dataset(), signal_units(tree))
    if "interaction" in tree.children:
        products = tree["interaction"]
        p_value = layout.p_value_text(products.p_value.item())
        yield (
            "The force is not a law of speed plus a law of displacement (p "
            f"{p_value}): with products of both, the residual falls to "
            f"{products.residual_after.item() / products.residual_before.item():.0%} of its value. The group "
            "`interaction` of the result and its figure show the additional force."
        )


def _reading_sentences(both: xr.Dataset, unit: str) -> Iterator[str]:
    """State which combination of a friction law and of products the record determines."""
    if bool(both.separated.item()):
        return
    size = max(abs(both["sum"].item()), 1e-300)
    of_both, of_speed = (100.0 * both[error].item() / size for error in ("standard_error", "error_of_law"))
    yield (
        "The record does not separate friction that changes with the speed from friction that depends on "
        f"the position: over a cycle of {both.amplitude.item():.2g} {unit}, the damping by both together "
        f"has an error of {of_both:.2g} %, that by the speed alone {of_speed:.2g} %. The bands are valid if "
        "friction depends on the speed alone."
    )


def _residual_text(rms: float, unit: str) -> str:
    """Return the held-out residual of a model, or that it predicts no motion."""
    return layout.in_small_units(rms, unit) if np.isfinite(rms) else "no motion"


def _formula_text(formula: xr.Dataset) -> str:
    """Return a sum of forces with its coefficients, `0.0049*2*v + 0.037*v*abs(v)`."""
    kept = np.flatnonzero(np.isfinite(formula.coefficient.values))
    terms = [f"{formula.coefficient.values[at]:.4g}*({formula.formula.values[at]})" for at in kept]
    return " + ".join(terms).replace("+ -", "- ")


def _sensor_sentence(tree: xr.DataTree, symbols: Sequence[str]) -> str:
    """Return the fitted terms of the sensor, with the values of each run."""
    result = tree[str(tree["judged"].model.values[-1])].to_dataset()
    library = library_of(result, whole=True)
    known = result.force.values.tolist()
    texts = []
    for symbol in symbols:
        own = [name for name in known if name == symbol or name.rsplit("_", 1)[0] == symbol]
        values = [layout.coefficient_text(result.sel(force=name)) for name in own]
        name = library[own[0]].name if own else symbol
        texts += [f"{name} ({symbol}) {', '.join(values)}"] if own else []
    owner = ", one for each run" if len(record_groups(tree)) > 1 else ""
    return (
        f"Besides the laws, direct fits errors of the sensor{owner}, which are no part of the oscillator: "
        f"{'; '.join(texts)}."
    )


def _range_sentences(tree: xr.DataTree) -> Iterator[str]:
    """Describe the range that the record visits, and the extrapolation."""
    result = _preferred(tree)
    reached = {}
    for law, variable in law_curves.VARIABLE_OF_LAW.items():
        curve = law_curves.curve_of(result, law)
        reached[variable] = float(np.max(np.abs(curve.places[curve.visited])))
    extrapolated = 1.0 - float(result.speed_visited.mean())
    texts = [f"speeds up to {reached['speed']:.3g} {_words(tree, 'friction')[1]}"]
    if law_curves.restores(result):
        texts.append(f"displacements up to {reached['displacement']:.3g} {signal_units(tree)}")
    smallest = ""
    if not is_of_driven(tree):
        least = float(np.min(np.abs(judged.amplitudes(tree))))
        smallest = f", at amplitudes down to {least:.2g} {signal_units(tree)}"
    yield (
        f"The record covers {' and '.join(texts)}{smallest}. Beyond that range ({100.0 * extrapolated:.0f} % "
        "of the curves) the laws are extrapolated by straight lines and named forces."
    )


def _details(tree: xr.DataTree) -> Iterator[str]:
    """Describe the unpenalised forces, the test of the residual, and the parts of the errors."""
    result = _preferred(tree)
    library = library_of(result, whole=True)
    constraint = result.coords.get("constraint")
    held = set()
    if constraint is not None:
        held = {
            name for name, kind in zip(result.force.values, constraint.values, strict=True) if kind == "fixed"
        }
    smooth = [force.symbol for force in library if not force.curve and force.kind != "sensor"]
    free = [symbol for symbol in smooth if symbol not in held]
    if free:
        yield f"Named forces, fitted without the smoothness penalty: {', '.join(free)}."
    if held:
        values = ", ".join(f"{name} = {result.coefficient.sel(force=name).item():g}" for name in sorted(held))
        yield f"Held: {values}."
    p_value = layout.p_value_text(float(tree["judged"].p_value.max()))
    yield f"Test that the residual is white noise: p {p_value}."
    for law in law_curves.laws_in(result):
        curve = law_curves.curve_of(result, law)
        model = result[f"{law}_error_of_model"].values[curve.visited]
        if np.any(model > 0.0):
            part = float(np.max(model / curve.errors[curve.visited]))
            word = "friction" if law == "friction" else "restoring force"
            yield (
                f"The model error, from the change of the {word} between parts of the record, is up to "
                f"{100.0 * part:.0f} % of its standard error."
            )


def prediction_block(tree: xr.DataTree, predicted: Sequence[xr.Dataset]) -> Block:
    """Return the residuals of predicted records, and whether these leave the visited range."""
    sentences = list(driven.prediction_block(predicted).sentences)
    reached = {
        variable: float(np.max(np.abs(curve.places[curve.visited])))
        for law, variable in law_curves.VARIABLE_OF_LAW.items()
        for curve in [law_curves.curve_of(_preferred(tree), law)]
    }
    for record in predicted:
        largest = float(np.abs(record.predicted_angle - record.predicted_angle.mean()).max())
        if law_curves.restores(_preferred(tree)) and largest > LARGER_MOTION * reached["displacement"]:
            sentences.append(
                f"This record swings up to {largest:.3g} {signal_units(tree)}, beyond the "
                f"{reached['displacement']:.3g} {signal_units(tree)} covered by the laws: that part of the "
                "prediction is an extrapolation."
            )
    return Block(sentences, ALWAYS)


def laws_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return a result of `laws` as plain data: keys are the names of the variables."""
    checked = tree["judged"].to_dataset()
    results = judged.kept_results(tree)
    methods = {name: layout.mapped(result, "laws") for name, result in results.items()}
    preferred = results.get(judged.preferred_of(tree))
    return {
        **layout.records_json(tree),
        "answer": judged.preferred_of(tree) if preferred is not None else None,
        "verdict": judged.verdict_of(tree),
        "methods": methods,
        **layout.judged_json(tree),
        "agreement": dict(tree["agreement"].data_vars) if "agreement" in tree.children else {},
        "noise": judged.record_noise(tree),
        **{name: checked.attrs[name] for name in ("even", "sensor", "reason", "averaging_failed", "options")},
        "feeds_energy": law_curves.feeding(preferred) if preferred is not None else {},
        **({OWN_LAWS: tree[OWN_LAWS].to_dataset()} if OWN_LAWS in tree.children else {}),
    }


def si_rows(data: xr.Dataset) -> Iterator[dict[str, Any]]:
    """Return the laws in SI units and the coefficient of friction, one row per place."""
    for law in ("friction", "restoring", MU):
        if law not in data:
            continue
        variable = "sliding_speed" if law == MU else str(data[law].dims[0])
        visited = data[f"{data[law].dims[0]}_visited"].values
        ends = {end: data[f"{law}_{end}"].values for end in ("standard_error", "low", "high")}
        for at, place in enumerate(data[variable].values.tolist()):
            yield {
                "method": f"{data.attrs['of_method']} in SI units",
                "law": law,
                "variable": variable,
                "at": place,
                "unit_at": data[variable].attrs["units"],
                "value": data[law].values[at],
                **{end: values[at] for end, values in ends.items()},
                "unit": data[law].attrs["units"],
                "visited": bool(visited[at]),
            }


def _law_rows(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    """Yield the preferred laws, and those of each run that has separate ones, one row per place."""
    result = _preferred(tree)
    preferred = judged.preferred_of(tree)
    yield from _rows_of_curves(tree, result, preferred)
    if OWN_LAWS in tree.children:
        own = tree[OWN_LAWS].to_dataset()
        for run in own.run.values.tolist():
            yield from _rows_of_curves(tree, own.sel(run=run), f"{preferred}, run {run}")
    if LAWS_SI in tree.children:
        yield from si_rows(tree[LAWS_SI].to_dataset())


def _rows_of_curves(tree: xr.DataTree, result: xr.Dataset, method: str) -> Iterator[dict[str, Any]]:
    """Yield the laws of a dataset by the name of their method, one row per place."""
    for law in law_curves.laws_in(_preferred(tree)):
        variable = law_curves.VARIABLE_OF_LAW[law]
        curve = law_curves.curve_of(result, law)
        model = result[f"{law}_error_of_model"].values
        _, unit_at, unit = _words(tree, law)
        for at, place in enumerate(curve.places.tolist()):
            yield {
                "method": method,
                "law": law,
                "variable": variable,
                "at": place,
                "unit_at": unit_at,
                "value": curve.values[at],
                "standard_error": curve.errors[at],
                "low": curve.low[at],
                "high": curve.high[at],
                "error_of_model": model[at],
                "unit": unit,
                "visited": bool(curve.visited[at]),
            }


def laws_csv(tree: xr.DataTree) -> str:
    """Return the preferred laws with their bands, one row per place."""
    rows = list(_law_rows(tree))
    return layout.csv_of(list(rows[0]), rows)


def laws_latex(tree: xr.DataTree) -> str:
    r"""Return the preferred laws at some places as a table (`booktabs`)."""
    answer = judged.preferred_of(tree)
    tables = []
    for law in law_curves.laws_in(_preferred(tree)):
        curves = _chosen_curves(tree, law)
        curve = curves[answer]
        kind, unit_at, unit = _words(tree, law)
        columns: dict[str, list[str]] = {
            f"{kind} ({_unit(unit_at)})": [f"{place:.3g}" for place in curve.places]
        }
        if law == "restoring":
            columns[f"restoring force ({_unit(unit)})"] = [f"{value:.4g}" for value in curve.values]
            curve = _beyond_known(tree, law, curves)[answer]
        held = law_curves.known_part(_preferred(tree), np.zeros(1))[1]
        deviation = " and ".join([r"beyond $\omega^2 x$", *map(exported.plain_latex, held)])
        head = "friction" if law == "friction" else deviation
        numbers = layout.values_with_errors(curve.values, curve.errors)
        columns[f"{head} ({_unit(unit)})"] = [exported.in_latex(number) for number in numbers]
        pairs = zip(curve.low, curve.high, strict=True)
        columns[r"95\,\% band"] = [f"${_band(low, high).replace(' to ', '$ to $')}$" for low, high in pairs]
        columns["range"] = ["visited" if seen else "extrapolated" for seen in curve.visited]
        table = pd.DataFrame(columns)
        column_format = "r" * (table.shape[1] - 1) + "l"
        tables.append(table.to_latex(index=False, column_format=column_format).rstrip())
    inertia = "inertia" if signal_units(tree) == "rad" else "mass"
    record = "; ".join(f"{name}: {text}" for name, text in exported.about_the_record(tree).items())
    caption = exported.plain_latex(
        f"Friction and restoring force over the {inertia} by {answer}, with standard errors and simultaneous "
        f"95 % bands. {record[:1].upper()}{record[1:]}."
    )
    lines = [r"\begin{table}", r"\centering", rf"\caption{{{caption}}}", *tables, r"\end{table}", ""]
    return "\n".join(lines)


def _unit(unit: str) -> str:
    """Return a unit such as `rad/s^2` in LaTeX."""
    over, _, under = unit.rpartition("/s")
    if not over:
        return exported.unit_in_latex(unit)
    return exported.unit_in_latex(f"{over} s{'-2' if under else '-1'}")
