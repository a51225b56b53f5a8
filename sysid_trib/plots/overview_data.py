"""What an overview of a result or a discovery shows, as numbers to draw, the same on paper and on a page."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError
from sysid_trib.physics.force_weights import weights
from sysid_trib.plots.looked import curves_of
from sysid_trib.plots.motion_panels import MotionData, motion_data
from sysid_trib.plots.style import CANDIDATE_MARKS, MODEL_LINES
from sysid_trib.records.half_sines import envelope
from sysid_trib.results.effects import credible_set, determines, strongest
from sysid_trib.results.files import kind_of
from sysid_trib.results.variables import record_groups, signal_units, small_units
from sysid_trib.validation.cross_check import LARGE
from sysid_trib.validation.findings import LAST_THIRD, answer_of, holds, is_refitted, kept_results
from sysid_trib.validation.lack_of_fit import residual_force
from sysid_trib.validation.residuals import fitted_motion
from sysid_trib.validation.verdict import run_record_noise

# Candidates in a ranking.
MOST_CANDIDATES = 15
# A score beyond so many thresholds asks for a logarithmic axis.
LOGARITHMIC_BEYOND = 5.0
# Scores that are all beyond so many thresholds are shown without it, with so much of their range below them.
ALL_BEYOND, ROOM_BELOW = 1.5, 0.2
# A cell of fewer samples has no mean; colours end where so many percent of the cells lie within; a dot marks
# cells of more standard errors.
FEWEST_IN_CELL = 5
COLOUR_PERCENT = 98.0
DOT_BEYOND = 3.0
# Amplitudes between which shares are drawn.
DRAWN_AMPLITUDES = 60
# Standard errors of a 95 % interval.
INTERVAL = 1.96


def held_out_sentence(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """What of the records was held out; empty where nothing was.

    Parameters
    ----------
    tree : xr.DataTree
        Result of a command; of `compare` the figure has it on grey.
    of_search : bool
        Whether the figure is of the search itself, which never sees what is held out; models may be fitted to
        the whole records in the end.
    """
    if kind_of(tree) != "discover":
        return "The part of the record on grey was held out." if kind_of(tree) == "compare" else ""
    held = str(tree.attrs["held_out"])
    held += " of the record" * (held == LAST_THIRD)
    if is_refitted(tree):
        return f"Held out of the search, {'and of these numbers' if of_search else 'then fitted'}: {held}."
    return f"Held out, and not in this figure: {held}."


def missing_force(tree: xr.DataTree, *, after: bool) -> tuple[xr.DataArray, xr.DataArray, float]:
    """Mean force over angle and rate that a model lacks, relative to I w^2.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    after : bool
        Of the final model, else of the start model.

    Returns
    -------
    tuple
        The force and its standard error, in small units, nan where samples are few; and the force at which
        the colours of both models end.
    """
    first, last = (tree[name].to_dataset() for name in ("discrepancy", "discrepancy_after"))
    kept = np.abs(first.force.values[first.samples.values >= FEWEST_IN_CELL])
    kept = kept[np.isfinite(kept)]
    factor, _ = small_units(signal_units(tree))
    limit = factor * float(np.percentile(kept, COLOUR_PERCENT)) if kept.size else 1.0
    shown = last if after else first
    force = (factor * shown.force).where(shown.samples >= FEWEST_IN_CELL)
    return force, factor * shown.standard_error, limit


def _ranking_data(tree: xr.DataTree, selection_step: int, most: int) -> xr.Dataset:
    """The candidates of the highest scores at a selection step; those named or competing always.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    selection_step : int
        0 before the first step, 1 before the second, ..., -1 at the end.
    most : int
        Candidates beside those named and competing.

    Returns
    -------
    xr.Dataset
        Columns of `ranking` at the step for the candidates shown, the highest score first, with
        `size(candidate)`, which is |z|, and `kind(candidate)`, a key of `CANDIDATE_MARKS`; `threshold`, the
        |z| beyond which a candidate is named. Attributes: `title`, when the step was; `logarithmic`, whether
        scores ask for a logarithmic axis; `low`, the least that the axis shows (not zero, nor the threshold,
        where all scores are far beyond it), and `high`, the largest |z| or the threshold.
    """
    scores = tree["ranking"].to_dataset().isel(selection_step=selection_step)
    named, competing = _named(tree, selection_step)
    chosen = strongest(scores.expand_dims("selection_step"), most)
    tested = scores.candidate.values[np.isfinite(scores.z.values)]
    chosen += [s for s in (*named, *competing) if s in tested and s not in chosen]
    kinds = list(CANDIDATE_MARKS)
    kind = [kinds[0] if s in named else kinds[1] if s in competing else kinds[2] for s in chosen]
    shown = scores.sel(candidate=chosen)
    size, threshold = np.abs(shown.z.values), scores.threshold.item()
    columns = {"size": size, "kind": np.array(kind, dtype=str)}
    shown = shown.assign({name: ("candidate", column) for name, column in columns.items()})
    title, high, low = _title(tree, selection_step), max([threshold, *size]), 0.0
    logarithmic = bool(high > LOGARITHMIC_BEYOND * threshold)
    if size.size and size.min() > ALL_BEYOND * threshold:
        # An axis from zero, or a logarithm, would hide in what the candidates differ.
        logarithmic, low = False, float(size.min() - ROOM_BELOW * max(np.ptp(size), 0.05 * high))
    elif logarithmic:
        # Scores in their hundreds and a threshold of four need a logarithm, else it hides the differences.
        low = min([0.5 * threshold, *(0.7 * size)])
    return shown.assign_attrs(title=title, logarithmic=logarithmic, low=low, high=high)


def rankings_data(tree: xr.DataTree, most: int = MOST_CANDIDATES) -> list[xr.Dataset]:
    """The ranking at the selection steps at which an effect of the final model was chosen, and at the end.

    That at the end is left out if every candidate is in the model.
    """
    chosen = tree["steps"].selection_step.values.tolist() if tree["steps"].attrs["count"] else []
    rankings = [_ranking_data(tree, step, most) for step in (*sorted(set(chosen)), -1)]
    return rankings if rankings[-1].sizes["candidate"] or len(rankings) == 1 else rankings[:-1]


def _title(tree: xr.DataTree, selection_step: int) -> str:
    if selection_step in (-1, tree["ranking"].sizes["selection_step"] - 1):
        return "at the end"
    steps = tree["steps"].to_dataset().get("selection_step", xr.DataArray([])).values
    added = " and ".join(str(at + 1) for at in np.flatnonzero(steps == selection_step))
    return f"before step {added}" if added else f"selection step {selection_step + 1}"


def _named(tree: xr.DataTree, selection_step: int) -> tuple[list[str], list[str]]:
    """The effects that were chosen at a selection step, and those that compete with them."""
    if not tree["steps"].attrs["count"]:
        return [], []
    steps = tree["steps"].to_dataset()
    sets = [
        list(credible_set(steps.isel(step=at)))
        for at in np.flatnonzero(steps.selection_step.values == selection_step)
    ]
    named = [credible[0] for credible in sets]
    return named, [symbol for credible in sets for symbol in credible[1:] if symbol not in named]


@dataclass(frozen=True)
class OverviewData:
    """A result at a glance.

    Attributes
    ----------
    motion : MotionData
        The record and the models that are drawn.
    results : mapping of str to Dataset
        Identifications whose coefficients are shown, the main one last; none where all have failed.
    weighed : Dataset, or None
        `weights` of the main one over amplitude; none where a force is not finite there.
    missing : Dataset, or None
        `residual_force`; none where the samples do not determine the motion.
    holds : bool
        Whether the model explains the record.
    models : tuple of str
        Those whose motions are drawn: of a discovery the last alone.
    held_out : str
        What of the record a discovery held out, as a sentence.
    of_discovery : bool
        Whether `story` shows the residuals and what is missing.
    backbone : pair of Dataset, or None
        `curves_of` the run: of the record, and of the models; none of few half periods, or without a check.
    """

    motion: MotionData
    results: Mapping[str, xr.Dataset]
    weighed: xr.Dataset | None
    missing: xr.Dataset | None
    holds: bool
    models: tuple[str, ...]
    held_out: str
    of_discovery: bool
    backbone: tuple[xr.Dataset, xr.Dataset | None] | None = None

    @property
    def units(self) -> str:
        """Unit of the record."""
        return self.motion.units

    @property
    def colour_limit(self) -> float:
        """Missing force at which colours end, in small units: what is but noise stays pale."""
        assert self.missing is not None
        force, error = (self.missing[name].values for name in ("force", "force_standard_error"))
        ends = (
            np.nanpercentile(np.abs(force), COLOUR_PERCENT),
            DOT_BEYOND * np.nanpercentile(error, COLOUR_PERCENT),
        )
        return self.motion.small_units[0] * float(max(ends)) or 1.0


def _is_incomplete(tree: xr.DataTree) -> bool:
    """True if the final model of a discovery lacks something; else names alone are in doubt."""
    tests = [tree[group].significant.isel(selection_step=-1) for group in ("omnibus", "ranking")]
    return tree.attrs["verdict"] == "unknown effect" and any(test.values.any() for test in tests)


def overview_data(tree: xr.DataTree, run: int = 0) -> OverviewData:
    """The overview of a run in a result of `cross_check`, `compare` or `discover`.

    Parameters
    ----------
    tree : DataTree
        The result.
    run : int
        Which of several runs, from 0.
    """
    record = tree[record_groups(tree)[run]].to_dataset()
    if kind_of(tree) == "discover":
        results = {"final model": tree["after"].to_dataset()}
        explained = not _is_incomplete(tree) and determines(results["final model"])
        drawn = motion_data(tree, run)
    elif kind_of(tree) == "compare":
        best = tree["comparison"].attrs["best"]
        results, drawn = {best: tree[best].to_dataset()}, _best_motion(tree, run)
        explained = bool(tree["comparison"].holdout_over_noise.sel({"method": best}) <= LARGE)
    else:
        results, drawn, explained = kept_results(tree), motion_data(tree, run), holds(tree)
        # The last is drawn as the main one.
        results = dict(sorted(results.items(), key=lambda pair: pair[0] == answer_of(tree)))
    main = next(reversed(results.values()), None)
    # A model that failed has no weights, but what it lacks can be seen.
    of_surface = main if main is not None else tree[tree["comparison"].attrs["second"]].to_dataset()
    weighed = missing = None
    with suppress(SysidTribError):
        missing = residual_force(record[["angle"]], of_surface, run)
    with suppress(SysidTribError):
        if main is not None:
            halves = envelope(record[["angle"]])
            # `t` of a formula is the time since the first sample.
            halves = halves.assign(elapsed=halves.instant_time - float(record.time[0]))
            weighed = _weights(main, halves)
    models = tuple(drawn.lines)[-1 if kind_of(tree) == "discover" else 0 :]
    held = held_out_sentence(tree)
    curves = None
    if any(name.startswith("lack_of_fit") for name in tree.children):
        with suppress(KeyError):
            curves = curves_of(tree, run)
    of_discovery = kind_of(tree) == "discover"
    return OverviewData(drawn, results, weighed, missing, explained, models, held, of_discovery, curves)


def _best_motion(tree: xr.DataTree, run: int) -> MotionData:
    """The record with the motion of the method that predicts best."""
    best = tree["comparison"].attrs["best"]
    record = tree[record_groups(tree)[run]].to_dataset()
    motion = fitted_motion(record, tree[best].to_dataset(), run)
    noise = run_record_noise(tree, run)
    if motion is None:
        return MotionData(record, noise, {}, {best: best})
    angle = (("model", "time"), (motion.x + motion.offset)[None])
    shown = record.assign_coords(model=[best]).assign(simulated_angle=angle)
    return MotionData(shown, noise, {best: MODEL_LINES[1]}, {best: best})


def _weights(result: xr.Dataset, halves: xr.Dataset) -> xr.Dataset:
    """Weights of the forces over the amplitudes of a decay, each at its own time."""
    order = np.argsort(halves.amplitude.values)
    amplitude, since = halves.amplitude.values[order], halves.elapsed.values[order]
    drawn = np.linspace(float(amplitude[0]), float(amplitude[-1]), DRAWN_AMPLITUDES)
    return weights(result, drawn, time=np.interp(drawn, amplitude, since))
