"""The controls of the page: how the record is read, its window, the system and its forces."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import panel

import sysid_trib as st
from sysid_trib.app import tasks

# Offered values of options; the first leaves the choice to the file.
SIGNAL_CHOICES = ["", "angle", "displacement", "rate", "acceleration"]
TIME_CHOICES = ["", "s", "ms", "us", "ns", "min", "h", "d"]
# A window is rounded to this part of the record, so that the command is short.
WINDOW_STEP = 1e-3
WIDE: dict[str, Any] = {"sizing_mode": "stretch_width"}
# Buttons without a name; the arrow keys do the same.
NO_SPINNERS = ".bk-spin-btn { display: none !important; }"
FLAT = {"box-shadow": "none", "border": "1px solid #c8c8c8"}
LAWS = "Friction and restoring force as curves, too"


class Controls:
    """The controls of one page, which begin at a known record by `clear`.

    Parameters
    ----------
    changed : callable
        Called when the user has changed a value.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        widgets = panel.widgets
        self._changed = changed
        # Whether the program itself changes the values.
        self._setting = False
        self.ends = 0.0, 0.0
        number = {"value": None, "stylesheets": [NO_SPINNERS]}
        column = {"restrict": False, "min_characters": 0, "case_sensitive": False, **WIDE}
        rate = "Samples per second (--sampling-rate)"
        self._reading: dict[str, Any] = {
            "angle": widgets.AutocompleteInput(name="Column of the signal (--angle)", **column),
            "units": widgets.TextInput(
                name="Unit of the signal (--units)", placeholder="rad, deg, mm, V ...", **WIDE
            ),
            "signal": widgets.Select(name="Measured quantity (--signal)", options=SIGNAL_CHOICES, **WIDE),
            "time": widgets.AutocompleteInput(name="Column of the time (--time)", **column),
            "time_units": widgets.Select(
                name="Unit of the time (--time-units)", options=TIME_CHOICES, **WIDE
            ),
            "sampling_rate": widgets.FloatInput(name=rate, start=0.0, **number, **WIDE),
        }
        self.reading = panel.Card(
            *self._reading.values(), title="How the file is read", collapsed=True, styles=FLAT, **WIDE
        )
        self.low = widgets.FloatInput(name="From (s)", width=130, **number)
        self.high = widgets.FloatInput(name="To (s)", width=130, **number)
        self.whole = widgets.Button(name="Whole record", width=130)
        self.whole.on_click(lambda _: self.show_window(*self.ends))
        known = {f"{name}: {system.meaning}": name for name, system in st.forces.load_systems().items()}
        self.system = widgets.Select(name="System (--system)", options={"not stated": "", **known}, **WIDE)
        self.forces = widgets.CheckBoxGroup(**WIDE)
        self.laws = widgets.CheckBoxGroup(options=[LAWS], value=[LAWS], **WIDE)
        self.show_system("", ())
        self.system.param.watch(self._system_chosen, "value")
        for widget in (*self._reading.values(), self.low, self.high, self.forces, self.laws):
            widget.param.watch(self._chosen, "value")

    def values(self) -> dict[str, Any]:
        """Return the chosen values as attributes of a request."""
        system, forces = self.system.value, tuple(self.forces.value)
        return {
            "reading": {name: widget.value for name, widget in self._reading.items() if widget.value},
            "window": self._window(),
            "system": system,
            "forces": () if set(forces) == set(tasks.usual_forces(system)) else forces,
            "laws": bool(self.laws.value),
        }

    def clear(self) -> None:
        """Forget the choices for an earlier record."""
        with self._set_by_program():
            for widget in self._reading.values():
                widget.value = None if isinstance(widget, panel.widgets.FloatInput) else ""
            self.low.value = self.high.value = None
        self.ends = 0.0, 0.0
        self.show_system("", ())

    def offer_columns(self, columns: Sequence[str], *, signals_only: bool = False) -> None:
        """Offer the columns of the file."""
        for name in ("angle",) if signals_only else ("angle", "time"):
            self._reading[name].options = [*columns]

    def show_window(self, low: float, high: float) -> None:
        """Show a window, rounded and within the record."""
        (first, last), step = self.ends, WINDOW_STEP * (self.ends[1] - self.ends[0])
        if min(high, last) - max(low, first) > step > 0.0:
            digits = -math.floor(math.log10(step))
            self.low.value = round(max(low, first), digits)
            self.high.value = round(min(high, last), digits)

    def show_record(self, ends: tuple[float, float]) -> None:
        """Show the window of a record as it was read."""
        low, high = self._window()
        self.ends = ends
        with self._set_by_program():
            self.show_window(ends[0] if low is None else low, ends[1] if high is None else high)

    def show_system(self, system: str, forces: tuple[str, ...]) -> None:
        """Show a system, its forces, and the chosen ones among them; by default the usual ones."""
        names = tasks.force_names(system)
        with self._set_by_program():
            self.system.value = system
            self.forces.options = {f"{name} ({symbol})": symbol for symbol, name in names.items()}
            self.forces.value = list(forces or tasks.usual_forces(system))

    def _window(self) -> tuple[float | None, float | None]:
        """Return the window in the fields; None for an end of the record."""
        low, high, (first, last) = self.low.value, self.high.value, self.ends
        step = WINDOW_STEP * (last - first)
        known = last > first
        return (
            None if low is None or (known and low <= first + step) else low,
            None if high is None or (known and high >= last - step) else high,
        )

    def _chosen(self, _: Any) -> None:
        if not self._setting:
            self._changed()

    def _system_chosen(self, event: Any) -> None:
        if not self._setting:
            self.show_system(event.new, ())
            self._changed()

    @contextmanager
    def _set_by_program(self) -> Iterator[None]:
        before, self._setting = self._setting, True
        yield
        self._setting = before
