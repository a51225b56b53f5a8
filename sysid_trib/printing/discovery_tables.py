"""Common parts of the blocks of a discovery: tables of effects and candidates, residual in sentences."""

from collections.abc import Iterator

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.arrays import root_mean_square
from sysid_trib.printing import layout
from sysid_trib.results import effects
from sysid_trib.results.judged import record_noise, residual_of, residual_over_noise
from sysid_trib.results.kinds import has_input
from sysid_trib.results.random_force import DENSITY_UNITS
from sysid_trib.results.variables import record_groups, signal_units, small_units

# Number of candidates in the table with the highest score at any step, and at the last.
ROWS, LAST = 10, 3
# Number of inseparable candidates that are named with an effect.
TIES_NAMED = 2
RANKING = (
    "Score |z| of the named and the strongest candidates before each step and at the end, at the shape "
    "parameters with the largest |z|; -: in the model, or not tested; detectable: the coefficient of five "
    "standard errors in the final model"
)
UNKNOWN = "The residual does not follow the motion: it is external vibration, or noise of another kind."
# Ranges named in a sentence; a residual that is large everywhere needs none.
WHERE = {
    "large amplitude": ", mostly at large amplitude",
    "small amplitude": ", mostly at small amplitude",
    "late times": ", growing with time",
}
CONSERVATIVE, DISSIPATIVE = "conservative", "dissipative"
EVEN, TILTED = "even", "friction that differs between the sides"
SENSOR_CURVE = "an even force is missing, or the sensor is nonlinear"
# Meanings of the types of force in the omnibus test, alone and together.
MEANINGS = {
    frozenset({CONSERVATIVE}): "a conservative force is missing, or the clock is wrong",
    frozenset({DISSIPATIVE}): "a dissipative force is missing",
    frozenset({EVEN}): SENSOR_CURVE,
    frozenset({TILTED}): f"{TILTED} is missing, or the sensor is nonlinear",
    frozenset({CONSERVATIVE, DISSIPATIVE}): "forces of both types are missing, or a history-dependent one",
    frozenset({EVEN, TILTED}): SENSOR_CURVE,
}
# A second type whose score reaches this fraction of the first cannot be excluded.
NEARLY_AS_HIGH = 0.8


def effects_table(tree: xr.DataTree, *, details: bool = False) -> Table | None:
    """Return the table of added effects, in order, with residuals over the noise; None if there are none.

    `fitted` is the residual in the part to which the models of the search were fitted.

    Parameters
    ----------
    tree : DataTree
        Result of `discover`.
    details : bool
        Also show by how much each effect lowers the deviance, and the random force before and after.
    """
    noise, held, rows = record_noise(tree), tree["holdout"].rms.values, []
    for at, step in enumerate(effects.steps_taken(tree)):
        of_sensor = " (error of the sensor)" if step.kind.item() == "sensor" else ""
        row = {
            "effect": _effect_name(step),
            "name": f"{step['name'].item()}{of_sensor}",
            "formula": formula_text(step),
            "coefficient": layout.coefficient_text(step),
            "corrected p": layout.p_value_text(step.p_value.item(), ""),
            "fitted / noise": _to([step.residual_before.item(), step.residual_after.item()], noise),
            "held out / noise": _to(held[at : at + 2], noise),
        }
        if details:
            units = step.random_force_before.attrs.get("units", DENSITY_UNITS)
            forces = [step.random_force_before.item(), step.random_force_after.item()]
            row |= {
                "decrease of the deviance": f"{step.gain.item():.3g}",
                f"random force ({units})": _to(forces),
            }
        rows.append(row)
    return layout.text_table(rows, ("effect", "name", "formula"), ("effect",)) if rows else None


def _to(values: list[float], unit: float = 1.0) -> str:
    """Join values before and after a step; a model that diverges has none."""
    return " to ".join(f"{value / unit:.3g}" if np.isfinite(value) else "-" for value in values)


