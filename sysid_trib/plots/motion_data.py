"""A record and the motions of its models as numbers to draw, the same on paper and on a page."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.plots.style import MODEL_LINES, Style
from sysid_trib.records.half_sines import envelope as half_sine_envelope
from sysid_trib.results.discoveries import tied_name
from sysid_trib.results.variables import record_groups, signal_label, signal_units, small_units
from sysid_trib.validation.verdict import breakdown, run_record_noise

# Points of a curve: as many as a wide screen has, for each the least and the largest of its stretch.
MOST_POINTS = 3000
# Effects that a legend names.
MOST_NAMES = 2


@dataclass(frozen=True)
class MotionData:
    """A record, its models that have a motion, and the noise.

    Attributes
    ----------
    data : xr.Dataset
        `angle(time)` and, with models, `simulated_angle(model, time)`, rad.
    noise : float, rad
        Standard deviation of a sample.
    lines : mapping of str to style
        Line of each model by its name; lines of a higher `zorder` lie on others.
    labels : mapping of str to str
        What a legend calls each model.
    """

    data: xr.Dataset
    noise: float
    lines: Mapping[str, Style]
    labels: Mapping[str, str]

    @property
    def time(self) -> Array:
        """Instants of the samples, s."""
        return self.data.time.values

    @property
    def angle(self) -> Array:
        """Angle of the record, rad."""
        return self.data.angle.values

    def motion(self, model: str) -> Array:
        """Angle of a model, rad."""
        return self.data.simulated_angle.sel(model=model).values

    @property
    def units(self) -> str:
        """Unit of the record."""
        return signal_units(self.data)

    @property
    def label(self) -> str:
        """Label of an axis of the record."""
        return signal_label(self.units)

    @property
    def small_units(self) -> tuple[float, str]:
        """Factor and unit of what is small beside the record."""
        return small_units(self.units)

    def residual(self, model: str) -> Array:
        """Record minus model, in small units."""
        return self.small_units[0] * (self.angle - self.motion(model))

    @cached_property
    def half_periods(self) -> Mapping[str, xr.Dataset]:
        """Envelopes of the record (`record`) and of each model, by the same half-sine fits.

        First-order averages of a model would differ at large amplitude. A motion without half periods has
        no envelope.
        """
        motions = {"record": self.angle} | {name: self.motion(name) for name in self.lines}
        envelopes = {}
        for name, angle in motions.items():
            with suppress(SysidTribError):
                envelopes[name] = half_sine_envelope(self.data[["angle"]].assign(angle=("time", angle)))
        return envelopes

    def amplitude_limits(self) -> tuple[float, float]:
        """Ends of an axis of the record's amplitudes, rad; an error bar may reach below zero."""
        amplitude = self.half_periods["record"].amplitude.values
        low = max(0.8 * float(np.min(amplitude)), 0.2 * float(np.median(amplitude)))
        return low, 1.15 * float(np.max(amplitude))

    def frequency_limits(self) -> tuple[float, float]:
        """Ends of an axis of the record's frequencies, rad/s; outliers at the noise floor are outside."""
        low, high = np.percentile(self.half_periods["record"].frequency.values, [3, 97])
        return low - 0.4 * (high - low), high + 0.4 * (high - low)


def motion_data(tree: xr.DataTree, run: int) -> MotionData:
    """The record of a run with the models of a cross-check, or those before and after of a discovery."""
    data = tree[record_groups(tree)[run]].to_dataset()
    if "steps" in tree.children:
        names = ("before", "after")
        labels = {"before": "start model", "after": f"with {_few(_tied_names(tree))}"}
        shown = [np.isfinite(data.simulated_angle.sel(model=name).values).all() for name in names]
    else:
        checked = tree["comparison"].attrs
        names = (checked["first"], checked["second"])
        labels = {name: name for name in names}
        # A model that broke down must not set a scale.
        shown = [not breakdown(tree, name) for name in names]
    lines = {name: style for name, style, drawn in zip(names, MODEL_LINES, shown, strict=True) if drawn}
    noise = run_record_noise(tree, run)
    return MotionData(data, noise, lines, labels)


def _tied_names(tree: xr.DataTree) -> list[str]:
    """The effects of the final model, each with what it cannot be separated from."""
    count = tree["steps"].attrs["count"]
    names = [tied_name(tree["steps"].to_dataset().isel(step=at), 1) for at in range(count)]
    return [f"({name})" if " or " in name and count > 1 else name for name in names]


def _few(effects: Sequence[str]) -> str:
    """Names of effects, the first of many."""
    if len(effects) > MOST_NAMES:
        return f"{', '.join(effects[: MOST_NAMES - 1])} and {len(effects) - MOST_NAMES + 1} more"
    return " and ".join(effects) or "no effect"


def drawn_samples(values: Array) -> NDArray[np.intp]:
    """Samples that draw a curve: the least and the largest of each stretch, so that no peak is lost."""
    if values.size <= MOST_POINTS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, MOST_POINTS // 2 + 1).astype(int)
    ends = [start + f(values[start:stop]) for start, stop in pairwise(edges) for f in (np.argmin, np.argmax)]
    return np.unique(ends)
