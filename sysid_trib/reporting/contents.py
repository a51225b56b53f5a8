"""What a page says of each kind of result: the story that the command prints, with figures."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib import plots
from sysid_trib.plots.at_a_glance import drawn_overview
from sysid_trib.plots.discovery_data import held_out_sentence
from sysid_trib.plots.motion_data import MOST_POINTS
from sysid_trib.plots.overview_data import overview_data
from sysid_trib.plots.style import FULL_WIDTH, new_figure
from sysid_trib.printing.comparison import comparison_tables
from sysid_trib.printing.comparison_sentences import comparison_sentences
from sysid_trib.printing.cross_check import amplitudes, consequences, identification_sentences
from sysid_trib.printing.discovery_story import discovery_story
from sysid_trib.printing.discovery_tables import RANKING, ranking_table
from sysid_trib.printing.identification import identification_table
from sysid_trib.printing.physics import physics_sentences
from sysid_trib.printing.random_force import random_force_sentences
from sysid_trib.printing.runs import runs_sentences, runs_table
from sysid_trib.reporting.parts import Figures, Section, as_table
from sysid_trib.reporting.tables import coefficient_table, reference_sentence
from sysid_trib.results.per_run import group_names, record_groups

# Of a single panel, inch.
LONE_PANEL_HEIGHT = 2.4
CONSEQUENCES = "What follows from the model"
CAPTIONS = tomllib.loads(Path(__file__).with_name("captions.toml").read_text(encoding="utf-8"))


def kind_of(tree: xr.DataTree) -> str:
    """The function that made a result: identify, cross_check, compare or discover; empty if none did."""
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


def identifications(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications of a result by name."""
    if kind_of(tree) == "identify":
        return {tree.attrs["method"]: tree.to_dataset()}
    return {name: node.to_dataset() for name, node in tree.children.items() if "covariance" in node.ds}


def _identified(tree: xr.DataTree) -> list[Section]:
    result = tree.to_dataset()
    made = [Section("Coefficients", tables=[coefficient_table(identifications(tree))])]
    # The largest amplitude that is known: an identification without a cross-check keeps no record.
    start = np.abs(np.ravel(result.start_angle.values)) if "start_angle" in result else np.array([])
    return [*made, Section(CONSEQUENCES, physics_sentences(result, start))] if np.any(start > 0.0) else made


def _cross_checked(tree: xr.DataTree) -> list[Section]:
    second = tree[tree["comparison"].attrs["second"]].to_dataset()
    table = as_table("Coefficients by both methods", identification_table(tree))
    made = [
        _at_a_glance(tree),
        Section("Coefficients", [reference_sentence(second)], [table]),
        Section("Amplitude and frequency", figures=_half_periods(tree)),
    ]
    if "runs" in tree.children:
        runs = tree["runs"].to_dataset()
        table = as_table("Each run alone", runs_table(runs))
        made.append(Section("Do the runs agree", runs_sentences(runs), [table]))
    if "random_force" in tree.children:
        said = random_force_sentences(tree, float(amplitudes(tree).max()))
        made.append(Section("Random force", said, figures=_pushed(tree)))
    return [*made, Section(CONSEQUENCES, consequences(tree, None))]


def _pushed(tree: xr.DataTree) -> list[Figures]:
    """Innovations, random force and predictions of each run whose motion settles."""
    count = len(record_groups(tree))
    names = zip(*(group_names(name, count) for name in ("innovations", "prediction_bands")), strict=True)
    made = []
    for run, (followed, bands) in enumerate(names):
        if followed in tree.children:
            data = tree[followed].to_dataset()
            drawn = [plots.innovations(data)]
            drawn += [_wide(plots.prediction_bands, tree[bands].to_dataset())] if bands in tree else []
            made.append(Figures(f"{_of_run(tree, run)}{CAPTIONS['random_force']}", drawn))
    return made


def _wide(draw: Callable[[xr.Dataset, Axes], Axes], data: xr.Dataset) -> Figure:
    """A panel as wide as the page."""
    figure = new_figure(FULL_WIDTH, LONE_PANEL_HEIGHT)
    draw(data, figure.subplots())
    return figure


