"""Figure for publications in tribology: the coefficient of friction against sliding speed."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.figure import LEGEND, ONE_COLUMN, TWO_COLUMNS, new_figure, shows
from sysid_trib.plots.style import BLUE, ORANGE
from sysid_trib.results.kinds import MU
from sysid_trib.results.law_curves import LAWS_SI


@shows("laws", block="Friction against speed", groups=(LAWS_SI,))
def friction_coefficient(data: xr.Dataset, *, width: float = ONE_COLUMN) -> Figure:
    """Coefficient of friction against sliding speed, or the friction if no load is known.

    The band contains the whole law over the visited range with a probability of 95 %. Dashed: extrapolation
    beyond the speeds of the record.

    Parameters
    ----------
    data : Dataset
        Result of `physics.laws_in_si`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3).angle
    >>> result = st.laws(angle + np.random.default_rng(0).normal(0.0, 1e-4, 400))
    >>> measured = {"inertia": (0.012, 0.0), "load": (2.0, 0.0), "radius": (0.01, 0.0)}
    >>> laws = st.physics.laws_in_si(result, **measured)
    >>> [ax.get_xlabel() for ax in st.plots.friction_coefficient(laws).axes]
    ['sliding speed (m/s)']
    """
    name = MU if MU in data else "friction"
    figure = new_figure(min(width, TWO_COLUMNS), height=2.5)
    ax = figure.subplots()
    speed = data.speed.values
    sides = {"forward": speed > 0.0, "backward": speed < 0.0}
    sides = {label: side for label, side in sides.items() if side.any()}
    for (label, side), colour in zip(sides.items(), (BLUE, ORANGE), strict=False):
        _law(ax, data.isel(speed=np.flatnonzero(side)), name, colour, label if len(sides) > 1 else "law")
    along = data["sliding_speed" if MU in data else "speed"]
    what = "coefficient of friction" if name == MU else f"friction ({data.friction.attrs['units']})"
    ax.set(xlabel=f"{'sliding ' * (name == MU)}speed ({along.attrs['units']})", ylabel=what)
    low, high = ax.get_ylim()
    ax.set(xlim=(0.0, float(np.abs(along).max())), ylim=(min(0.0, low), max(0.0, high)))
    ax.legend(**LEGEND, ncols=3)
    return figure


def _law(ax: Axes, data: xr.Dataset, name: str, colour: str, label: str) -> None:
    """Draw a law of one direction of motion: its band over the visited range, dashed beyond it."""
    data = data.sortby(np.abs(data.speed))
    along = np.abs(data["sliding_speed" if name == MU else "speed"].values)
    sign, visited = np.sign(data.speed.values), data.speed_visited.values
    values, low, high = (sign * data[f"{name}{end}"].values for end in ("", "_low", "_high"))
    look: dict[str, Any] = {"color": colour, "linewidth": 1.2}
    ax.fill_between(
        along[visited], low[visited], high[visited], color=colour, alpha=0.25, linewidth=0, label="95 % band"
    )
    ax.plot(along[visited], values[visited], label=label, **look)
    not_visited = ~visited | (along >= along[visited].max(initial=0.0))
    ax.plot(
        along[not_visited],
        values[not_visited],
        linestyle="--",
        label="not visited",
        **look | {"linewidth": 0.9},
    )
