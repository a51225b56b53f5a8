"""What a page says of each kind of result: the story that the command prints, with figures."""

from collections.abc import Callable, Mapping

import numpy as np
import xarray as xr

from sysid_trib import plots
from sysid_trib.plots.cross_checked import model_lines
from sysid_trib.plots.discovered import MODELS, noise_of_sample
from sysid_trib.printing.comparison import comparison_sentences, comparison_tables
from sysid_trib.printing.discovery_story import discovery_story
from sysid_trib.printing.discovery_tables import RANKING, ranking_table
from sysid_trib.printing.identification import (
    coefficient_cell,
    consequences,
    identification_sentences,
    identification_table,
)
from sysid_trib.printing.layout import value_with_error
from sysid_trib.printing.physics import physics_sentences
from sysid_trib.printing.runs import runs_sentences, runs_table
from sysid_trib.reporting.compared import prediction_panel, quantity_panels
from sysid_trib.reporting.drawing import MOST_POINTS
from sysid_trib.reporting.motions import motion_panels, record_panel
from sysid_trib.reporting.parts import Figures, Section, Table, as_table
from sysid_trib.reporting.searched import forecast_panel, map_panels, ranking_panels
from sysid_trib.results.per_run import noise_of_run, record_groups

FOLLOWS = "What follows from the model"
MOTIONS = "The record and the motion of each model, its start and the sensor's zero fitted."
TOGETHER = "Below, what the models leave of it; the band is twice the noise to either side."
APART = (
    "Below, what the models leave of it before and after, each to its own scale; the band is twice the noise "
    "to either side."
)
HALF_SINES = (
    "Amplitude and frequency of the half periods, of record and models by the same half-sine fits; bars are "
    "standard errors."
)
HELD_OUT = (
    "The record, its last third on grey: it was held out. RMS of record minus simulated model over the "
    "noise, of the part identified from (open) and of what was held out (full); 1 is the noise alone."
)
BY_METHOD = (
    "Each quantity by method with its standard error; the band is that of the method that predicts best. An "
    "arrow stands for a value beyond the edge. Open marks: variants of the method above. Green: trajectory, "
    "blue: direct, orange: averaging, dark: decrements and others."
)
MAPPED = (
    "Mean force f that the gap asks for over angle and rate, in θ″ + w²θ = -w²f, before (left, or first) and "
    "after; blank where samples are few. Its standard error, by the noise, is under the pointer; in print, "
    "dots mark what is beyond three."
)
RANKED = (
    "Candidates by score. Orange diamond: the one that is named; blue squares: what cannot be told from it; "
    "open: others. "
    "The dashed line is the threshold, corrected for the number of candidates."
)
SEEN = (
    "Coefficient from which each candidate would be detected (five standard errors), beside the start model "
    "(open) and beside the final one (full); orange diamonds: effects that were found, at their coefficient. "
    "Without a mark: not testable on this record."
)


def kind_of(tree: xr.DataTree) -> str:
    """The function a result is from: identify, cross_check, compare or discover; empty if from none."""
    if "coefficient" in tree.ds and "method" in tree.attrs:
        return "identify"
    if {"record", "record_1"}.isdisjoint(tree.children):
        return ""
    if {"steps", "ranking"} <= set(tree.children):
        return "discover"
    if "comparison" not in tree.children:
        return ""
    checked = tree["comparison"]
    return "compare" if "best" in checked.attrs else "cross_check" if "first" in checked.attrs else ""


def summary(tree: xr.DataTree) -> list[str]:
    """The result in a few sentences."""
    made: Mapping[str, Callable[[xr.DataTree], list[str]]] = {
        "identify": lambda _: [],
        "cross_check": identification_sentences,
        "compare": comparison_sentences,
        "discover": lambda found: discovery_story(found)["Verdict"],
    }
    return made[kind_of(tree)](tree)


def sections(tree: xr.DataTree) -> list[Section]:
    """The sections of a page below its summary."""
    made: Mapping[str, Callable[[xr.DataTree], list[Section]]] = {
        "identify": _alone,
        "cross_check": _cross_checked,
        "compare": _compared,
        "discover": _discovered,
    }
    return made[kind_of(tree)](tree)


