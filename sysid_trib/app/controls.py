"""The controls of the page: how the record is read, its window, the system and its forces."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import panel

import sysid_trib as st

# Values that the page offers; with the first, empty one, the reader decides from the file.
SIGNAL_CHOICES = ["", "angle", "displacement", "rate", "acceleration"]
TIME_CHOICES = ["", "s", "ms", "us", "ns", "min", "h", "d"]
# A window is rounded to this part of the record, so that the command is short.
WINDOW_STEP = 1e-3
WIDE: dict[str, Any] = {"sizing_mode": "stretch_width"}
# A frame about what the keyboard acts on.
FOCUSED: dict[str, Any] = {
    "stylesheets": [":focus-visible { outline: 2px solid #0b5394 !important; outline-offset: 1px; }"]
}
# Number fields without buttons, which have no name; the arrow keys do the same.
NUMBER_FIELD: dict[str, Any] = {"value": None, "stylesheets": [".bk-spin-btn { display: none !important; }"]}
COLUMN_FIELD: dict[str, Any] = {"restrict": False, "min_characters": 0, "case_sensitive": False, **WIDE}
LAWS = "Friction and restoring force as curves, too"
FLAT = {"box-shadow": "none", "border": "1px solid #c8c8c8"}


class Controls:
    """The controls of one page.

    Parameters
    ----------
    changed : callable
        Called when a value has changed.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        widgets = panel.widgets
        self._reading: dict[str, Any] = {
            "angle": widgets.AutocompleteInput(name="Column of the signal (--angle)", **COLUMN_FIELD),
            "units": widgets.TextInput(
                name="Unit of the signal (--units)", placeholder="rad, deg, mm, V ...", **WIDE
            ),
            "signal": widgets.Select(name="Measured quantity (--signal)", options=SIGNAL_CHOICES, **WIDE),
            "time": widgets.AutocompleteInput(name="Column of the time (--time)", **COLUMN_FIELD),
            "time_units": widgets.Select(
                name="Unit of the time (--time-units)", options=TIME_CHOICES, **WIDE
            ),
            "sampling_rate": widgets.FloatInput(
                name="Samples per second (--sampling-rate)", start=0.0, **NUMBER_FIELD, **WIDE
            ),
        }
        self.reading = panel.Card(
            *self._reading.values(),
            title="How the file is read",
            collapsed=True,
            styles=FLAT,
            **FOCUSED,
            **WIDE,
        )
        self.low = widgets.FloatInput(name="From (s)", placeholder="start", width=130, **NUMBER_FIELD)
        self.high = widgets.FloatInput(name="To (s)", placeholder="end", width=130, **NUMBER_FIELD)
        self.whole = widgets.Button(name="Whole record", width=130, **FOCUSED)
        self.whole.on_click(lambda _: self.show_whole())
        known = {f"{name}: {system.meaning}": name for name, system in st.forces.load_systems().items()}
        self.system = widgets.Select(name="System (--system)", options={"not stated": "", **known}, **WIDE)
        self.system.param.watch(lambda _: self._show_forces(), "value")
        self.forces = widgets.CheckBoxGroup(**WIDE)
        # A single check box has no label for screen readers.
        self.laws = widgets.CheckBoxGroup(options=[LAWS], value=[LAWS], **WIDE)
        self._show_forces()
        for widget in (*self._reading.values(), self.low, self.high, self.system, self.forces, self.laws):
            widget.param.watch(lambda _: changed(), "value")

    def values(self) -> dict[str, Any]:
        """Return the chosen values as attributes of a request; no forces if they are the usual ones."""
        forces = tuple(self.forces.value)
        return {
            "reading": {name: widget.value for name, widget in self._reading.items() if widget.value},
            "window": (self.low.value, self.high.value),
            "system": self.system.value,
            "forces": () if set(forces) == set(self._known_system().usual) else forces,
            "laws": bool(self.laws.value),
        }

    def clear(self) -> None:
        """Forget the choices for an earlier record."""
        for widget in self._reading.values():
            widget.value = None if isinstance(widget, panel.widgets.FloatInput) else ""
        self.reading.collapsed = True
        self.show_whole()
        self.show_system("", ())

    def offer_columns(self, columns: Sequence[str], *names: str) -> None:
        """Offer the columns of the file for these options."""
        for name in names:
            self._reading[name].options = [*columns]

    def show_whole(self) -> None:
        """Show the whole record as the window."""
        self.low.value = self.high.value = None

    def show_window(self, low: float, high: float, ends: tuple[float, float]) -> None:
        """Show a window, rounded and within the ends of the record."""
        step = WINDOW_STEP * (ends[1] - ends[0])
        if min(high, ends[1]) - max(low, ends[0]) > step > 0.0:
            digits = -math.floor(math.log10(step))
            self.low.value = round(low, digits) if low > ends[0] + step else None
            self.high.value = round(high, digits) if high < ends[1] - step else None

    def show_system(self, system: str, forces: tuple[str, ...]) -> None:
        """Show a system, and the chosen ones of its forces; by default the usual ones."""
        self.system.value = system
        self._show_forces(forces)

    def _show_forces(self, forces: tuple[str, ...] = ()) -> None:
        system = self._known_system()
        self.forces.options = {f"{force.name} ({force.symbol})": force.symbol for force in system.choices}
        self.forces.value = [*(forces or system.usual)]

    def _known_system(self) -> Any:
        return st.forces.load_system(self.system.value or None)
