"""Texts of figures: none is small, cut, or over another, in a column and over a page."""

from functools import partial

import numpy as np
import pytest
import xarray as xr
from figure_texts import faults

import sysid_trib as st
from sysid_trib import plots
from sysid_trib.cycles.look import look
from sysid_trib.plots.figure import figures_of, new_figure
from sysid_trib.questions.difference import held_against
from sysid_trib.questions.profiles import profile
from sysid_trib.records.smoothing import swing_frequency
from sysid_trib.results.kinds import kind_of

# mm, as journals have them.
WIDTHS = (88.0, 180.0)
INCH = 25.4
DECAY = st.free_decay(st.records.paper_twin(), window=(0.0, 10.0))


def on_axes(draw):
    """A figure of a given width of what draws on axes."""

    def drawn(width):
        figure = new_figure(width, 2.6)
        draw(ax=figure.subplots())
        return figure

    return drawn


def of_a_result(tree):
    """The figures of a result, by their names."""
    kind = kind_of(tree)
    made = {name: draw for figure in figures_of(kind) for name, _, draw in figure.drawings(tree)}
    return made | ({"backbone": partial(plots.backbone, tree)} if kind == "cross_check" else {})


def of_the_paper():
    """The figures that show a decay, a model or a study by itself."""
    halves, library = st.envelope(DECAY), st.load_library()
    result = st.identify(DECAY, library, st.methods.Direct(reference_frequency=9.9))
    model = st.physics.model_of(result)
    envelope = st.physics.predict_envelope(model, np.linspace(0.0, 10.0, 50), 0.3)
    weighed = st.physics.weights(result, np.linspace(0.05, 0.3, 20))
    runs = xr.Dataset(
        {
            name: (("run", "quantity"), np.arange(12.0).reshape(6, 2))
            for name in ("value", "standard_error", "z")
        },
        {"run": [f"run_{at}.csv" for at in range(6)], "quantity": ["zeta", "asymptotic frequency"]},
    )
    return {
        "look": partial(plots.look, look([st.records.paper_twin()], [DECAY])),
        "backbone": partial(plots.backbone, st.backbone(DECAY)),
        "motions": on_axes(partial(plots.motions, DECAY, {"averaged envelope": envelope})),
        "half_sines": on_axes(partial(plots.motions, DECAY.sel(time=slice(0.0, 1.5)), half_periods=halves)),
        "frequency_shift": on_axes(partial(plots.frequency_shift, {"record": halves}, {"model": envelope})),
        "weights": on_axes(partial(plots.weights, weighed, "decay_share")),
        "against_condition": partial(plots.against_condition, runs, "load (N)", np.arange(6.0)),
    }


def wrong(figures):
    """Return the faults of the texts of figures, by figure and width."""
    return [
        f"{name} at {width:g} mm: {fault}"
        for name, draw in figures.items()
        for width in WIDTHS
        for fault in faults(draw(width=width / INCH))
    ]


@pytest.mark.parametrize("kind", ["cross_check", "compare", "discover"])
def test_texts_of_a_result_have_room(results, kind):
    assert wrong(of_a_result(results[kind])) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cross_check", "compare", "discover"])
def test_texts_in_long_units_have_room(results, kind):
    tree = results[kind].copy(deep=True)
    for node in tree.subtree:
        for data in node.variables.values():
            if data.attrs.get("units") == "rad":
                data.attrs["units"] = "parts of the tank's width"
    assert wrong(of_a_result(tree)) == []


def test_texts_of_the_papers_figures_have_room():
    assert wrong(of_the_paper()) == []


@pytest.mark.slow
def test_texts_of_what_is_asked_besides_have_room(results):
    library = st.load_library().select(["lambda", "zeta", "delta", "nu", "epsilon"])
    answer = results["cross_check"]["direct"].to_dataset()
    other = DECAY.isel(time=slice(100, None))
    frequencies = np.linspace(9.0, 11.0, 12)
    figures = {
        "profile": partial(plots.profile, profile([DECAY], answer, ["zeta", "delta"])),
        "sensitivity": partial(plots.sensitivity, st.validation.sensitivity([DECAY], answer)),
        "response": partial(plots.response, st.forced_response(answer, 0.01, frequencies)),
        "plan": partial(plots.plan, st.validation.plan(results["discover"])),
        "difference": partial(plots.difference, held_against([DECAY], [other], library, st.methods.Direct())),
    }
    assert wrong(figures) == []


MEASURED = (
    "string_pendulum/run_1.txt",
    "roll_decay/model_test_21337.csv",
    "single_pendulum/free_swing.csv",
    "sloshing/decay_0p953.csv",
    "simulated/random_force_1.csv",
)


# Labels are those of units and names, whatever the length of a record: its first swings have them all.
@pytest.mark.parametrize(
    "periods", [pytest.param(12, marks=pytest.mark.slow), pytest.param(None, marks=pytest.mark.in_full)]
)
@pytest.mark.parametrize("name", MEASURED)
def test_texts_of_measured_records_have_room(data_folder, name, periods):
    decay = st.free_decay(st.read_record(data_folder / name))
    if periods:
        duration = periods * 2.0 * np.pi / swing_frequency(decay)
        decay = decay.sel(time=slice(None, float(decay.time[0]) + duration))
    assert wrong(of_a_result(st.identify(decay))) == []
    start = st.load_library().select(["lambda", "zeta"])
    found = st.discover(decay, start, max_effects=1, time_limit=60.0)
    assert wrong(of_a_result(found)) == []
