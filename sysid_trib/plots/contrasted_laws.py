"""The laws of two samples and their difference, with the ranges in which it is significant."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from sysid_trib.plots import style
from sysid_trib.plots.figure import FULL_WIDTH, LEGEND, shows
from sysid_trib.plots.style import GREY, INK
from sysid_trib.printing.law_difference import LAWS_TITLE
from sysid_trib.results.law_curves import LAW_DIFFERENCE, LAW_WORDS, VARIABLE_OF_LAW


@shows("difference", block=LAWS_TITLE, groups=(LAW_DIFFERENCE,))
def law_difference(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Difference of the laws of two samples, first minus second, with a simultaneous band.

    The band contains the whole difference with a probability of 95 %. Dark: where the band excludes zero.
    Forces are divided by the inertia.

    Parameters
    ----------
    data : Dataset
        Result of `physics.law_difference`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time, noise = np.arange(0.0, 8.0, 0.02), np.random.default_rng(0)
    >>> models = [st.Model("contact_forces", {"zeta": zeta}, 9.91) for zeta in (0.01, 0.015)]
    >>> angles = [st.simulate(model, time, 0.3).angle + noise.normal(0.0, 1e-4, 400) for model in models]
    >>> contrast = st.physics.law_difference(*[st.laws(angle) for angle in angles])
    >>> [ax.get_xlabel() for ax in st.plots.law_difference(contrast).axes]
    ['speed (rad/s)', 'displacement (rad)']
    """
    figure, panels = style.grid(2, 2, width, row_height=2.4)
    for ax, law in zip(panels, VARIABLE_OF_LAW, strict=True):
        _draw(ax, data, law)
    style.letter(panels, [LAW_WORDS[law] for law in VARIABLE_OF_LAW])
    return figure


def _draw(ax: Axes, data: xr.Dataset, law: str) -> None:
    variable = VARIABLE_OF_LAW[law]
    places, difference = data[variable].values, data[f"{law}_difference"].values
    low, high = (data[f"{law}_difference_{end}"].values for end in ("low", "high"))
    differs = data[f"{law}_differs"].values
    # A line across zero would connect the two sides of a jump.
    for side in (places < 0.0, places > 0.0):
        if side.any():
            ax.fill_between(places[side], low[side], high[side], color=GREY, alpha=0.25, linewidth=0)
            ax.plot(places[side], difference[side], color=GREY, linewidth=1.0)
            marked = np.where(differs[side], difference[side], np.nan)
            ax.plot(places[side], marked, color=INK, linewidth=2.0)
    band = Patch(color=GREY, alpha=0.25, linewidth=0, label="95 % band")
    ax.legend(handles=[band, Line2D([], [], color=INK, linewidth=2.0, label="differs")], **LEGEND, ncols=2)
    ax.axhline(0.0, color=INK, linewidth=0.6)
    of_law = style.unit_label(data[f"{law}_difference"].attrs["units"])
    ax.set(xlabel=f"{variable} ({data[variable].attrs['units']})", ylabel=f"difference ({of_law})")