def _compared(tree: xr.DataTree) -> list[Section]:
    tables = [as_table(title, printed) for title, printed in comparison_tables(tree).items()]
    by_method = Figures(CAPTIONS["by_method"], [plots.comparison(tree)])
    return [
        _at_a_glance(tree),
        Section("Coefficients by method", figures=[by_method], tables=tables[:2]),
        Section("Prediction of what was held out", tables=tables[2:]),
    ]


def _discovered(tree: xr.DataTree) -> list[Section]:
    story = discovery_story(tree)
    held, of_search = _held_out(tree), _held_out(tree, of_search=True)
    figures = {
        "Where model and record disagree": [
            *_motions(tree),
            Figures(CAPTIONS["force_map"] + held, [plots.disagreement(tree)]),
        ],
        "What is missing": [Figures(CAPTIONS["scores"] + of_search, [plots.ranking(tree)])],
        "What this record can show": [Figures(CAPTIONS["detectable"] + of_search, [plots.forecast(tree)])],
    }
    models = coefficient_table({name: tree[name].to_dataset() for name in ("before", "after")})
    tables = {"What is missing": [models, as_table(RANKING, ranking_table(tree))]}
    # Without a step the story has no heading for it, but candidates were scored.
    titles = [title for title in dict.fromkeys([*figures, *story]) if title != "Verdict"]
    return [
        _at_a_glance(tree),
        *(Section(t, story.get(t, []), tables.get(t, []), figures.get(t, [])) for t in titles),
    ]


def _at_a_glance(tree: xr.DataTree) -> Section:
    """The overview of each run."""
    held = CAPTIONS["glance_held_out"] if kind_of(tree) == "compare" else _held_out(tree)
    figures = []
    for run in range(len(record_groups(tree))):
        data = overview_data(tree, run)
        caption = CAPTIONS["glance_backbone"] * (data.backbone is not None) + CAPTIONS["glance"]
        figures.append(_over_time(tree, run, caption + held, drawn_overview(data)))
    return Section("At a glance", figures=figures)


def _motions(tree: xr.DataTree) -> list[Figures]:
    """The record of each run with the residuals of the models before and after, and the half periods."""
    held = _held_out(tree)
    over_time = [
        _over_time(tree, run, CAPTIONS["motions_apart"] + held, plots.story(tree, run))
        for run in range(len(record_groups(tree)))
    ]
    return [*over_time, *_half_periods(tree)]


def _half_periods(tree: xr.DataTree) -> list[Figures]:
    """Amplitude and frequency of the half periods of each run, of record and models."""
    return [
        Figures(f"{_of_run(tree, run)}{CAPTIONS['half_periods']}", [plots.half_periods(tree, run)])
        for run in range(len(record_groups(tree)))
    ]


def _over_time(tree: xr.DataTree, run: int, caption: str, figure: Figure) -> Figures:
    """A figure of one run, decimated where it is long."""
    samples = tree[record_groups(tree)[run]].sizes["time"]
    decimated = CAPTIONS["decimated"].format(points=MOST_POINTS, samples=samples)
    return Figures(f"{_of_run(tree, run)}{caption}{decimated * (samples > MOST_POINTS)}", [figure])


def _held_out(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """What a discovery held out, after a caption."""
    return f" {held_out_sentence(tree, of_search=of_search)}".rstrip()


def _of_run(tree: xr.DataTree, run: int) -> str:
    groups = record_groups(tree)
    source = tree[groups[run]].attrs.get("source", "")
    return f"Run {run + 1}{f' ({source})' if source else ''}. " if len(groups) > 1 else ""


TITLE = "Forces of a free decay"
MISSING_TITLE = "What a model lacks to explain a free decay"
# By kind of result: title of its page, the result in a few sentences, and its sections.
PAGES: dict[str, tuple[str, Callable[[xr.DataTree], list[str]], Callable[[xr.DataTree], list[Section]]]] = {
    "identify": (TITLE, lambda _: [], _identified),
    "cross_check": (f"{TITLE}, by two methods", identification_sentences, _cross_checked),
    "compare": (f"{TITLE}, method by method", comparison_sentences, _compared),
    "discover": (MISSING_TITLE, lambda tree: discovery_story(tree)["Verdict"], _discovered),
}