def _effect_name(step: xr.Dataset) -> str:
    """Return the symbol of an effect, or of the more probable effect whose place it takes."""
    symbol, named = step.symbol.item(), effects.named_effect(step)
    return symbol if named == symbol else f"{named} (fitted by {symbol})"


def effect_with_ties(step: xr.Dataset) -> str:
    """Return an effect with those that it cannot be separated from: "epsilon (or gravity or magnet)"."""
    others = [symbol for symbol in effects.alternatives_of(step) if symbol != step.symbol.item()]
    return f"{_effect_name(step)}{f' (or {effects.or_others(others, TIES_NAMED)})' if others else ''}"


def formula_text(step: xr.Dataset) -> str:
    """Return the formula of an effect with its shape parameters and their errors."""
    symbol = step.symbol.item()
    shapes, errors = (effects.shapes_of(step, symbol, values) for values in ("shape", "shape_standard_error"))
    texts = [step.formula.item()]
    for name, value in shapes.items():
        # The record determines no error of a shape parameter at an end of its range.
        error, at_end = errors.get(name, np.nan), f"{value:.3g} (end of its range)"
        texts.append(f"{name} = {layout.value_with_error(value, error) if error != 0.0 else at_end}")
    return ", ".join(texts)


def ranking_table(tree: xr.DataTree) -> Table:
    """Return |z| of named and best candidates before each step and at the end, except those in the model."""
    ranking, detectable = tree["ranking"].to_dataset(), tree["detectability_after"].to_dataset()
    named = [symbol for symbol in effects.added_effects(tree) if symbol in ranking.candidate]
    last = effects.strongest(ranking.isel(selection_step=[-1]), LAST)
    heads, rows = [*(f"step {at}" for at in range(1, ranking.sizes["selection_step"])), "end"], []
    for symbol in dict.fromkeys([*named, *effects.strongest(ranking, ROWS), *last]):
        candidate = ranking.sel(candidate=symbol)
        cells = (f"{abs(z):.3g}" if np.isfinite(z) else "-" for z in candidate.z.values)
        words, least = {"candidate": symbol, "name": candidate["name"].item()}, "-"
        if symbol in detectable.candidate and np.isfinite(detectable.detectable.sel(candidate=symbol)):
            # Coefficient at which the candidate would be significant in the final model.
            coefficient = detectable.sel(candidate=symbol)
            least = layout.with_unit(f"{coefficient.detectable.item():.2g}", coefficient.unit.item())
        rows.append(words | dict(zip(heads, cells, strict=True)) | {"detectable": least})
    cells = (f"{z:.3g}" for z in ranking.threshold.values)
    rows.append({"candidate": "threshold", **dict(zip(heads, cells, strict=True))})
    return layout.text_table(rows, ("candidate", "name"), ("candidate",))


def residual_text(tree: xr.DataTree) -> str:
    """Describe the residual of the final model; a model that diverges has none."""
    ratio = residual_over_noise(tree, "after")
    if not np.isfinite(ratio):
        return "the simulated motion diverges from the record"
    runs = [tree[name].to_dataset() for name in record_groups(tree)]
    if not any(map(has_input, runs)):
        return f"the residual is {times_noise(ratio)}"
    # No spline determines the noise of a driven motion: colouredness shows whether the residual is more.
    part = residual_of(tree, "after") / root_mean_square([float(run.angle.std()) for run in runs])
    p_value, level = float(tree.attrs["noise_p_value"]), tree["ranking"].significance_level.item()
    colour = "" if np.isnan(p_value) else ", and white" if p_value >= level else ", and not white"
    return f"the residual is {100.0 * part:.2g} % of the motion (RMS){colour}"


def times_noise(ratio: float) -> str:
    """Return a residual over the noise as text."""
    return f"{ratio:.3g} times the noise"


