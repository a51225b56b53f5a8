"""Figures of the paper and of studies show what their results hold."""

import numpy as np
import pytest
import xarray as xr
from helpers import FIVE, W, paper_run
from known_results import PAPER, known

from sysid_trib import Model, free_decay, load_library, plots, simulate
from sysid_trib.physics import predict_envelope, weights
from sysid_trib.records import envelope

LIBRARY = load_library()
TIME = np.arange(0.0, 40.0, 0.05)


def moved(coefficients):
    model = Model(LIBRARY, coefficients, 1.0)
    return simulate(model, TIME, 1.0), predict_envelope(model, TIME, 1.0)


def labelled(axes):
    return {line.get_label(): line for line in axes.lines}


def test_a_decay_stands_inside_its_averaged_envelope():
    motion, averaged = moved({"zeta": 0.05})
    axes = plots.motions(motion, {"averaged envelope": averaged})
    curve, upper, lower = axes.lines
    np.testing.assert_array_equal(curve.get_ydata(), motion.angle)
    np.testing.assert_array_equal(upper.get_ydata(), averaged.amplitude)
    np.testing.assert_array_equal(lower.get_ydata(), -averaged.amplitude)
    assert axes.get_xlabel() == "time (s)"
    assert "(rad)" in axes.get_ylabel()


def test_half_periods_are_marks_and_the_averaged_model_a_line_of_their_colour():
    measured, predicted = {}, {}
    for nu in (-0.5, 0.9):
        motion, predicted[f"{nu}"] = moved({"zeta": 0.05, "nu": nu})
        measured[f"{nu}"] = envelope(motion)
    axes = plots.frequency_shift(measured, predicted)
    for label, found in measured.items():
        marks = labelled(axes)[label]
        np.testing.assert_array_equal(marks.get_xdata(), found.amplitude)
        np.testing.assert_array_equal(marks.get_ydata(), found.frequency)
        assert marks.get_linestyle() == "None"
        same = [line for line in axes.lines if line.get_color() == marks.get_color() and line is not marks]
        np.testing.assert_array_equal(same[0].get_ydata(), predicted[label].frequency)
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert texts == list(measured)


def test_a_record_has_error_bars_and_a_model_beside_it_a_label():
    found = envelope(paper_run(FIVE).decay(0))
    line = predict_envelope(paper_run(FIVE).model, np.linspace(0.0, 20.0, 50), 0.3)
    axes = plots.frequency_shift({"record": found}, {"model": line})
    heights = [np.ptp(path.vertices[:, 1]) for path in axes.collections[0].get_paths()]
    np.testing.assert_allclose(heights, 2 * found.frequency_standard_error, rtol=1e-6)
    np.testing.assert_array_equal(labelled(axes)["model"].get_xdata(), line.amplitude)


@pytest.mark.parametrize("begin", [0.0, 0.4])
def test_half_sines_go_through_their_extrema(begin):
    decay = paper_run(FIVE).decay(0)
    found = envelope(decay)
    part = decay.sel(time=slice(begin, begin + 1.5))
    axes = plots.half_sines(part, found)
    lines = labelled(axes)
    extrema = lines[r"$\pm b_i$ at $t_i$"]
    shown = np.isin(found.extremum_time, extrema.get_xdata())
    assert shown.sum() == extrema.get_xdata().size >= 3
    np.testing.assert_array_equal(extrema.get_ydata(), (found.sign * found.extremum)[shown])
    # The arcs are the record, to the noise and what a decaying half period is beside a half-sine.
    arcs = lines["half-sines"]
    time, angle = (values[np.isfinite(values)] for values in (arcs.get_xdata(), arcs.get_ydata()))
    np.testing.assert_allclose(np.interp(time, part.time, part.angle), angle, atol=0.02 * angle.max())
    # The chord: its middle is the amplitude of the instant between, its length the period there.
    chord = next(line for line in axes.lines if line.get_color() == "black")
    instant = int(np.flatnonzero(shown)[0])
    assert abs(chord.get_ydata().mean()) == pytest.approx(found.amplitude[instant].item(), rel=1e-12)
    assert np.ptp(chord.get_xdata()) == pytest.approx(2 * np.pi / found.frequency[instant].item(), rel=1e-12)


