"""The laws: friction against speed, and the nonlinear part of the restoring force, with bands."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.arrays import Mask
from sysid_trib.plots import style
from sysid_trib.plots.figure import LEGEND, ONE_COLUMN, shows
from sysid_trib.plots.style import BAR_WIDTH, BLUE, GREY, INK, ORANGE
from sysid_trib.results import judged, law_curves
from sysid_trib.results.law_curves import Curve
from sysid_trib.results.variables import signal_units

# Height of a panel, inch.
LAW_HEIGHT = 2.3
# The first method is drawn below the second, and wider, so that both are visible where they agree.
LAW_LOOKS: tuple[dict[str, Any], ...] = (
    {"color": ORANGE, "linewidth": 2.2, "alpha": 0.75, "zorder": 3},
    {"color": BLUE, "linewidth": 1.0, "zorder": 4},
)
# Opacity of bands in the visited range and beyond.
BAND_OPACITY, FAINT_OPACITY = 0.25, 0.12
NOT_VISITED: dict[str, Any] = {"color": "0.93", "linewidth": 0, "zorder": 0}
# Largest number of drawn formulas: further ones would coincide with them.
FORMULAS_DRAWN = 3
FORMULA: dict[str, Any] = {"color": INK, "linewidth": 0.5, "linestyle": (0, (1, 1.5)), "zorder": 5}


@shows("laws", block="Friction against speed")
def laws(tree: xr.DataTree, *, width: float = ONE_COLUMN) -> Figure:
    """Friction against speed, and the restoring force minus its known part against displacement.

    Both are divided by the inertia. The known part is the straight line w^2 x and forces with fixed
    coefficients. The lines are the laws by each method; a band contains the whole law in the visited range
    with a probability of 95 %. Grey: not visited by the record; the dashed lines there are extrapolations.
    Thin dotted lines: the simplest formulas that stay within the band of the preferred method.

    Parameters
    ----------
    tree : DataTree
        Result of `laws`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3).angle
    >>> figure = st.plots.laws(st.laws(angle + np.random.default_rng(0).normal(0.0, 1e-4, 400)))
    >>> [ax.get_xlabel() for ax in figure.axes]
    ['speed (rad/s)', 'displacement (rad)']
    """
    unit = signal_units(tree)
    inertia = "inertia" if unit == "rad" else "mass"
    results, answer = judged.kept_results(tree), judged.preferred_of(tree)
    main = tree[answer].to_dataset()
    named = law_curves.laws_in(main)
    figure, panels = style.grid(len(named), 2, width, LAW_HEIGHT)
    held = law_curves.known_part(main, np.zeros(1))[1]
    symbol = r"\theta" if unit == "rad" else "x"
    for ax, law in zip(panels, named, strict=True):
        if not results:
            style.no_data(ax, style.ALL_FAILED)
            continue
        curves = law_curves.curves_of(results, law, answer, mirrored=True)
        if law == "restoring":
            curves = {
                n: curve.without(law_curves.known_part(main, curve.places)[0]) for n, curve in curves.items()
            }
        odd = {name for name in curves if np.all(results[name][law_curves.VARIABLE_OF_LAW[law]] > 0.0)}
        _draw(ax, curves, answer, odd if len(odd) < len(curves) else set())
        if f"{law}_formulas" in tree:
            _draw_formulas(ax, tree[f"{law}_formulas"].to_dataset(), law, main)
    panels[0].set(xlabel=f"speed ({unit}/s)")
    panels[0].set(ylabel=f"friction / {inertia} ({unit}/s²)")
    if len(panels) > 1:
        panels[1].set(xlabel=f"displacement ({unit})")
        known = " \N{MINUS SIGN} ".join([f"$w^2{symbol}$", *held])
        panels[1].set(ylabel=f"force \N{MINUS SIGN} {known} ({unit}/s²)")
    if results:
        panels[0].legend(**LEGEND, ncols=2)
    if len(panels) > 1:
        style.letter(panels)
    return figure


@shows("laws", block="Friction of each run", groups=("own_laws",))
def own_laws(data: xr.Dataset, *, width: float = ONE_COLUMN) -> Figure:
    """Laws of each run that has its own laws, with their simultaneous 95 % bands in the visited ranges.

    Laws are divided by the inertia.

    Parameters
    ----------
    data : Dataset
        The group `own_laws` of a result of `laws`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time, noise = np.arange(0.0, 8.0, 0.02), np.random.default_rng(0)
    >>> models = [st.Model("contact_forces", {"zeta": zeta}, 9.91) for zeta in (0.01, 0.015)]
    >>> angles = [st.simulate(model, time, 0.3).angle + noise.normal(0.0, 1e-4, 400) for model in models]
    >>> result = st.laws([angle.to_dataset(name="angle") for angle in angles], own=["friction"])
    >>> [ax.get_xlabel() for ax in st.plots.own_laws(result["own_laws"]).axes]
    ['speed (rad/s)']
    """
    own = [law for law in law_curves.VARIABLE_OF_LAW if np.ptp(data[law].values, axis=0).any()]
    figure, panels = style.grid(len(own), 2, width, LAW_HEIGHT)
    for ax, law in zip(panels, own, strict=True):
        places = data[law_curves.VARIABLE_OF_LAW[law]]
        for at, run in enumerate(data.run.values.tolist()):
            series = style.SERIES[at % len(style.SERIES)]
            label = f"run {run}"
            for side in _sides(law_curves.curve_of(data.sel(run=run), law)):
                seen = side.visited
                band = {"color": series["color"], "alpha": BAND_OPACITY, "linewidth": 0}
                ax.fill_between(side.places, side.low, side.high, where=seen, **band)
                ax.plot(side.places, np.where(seen, side.values, np.nan), label=label, **style.line(series))
                label = ""
        ax.axhline(0.0, color=INK, linewidth=BAR_WIDTH, zorder=1)
        word = "friction" if law == "friction" else "restoring force"
        inertia = "inertia" if data.speed.attrs["units"] == "rad/s" else "mass"
        ax.set(xlabel=f"{places.name} ({places.attrs['units']})")
        ax.set(ylabel=f"{word} / {inertia} ({style.unit_label(data[law].attrs['units'])})")
    panels[0].legend(**LEGEND, ncols=3)
    if len(panels) > 1:
        style.letter(panels)
    return figure


def _draw(ax: Axes, curves: dict[str, Curve], answer: str, odd: set[str]) -> None:
    """Draw the curves of each method with their bands, mirrored for `odd` laws, and the record's limits."""
    ends: list[float] = []
    looks = LAW_LOOKS[-len(curves) :] if curves else ()
    for (name, curve), look in zip(curves.items(), looks, strict=True):
        label = f"{name} (preferred)" if name == answer and len(curves) > 1 else name
        label += " (odd part)" * (name in odd)
        for side in _sides(curve):
            seen = side.visited
            # A continuation starts at the last visited point.
            continued = ~seen | _at_edge(seen)
            for at, alpha in ((seen, BAND_OPACITY), (continued, FAINT_OPACITY)):
                band = {"color": look["color"], "alpha": alpha, "linewidth": 0, "zorder": 2}
                ax.fill_between(side.places, side.low, side.high, where=at, **band)
            ax.plot(side.places, np.where(seen, side.values, np.nan), label=label, **look)
            ax.plot(
                side.places, np.where(continued, side.values, np.nan), **look | {"linestyle": (0, (3, 2))}
            )
            label = ""
        visited_values = curve.values[curve.visited]
        ends += [visited_values.min(), visited_values.max()]
        if name == answer:
            ends += [curve.low[curve.visited].min(), curve.high[curve.visited].max()]
    ax.axhline(0.0, color=INK, linewidth=BAR_WIDTH, zorder=1)
    if not curves:
        return
    main = curves.get(answer, next(iter(curves.values())))
    largest, last = np.max(main.places[main.visited]), np.max(main.places)
    both = bool(np.any(main.places < 0.0))
    ax.axvspan(largest, last, **NOT_VISITED)
    if both:
        ax.axvspan(-last, -largest, **NOT_VISITED)
        ax.axvline(0.0, color=GREY, linewidth=BAR_WIDTH, zorder=1)
    low, high = min(*ends, 0.0), max(*ends, 0.0)
    # A continuation may be arbitrarily large and is cut.
    room, most = 0.06 * (high - low), 0.45 * (high - low)
    low = min(low, max(float(main.values.min()), low - most)) - room
    high = max(high, min(float(main.values.max()), high + most)) + room
    ax.set(xlim=(-last if both else 0.0, last), ylim=(low, high))


def _draw_formulas(ax: Axes, formulas: xr.Dataset, law: str, result: xr.Dataset) -> None:
    """Draw the simplest formulas of a law over the visited range."""
    places = formulas[law_curves.VARIABLE_OF_LAW[law]].values
    known = law_curves.known_part(result, places)[0] if law == "restoring" else np.zeros_like(places)
    for at, values in enumerate(formulas[law].values[:FORMULAS_DRAWN]):
        ax.plot(places, values - known, label="" if at else "formulas", **FORMULA)


def _at_edge(seen: Mask) -> Mask:
    """Return the visited points next to a point that is not visited."""
    padded = np.concatenate([[True], seen, [True]])
    return np.asarray(seen & ~(padded[:-2] & padded[2:]))


def _sides(curve: Curve) -> list[Curve]:
    """Return the parts of a law for each sign: friction may be discontinuous between them."""
    signs = [curve.places < 0.0, curve.places > 0.0]
    return [
        Curve(
            curve.places[at],
            curve.values[at],
            curve.errors[at],
            curve.low[at],
            curve.high[at],
            curve.visited[at],
        )
        for at in signs
        if np.any(at)
    ]
