"""Figures show the numbers of their results: of the paper, of studies, and the overview."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from helpers import FIVE, NOISE, W, decay, library_of_formulas, paper_run

import sysid_trib as st
from sysid_trib import plots
from sysid_trib.plots.style import logarithmic_ticks
from sysid_trib.records.drawn import MOST_POINTS
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation.missing_force import residual_force


def test_a_long_record_keeps_its_peaks_on_paper():
    time = np.arange(50_000) / 1000
    angle = 0.1 * np.cos(5.0 * time)
    angle[12_345], angle[40_001] = 0.3, -0.4
    record = xr.Dataset({"angle": ("time", angle)}, {"time": time})
    drawn = plots.motions(record, {}).lines[0].get_ydata()
    assert drawn.size <= MOST_POINTS
    assert {0.3, -0.4} <= set(drawn)


FORCES = st.load_library()
PANELS = 9


@pytest.fixture(scope="module")
def tree():
    record = paper_run(FIVE, sampling_rate=50.0).decay(7)
    pair = [method.identify(record, FORCES) for method in (st.methods.Averaging(), st.methods.Direct())]
    return st.cross_check(record, *pair)


def texts(figure):
    return [text for panel in figure.axes for text in (panel.get_xlabel(), panel.get_ylabel())]


def test_every_panel_has_axes_with_units(tree):
    figure = st.plots.overview(tree, width=7.2)
    figure.canvas.draw()
    panels = [panel for panel in figure.axes if panel.get_subplotspec() is not None]
    assert len([panel for panel in panels if panel.get_title(loc="left").startswith("(")]) == PANELS
    assert figure.get_size_inches()[0] == 7.2
    for unit in ("(rad)", "(mrad)", "(s)", "(%)"):
        assert any(unit in text for text in texts(figure))


def test_the_missing_force_has_the_same_symbols_in_all_figures(tree):
    figure = st.plots.overview(tree, width=7.2)
    assert r"$\dot{\theta}/\omega$ (rad)" in texts(figure)
    assert r"angle $\theta$ (rad)" in texts(figure)


@pytest.mark.parametrize(
    ("formula", "axis", "expected"),
    [("x**3", "x", lambda x: 0.4 * x**3), ("v*abs(v)", "v", lambda v: 0.06 * v * np.abs(v))],
)
def test_the_missing_force_is_the_one_that_was_left_out(formula, axis, expected):
    library = library_of_formulas(zeta="2*v", hidden=formula)
    coefficient = 0.4 if axis == "x" else 0.06
    time = np.arange(0.0, 40.0, 0.01)
    motion = trajectory(st.Model(library, {"zeta": 0.004, "hidden": coefficient}, W), time, 0.5, 0.0).angle
    record = decay(time, motion, 3, NOISE)
    whole = st.methods.Direct(random_force="off", reference_frequency=W).identify(record, library)
    lacking = whole.sel(force=["zeta"], other_force=["zeta"])
    surface = residual_force(record, lacking)
    at, error = surface[axis], surface[f"force_of_{axis}_standard_error"].values
    mean = surface[f"force_of_{axis}"].values
    inner = np.abs(at.values) < 0.45
    # Means over cells of a curved force: within the errors and a hundredth of its largest value.
    away = np.abs(mean - expected(at.values))[inner]
    assert np.all(away < 5.0 * error[inner] + 0.05 * np.max(np.abs(expected(at.values))))
    assert np.max(np.abs(mean / error)) > 20.0


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [(1.5e-6, 2.4e-4, [r"$2 \cdot 10^{-6}$", "$10^{-5}$"]), (0.02, 0.5, ["0.02", "0.1"])],
)
def test_the_numbers_of_a_logarithmic_axis_have_one_style(low, high, labels):
    figure, ax = plt.subplots()
    ax.set(xscale="log", xlim=(low, high))
    logarithmic_ticks(ax.xaxis, low, high)
    figure.canvas.draw()
    texts = [tick.label1.get_text() for tick in (*ax.xaxis.get_minor_ticks(), *ax.xaxis.get_major_ticks())]
    written = [text for text in texts if text]
    assert set(labels) <= set(written)
    assert len({text.startswith("$") for text in written}) == 1
    plt.close(figure)