def test_a_record_too_short_for_a_construction_has_its_half_sines():
    decay = paper_run(FIVE).decay(0)
    axes = plots.half_sines(decay.sel(time=slice(0.1, 0.6)), envelope(decay))
    assert labelled(axes)[r"$\pm b_i$ at $t_i$"].get_xdata().size == 1


def test_motions_beside_the_record():
    record = paper_run(FIVE).decay(0)
    model = Model(LIBRARY, {"zeta": 0.01}, W)
    motions = {"one force": simulate(model, record.time.values, 0.3)}
    lines = labelled(plots.motions(record, motions))
    np.testing.assert_array_equal(lines["record"].get_ydata(), record.angle)
    np.testing.assert_array_equal(lines["one force"].get_ydata(), motions["one force"].angle)


@pytest.mark.parametrize(
    ("quantity", "unit"), [("peak_force", " (rad)"), ("decay", " (rad)"), ("frequency_share", "")]
)
def test_weights_against_amplitude(quantity, unit):
    found = weights(known(PAPER), np.linspace(0.02, 0.3, 15))
    axes = plots.weights(found, quantity)
    lines = labelled(axes)
    np.testing.assert_array_equal(lines[r"$\nu$"].get_ydata(), found[quantity].sel(force="nu"))
    np.testing.assert_array_equal(lines[r"$\lambda$"].get_xdata(), found.amplitude)
    assert axes.get_ylabel() == found[quantity].attrs["long_name"] + unit


def study():
    error = np.arange(1.0, 25.0).reshape(2, 3, 4)
    dims = ("method", "level", "force")
    return xr.Dataset(
        {"error": (dims, error), "bound": (dims[1:], 0.5 * error[0])},
        {
            "method": ["direct", "averaging"],
            "level": ("level", [1e-4, 1e-3, 1e-2], {"long_name": "noise", "units": "rad"}),
            "force": ["lambda", "zeta", "nu", "mine"],
        },
    )


def test_errors_of_a_study_stand_above_the_bound():
    found = study()
    figure = plots.precision(found)
    lines = labelled(figure.axes[1])
    np.testing.assert_array_equal(lines["averaging"].get_ydata(), found.error[1].sel(force="zeta"))
    np.testing.assert_array_equal(lines["Cramér-Rao bound"].get_ydata(), found.bound.sel(force="zeta"))
    assert figure.axes[1].get_xlabel() == "noise (rad)"
    assert [panel.get_title(loc="left") for panel in figure.axes] == [
        r"$\lambda$",
        r"$\zeta$",
        r"$\nu$",
        r"$\mathrm{mine}$",
    ]
    # Levels stand below the last panel of each column.
    assert [bool(panel.get_xlabel()) for panel in figure.axes] == [False, True, True, True]


def test_close_levels_are_labelled_themselves():
    found = study().assign_coords(level=("level", [25.0, 100.0, 400.0], {"long_name": "rate", "units": "Hz"}))
    labels = [text.get_text() for text in plots.precision(found).axes[2].get_xticklabels()]
    assert labels == ["25", "100", "400"]


def test_a_displacement_has_its_own_unit_on_the_axes():
    time = np.linspace(0.0, 10.0, 1000)
    shown = xr.Dataset(
        {"angle": ("time", 5.0 * np.exp(-0.02 * time) * np.cos(6.3 * time), {"units": "mm"})}, {"time": time}
    )
    decay = free_decay(shown, equilibrium=0.0)
    assert plots.motions(decay, {"model": decay}).get_ylabel() == "displacement $x$ (mm)"
    half_periods = envelope(decay)
    assert plots.half_sines(decay.isel(time=slice(300)), half_periods).get_ylabel().endswith("(mm)")
    assert plots.frequency_shift({"it": half_periods}, {}).get_xlabel() == "amplitude $a$ (mm)"
