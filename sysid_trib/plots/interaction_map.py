"""Map of the force that depends on displacement and speed together, in addition to both laws."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.plots.figure import ONE_COLUMN, TWO_COLUMNS, new_figure, shows
from sysid_trib.plots.style import BAR_WIDTH, INK

# Number of standard errors beyond which the map differs from zero.
DIFFERS = 2.0
FACE_NOT_VISITED = "0.9"


@shows("laws", block="Position and speed together", groups=("interaction",))
def interaction(data: xr.Dataset, *, width: float = ONE_COLUMN) -> Figure:
    """Force, divided by the inertia, that products of displacement and speed add to both laws.

    Hatched: less than two standard errors from zero. Grey: not visited by the motion of the record.

    Parameters
    ----------
    data : Dataset
        Group `interaction` of a result of `laws`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    Van der Pol's damping depends on displacement and speed together.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model(st.library("zeta", van_der_pol="x**2*v"), {"zeta": 0.01, "van_der_pol": 0.5}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 10.0, 0.02), angle=0.5).angle
    >>> result = st.laws(angle + np.random.default_rng(0).normal(0.0, 1e-4, 500))
    >>> figure = st.plots.interaction(result["interaction"])
    >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
    ('displacement (rad)', 'speed (rad/s)')
    """
    figure = new_figure(min(width, TWO_COLUMNS), height=2.7)
    ax = figure.subplots()
    x, speed = data.displacement.values, data.speed.values
    force = np.where(data.visited.values, data.force.values, np.nan).T
    largest = float(np.nanmax(np.abs(force)))
    # Six steps to either side of zero.
    levels = np.linspace(-largest, largest, 13)
    ax.set_facecolor(FACE_NOT_VISITED)
    shades = ax.contourf(x, speed, force, levels=levels, cmap="RdBu_r")
    ax.contour(x, speed, force, levels=[0.0], colors=INK, linewidths=BAR_WIDTH)
    unclear = np.abs(force) < DIFFERS * data.standard_error.values.T
    if unclear.any():
        # The uncertain cells are filled with one level, drawn as hatches only.
        ax.contourf(x, speed, unclear.astype(float), levels=[0.5, 1.5], colors="none", hatches=["////"])
    bar = figure.colorbar(shades, ax=ax, ticks=[-largest, 0.0, largest], format="%.2g")
    bar.set_label(f"force / inertia ({data.force.attrs['units'].replace('^2', '²')})")
    ax.set(xlabel=f"displacement ({data.displacement.attrs['units']})")
    ax.set(ylabel=f"speed ({data.speed.attrs['units']})")
    return figure
