"""Figures show the numbers that they are given."""

import io

import numpy as np
import pytest
import xarray as xr

from sysid_trib import load_library, plots
from sysid_trib.forces import signature
from sysid_trib.plots import style
from sysid_trib.plots.motion_panels import MOST_POINTS

SIX = load_library()


@pytest.mark.parametrize(("low", "high"), [(0.02, 0.3), (1.1, 1.9)])
def test_an_axis_of_amplitudes_has_numbers_from_end_to_end(low, high):
    ax = style.axes(None)
    ax.plot([0.0, 1.0], [high, low])
    style.logarithmic_amplitude(ax)
    ax.figure.canvas.draw()
    labels = [text.get_text() for text in (*ax.get_yticklabels(), *ax.get_yticklabels(minor=True))]
    told = [float(label) for label in labels if label]
    shown = [value for value in told if low <= value <= high]
    assert 3 <= len(shown) <= 10
    assert max(shown) > 0.6 * high
    assert min(shown) < 1.6 * low


def test_signatures_are_drawn_as_they_are():
    found = {symbol: signature(SIX[symbol], np.linspace(0.1, 1.0, 10)) for symbol in ("zeta", "epsilon")}
    panels = plots.signatures(found).axes
    for panel, quantity in zip(panels, ("sine", "cosine"), strict=True):
        drawn = {line.get_label(): line.get_ydata() for line in panel.lines}
        for symbol, one in found.items():
            assert drawn[symbol] == pytest.approx(one[quantity].values)
        assert panel.get_xlabel().endswith("(rad)")
        assert panel.get_ylabel().endswith("(rad)")


def test_a_long_record_keeps_its_peaks_on_paper():
    time = np.arange(50_000) / 1000
    angle = 0.1 * np.cos(5.0 * time)
    angle[12_345], angle[40_001] = 0.3, -0.4
    record = xr.Dataset({"angle": ("time", angle)}, {"time": time})
    drawn = plots.motions(record, {}).lines[0].get_ydata()
    assert drawn.size <= MOST_POINTS
    assert {0.3, -0.4} <= set(drawn)


@pytest.mark.parametrize("text", ["$$", r"$x$\nand $\si{V}$"])
def test_a_text_that_is_no_mathematics_is_drawn_as_it_is(text):
    figure = style.new_figure(2.0, 2.0)
    ax = figure.subplots()
    ax.set(xlabel=text, title=f"load ({style.unit_label(text)})")
    ax.set_xticks([0, 1], [text, "b"])
    figure.savefig(io.BytesIO(), format="png")


@pytest.mark.parametrize(("low", "high"), [(0.19, 0.27), (1e-3, 0.4)])
def test_an_axis_of_a_backbone_has_numbers_from_end_to_end(low, high):
    amplitude = np.geomspace(low, high, 20)
    curve = {"frequency": 9.9 - amplitude**2, "damping_ratio": 0.01 + 0.1 * amplitude}
    columns = {f"{name}{end}": values for name, values in curve.items() for end in ("", "_low", "_high")}
    data = xr.Dataset({name: ("amplitude", values) for name, values in columns.items()})
    data = data.assign_coords(amplitude=("amplitude", amplitude, {"units": "rad"}))
    data = data.assign({f"period_{name}": ("period", values) for name, values in curve.items()})
    data = data.assign(period_amplitude=("period", amplitude))
    figure = plots.backbone(data)
    figure.canvas.draw()
    for panel in figure.axes:
        labels = [text.get_text() for text in (*panel.get_xticklabels(), *panel.get_xticklabels(minor=True))]
        assert len([label for label in labels if label and low <= float(label) <= high]) >= 3