def residual_sentences(tree: xr.DataTree, group: str) -> Iterator[str]:
    """Describe when model and record begin to differ, and the parts of the residual."""
    spans = tree[group].to_dataset()
    start, run, groups = spans.departure_time.item(), spans.departure_run.item(), record_groups(tree)
    departs, parts = np.isfinite(start), list(spans.attrs["parts"])
    if departs:
        where = f" of run {run + 1}" if len(groups) > 1 else ""
        first = start <= float(tree[groups[run]].time.values[0])
        begin = "the first sample" if first else f"{start:.3g} s"
        yield f"The residual exceeds the noise from {begin}{where} on."
    else:
        yield "The residual never exceeds the noise significantly."
    if parts:
        most = "phase and amplitude" if set(parts[:2]) == {"phase", "amplitude"} else parts[0]
        yield f"Most of the residual is an error of {most}{WHERE.get(spans.attrs['where'], '')}."
    elif departs:
        # The residual exceeds the noise, but no part of it follows the motion.
        yield UNKNOWN


def residual_table(tree: xr.DataTree, group: str) -> Table:
    """Return parts of record minus model: the largest, its time, and at largest and smallest amplitude."""
    spans, (factor, unit) = tree[group].to_dataset(), small_units(signal_units(tree))
    harmonics = {
        f"{name} harmonic ({unit})": factor * np.hypot(spans[f"{name}_cosine"], spans[f"{name}_sine"])
        for name in ("second", "third")
    }
    parts = {
        "phase (rad)": spans.phase_error,
        f"amplitude ({unit})": factor * spans.amplitude_error,
        f"offset ({unit})": factor * spans.offset,
        **harmonics,
        "frequency (%)": 100.0 * spans.frequency_error,
        "decay rate (w)": spans.decay_error,
    }
    # Amplitudes of the record, because those of the model may be far off.
    amplitude = (spans.amplitude + spans.amplitude_error).values
    ends = (int(np.argmax(amplitude)), int(np.argmin(amplitude)))
    heads = {f"at {amplitude[end]:.3g} {signal_units(tree)}": end for end in ends}
    rows = []
    for name, part in parts.items():
        most = int(np.argmax(np.nan_to_num(np.abs(part.values))))
        run = f" of run {spans.run.values[most] + 1}" if len(record_groups(tree)) > 1 else ""
        row = {"record minus model": name, "largest": f"{part.values[most]:+.2g}"}
        row["when"] = f"{spans.time.values[most]:.3g} s{run}"
        rows.append(row | {head: f"{part.values[end]:+.2g}" for head, end in heads.items()})
    return layout.text_table(rows, ("record minus model", "when"))


def force_type_sentences(tree: xr.DataTree, group: str) -> Iterator[str]:
    """Describe the type of force with the highest score in the omnibus test, and its meaning.

    Nothing if the test does not reject the model, or if no part of the residual follows the motion.

    Parameters
    ----------
    tree : DataTree
        Result of `discover`.
    group : str
        `discrepancy`, for the start model, or `discrepancy_after`.

    Notes
    -----
    If the frequency depends on amplitude, a fit compensates phase errors with amplitude errors, so that the
    residual itself does not show the type. Scores do, because they exclude all changes that the parameters of
    the model can produce.
    """
    omnibus = tree["omnibus"].to_dataset().isel(selection_step=-1 if group.endswith("after") else 0)
    if len(tree[group].attrs["parts"]) and omnibus.significant:
        best = abs(omnibus.z).to_series().groupby(_sort_of).max().sort_values(ascending=False)
        scores = ", ".join(f"{kind} {z:.3g}" for kind, z in best.items())
        near = frozenset(best.index[best > NEARLY_AS_HIGH * best.max()])
        meaning = MEANINGS.get(near, "forces of several types would explain the residual")
        yield f"According to the omnibus test, {meaning}. Largest |z| of each type of force: {scores}."


def _sort_of(name: str) -> str:
    """Return the type of r^k, r^k cos m phi or r^k sin m phi: even m is even, a sine depends on speed."""
    _, *wave = name.split()
    if not wave:
        return EVEN
    even = int(wave[1]) % 2 == 0
    if wave[0] == "cos":
        return EVEN if even else CONSERVATIVE
    return TILTED if even else DISSIPATIVE