def identifications(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications of a result by name."""
    if kind_of(tree) == "identify":
        return {tree.attrs["method"]: tree.to_dataset()}
    return {name: node.to_dataset() for name, node in tree.children.items() if "covariance" in node.ds}


def coefficient_table(results: Mapping[str, xr.Dataset]) -> Table:
    """Coefficients of identifications side by side with errors, units, and the frequency they refer to."""
    forces = {
        symbol: each.sel(force=symbol) for each in results.values() for symbol in each.force.values.tolist()
    }
    rows = []
    for symbol, one in forces.items():
        cells = [coefficient_cell(each, symbol) for each in results.values()]
        unit = "" if one.unit.item() == "1" else one.unit.item()
        rows.append(
            [symbol, one["name"].item(), one.formula.item(), *cells, unit, f"{one.refers_to.item():.6g}"]
        )
    rows += _shape_rows(results)
    for name, title in (("reference_frequency", "w"), ("asymptotic_frequency", "w_inf")):
        cells = [
            value_with_error(r[name].item(), r[f"{name}_standard_error"].item()) for r in results.values()
        ]
        rows.append([title, name.replace("_", " "), "", *cells, "rad/s", ""])
    rows.append(
        ["noise", "standard deviation", "", *(f"{r.noise.item():.2g}" for r in results.values()), "rad", ""]
    )
    heads = ["force", "name", "formula", *results, "unit", "refers to (rad/s)"]
    last = len(heads) - 1
    return Table("Coefficients", heads, rows, frozenset({*range(3, last - 1), last}))


def _shape_rows(results: Mapping[str, xr.Dataset]) -> list[list[str]]:
    """Shape parameters: fitted with an error, or held."""
    found: dict[str, dict[str, str]] = {}
    for label, result in results.items():
        if "shape" in result:
            for name in result.shape_parameter.values.tolist():
                one = result.sel(shape_parameter=name)
                value, error = one["shape"].item(), one.shape_standard_error.item()
                told = f"{value:g} (held)" if np.isnan(error) else value_with_error(value, error)
                found.setdefault(name, {})[label] = told
    return [
        [name, "shape parameter", "", *(told.get(label, "-") for label in results), "", ""]
        for name, told in found.items()
    ]


def _alone(tree: xr.DataTree) -> list[Section]:
    result = tree.to_dataset()
    made = [Section("Coefficients", tables=[coefficient_table({tree.attrs["method"]: result})])]
    # The largest amplitude that is known: an identification alone keeps no record.
    start = np.abs(np.ravel(result.start_angle.values)) if "start_angle" in result else np.array([])
    return [*made, Section(FOLLOWS, physics_sentences(result, start))] if np.any(start > 0.0) else made


def _cross_checked(tree: xr.DataTree) -> list[Section]:
    checked, groups = tree["comparison"].ds, record_groups(tree)
    lines = {name: (line["color"], line["linestyle"]) for name, line in model_lines(tree)}
    second = tree[checked.attrs["second"]].to_dataset()
    motions = [
        Figures(
            f"{_of_run(tree, run)}{MOTIONS} {TOGETHER} {HALF_SINES}{_thinned(tree, run)}",
            motion_panels(tree[group].to_dataset(), lines, noise_of_run(second, run), together=True),
            [plots.identification(tree, run)],
        )
        for run, group in enumerate(groups)
    ]
    table = as_table("Coefficients by both methods", identification_table(tree))
    made = [
        Section("Coefficients", _references(second), [table]),
        Section("Record and models", figures=motions),
    ]
    if "runs" in tree.children:
        runs = tree["runs"].to_dataset()
        made.append(
            Section("Do the runs agree", runs_sentences(runs), [as_table("Each run alone", runs_table(runs))])
        )
    return [*made, Section(FOLLOWS, consequences(tree, None))]


def _references(result: xr.Dataset) -> list[str]:
    """What coefficients refer to, and their units."""
    w = result.reference_frequency.item()
    others = [
        f"{symbol} to {frequency:.6g} rad/s"
        for symbol, frequency in zip(
            result.force.values.tolist(), result.refers_to.values.tolist(), strict=True
        )
        if not np.isclose(frequency, w, rtol=1e-12)
    ]
    units = [
        f"{symbol} in {unit}"
        for symbol, unit in zip(result.force.values.tolist(), result.unit.values.tolist(), strict=True)
        if unit != "1"
    ]
    refer = "; ".join(["Coefficients refer to w of their method", *others])
    return [f"{refer}. {'; '.join(['They are dimensionless', *units])}."]


def _compared(tree: xr.DataTree) -> list[Section]:
    tables = [as_table(title, printed) for title, printed in comparison_tables(tree).items()]
    records = [record_panel(tree[group].to_dataset()) for group in record_groups(tree)]
    predicted = Figures(HELD_OUT + _thinned(tree, 0), [*records, prediction_panel(tree)], [])
    each = Figures(BY_METHOD, quantity_panels(tree), [plots.comparison(tree)])
    return [
        Section("Coefficients by method", figures=[each], tables=tables[:2]),
        Section("Prediction of what was held out", figures=[predicted], tables=tables[2:]),
    ]


def _discovered(tree: xr.DataTree) -> list[Section]:
    story = discovery_story(tree)
    lines = {name: (line["color"], line["linestyle"]) for name, line in list(MODELS.items())[::-1]}
    motions = [
        Figures(
            f"{_of_run(tree, run)}{MOTIONS} {APART} {HALF_SINES}{_thinned(tree, run)}",
            motion_panels(
                tree[group].to_dataset(), lines, noise_of_sample(tree, run), together=False, label="model {}"
            ),
            [plots.discovery(tree, run)],
        )
        for run, group in enumerate(record_groups(tree))
    ]
    extra = {
        "Where model and record disagree": [
            *motions,
            Figures(MAPPED, map_panels(tree), [plots.disagreement(tree)]),
        ],
        "What is missing": [Figures(RANKED, ranking_panels(tree), [plots.rankings(tree)])],
        "What this record can show": [Figures(SEEN, [forecast_panel(tree)], [plots.forecasts(tree)])],
    }
    models = coefficient_table({name: tree[name].to_dataset() for name in ("before", "after")})
    tables = {"What is missing": [models, as_table(RANKING, ranking_table(tree))]}
    # Without a step the story has no heading for it, but candidates were scored.
    titles = [title for title in dict.fromkeys([*extra, *story]) if title != "Verdict"]
    return [
        Section(title, story.get(title, []), tables.get(title, []), extra.get(title, [])) for title in titles
    ]


def _of_run(tree: xr.DataTree, run: int) -> str:
    groups = record_groups(tree)
    source = tree[groups[run]].attrs.get("source", "")
    return f"Run {run + 1}{f' ({source})' if source else ''}. " if len(groups) > 1 else ""


def _thinned(tree: xr.DataTree, run: int) -> str:
    samples = tree[record_groups(tree)[run]].sizes["time"]
    if samples <= MOST_POINTS:
        return ""
    return (
        f" The curves are thinned: each is drawn by {MOST_POINTS:,} of {samples:,} samples, the least and "
        "the largest of each stretch, so that none of its peaks is lost."
    )
