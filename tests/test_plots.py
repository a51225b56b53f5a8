"""Figures show the numbers that they are given."""

import numpy as np
import pytest
import xarray as xr

from sysid_trib import load_library, plots, signature

SIX = load_library()


def test_signatures_are_drawn_as_they_are():
    found = {symbol: signature(SIX[symbol], np.linspace(0.1, 1.0, 10)) for symbol in ("zeta", "epsilon")}
    panels = plots.signatures(found).axes
    for panel, quantity in zip(panels, ("sine", "cosine"), strict=True):
        drawn = {line.get_label(): line.get_ydata() for line in panel.lines}
        for symbol, one in found.items():
            assert drawn[symbol] == pytest.approx(one[quantity].values)
        assert panel.get_xlabel().endswith("(rad)")
        assert panel.get_ylabel().endswith("(rad)")


def test_twins_are_drawn_over_what_is_varied():
    varied = xr.Variable("release", [0.2, 0.4, 0.8], {"long_name": "release from", "units": "rad"})
    away = [[0.0, 1.0, 0.2], [0.0, 4.0, 0.5], [0.0, 9.0, 2.0]]
    found = xr.DataArray(away, {"release": varied, "other": ["itself", "near", "far"]}, ("release", "other"))
    axes = plots.distinction(found)
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert drawn["near"] == pytest.approx([1.0, 4.0, 9.0])
    assert "itself" not in drawn
    assert axes.get_xlabel() == "release from (rad)"
