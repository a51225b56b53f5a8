"""The page: controls at the left, results at the right; each open page has its own files and process."""

import html
import json
import math
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import panel
from bokeh.events import SelectionGeometry
from bokeh.models import BoxAnnotation, BoxSelectTool, ColumnDataSource
from bokeh.plotting import figure

import sysid_trib as st
from sysid_trib.app import tasks
from sysid_trib.app.worker import Worker

panel.extension("filedropper")

# Largest file that can be dropped, in MB.
MOST_MEGABYTES = 200
# Seconds between looks at the worker, and from the last change of a control to the next computation.
TICK, PAUSE = 0.15, 0.5
# A window is rounded to this part of the record.
WINDOW_STEP = 1e-3
TITLES = {
    "backbone": "Backbone",
    "identify": "Coefficients and residual",
    "laws": "Friction and restoring force",
}
FOLDER = Path(__file__).parent
STYLE = (FOLDER / "parts.css").read_text(encoding="utf-8")
# The status is in the page itself, so that screen readers announce it.
SAY = """
const status = document.getElementById("status");
const [kind, text] = JSON.parse(cb_obj.value);
status.className = kind;
status.textContent = text;
"""
# Characters that may be in a file's name.
UNSAFE = re.compile(r"[^\w.+ ()-]")


def safe_name(name: str) -> str:
    """Return a file's name without folders and special characters."""
    return UNSAFE.sub("_", name.replace("\\", "/").rpartition("/")[2])[-100:].strip(". ") or "record"


def text(content: str) -> Any:
    """Return a piece of HTML as a part of the page."""
    return panel.pane.HTML(content, stylesheets=[STYLE], sizing_mode="stretch_width", margin=(0, 5))


class Page:
    """One open page.

    Parameters
    ----------
    folder : Path
        Temporary folder of this page alone.
    file : Path or None
        Record to begin with.
    """

    def __init__(self, folder: Path, file: Path | None) -> None:
        self.folder = folder
        self.request = tasks.Request(folder)
        self.worker = Worker()
        # Time of the next computation; whether the program itself changes the controls.
        self.due, self.setting = math.inf, False
        self.whole = 0.0, 0.0
        self.status: Any = panel.widgets.TextInput(visible=False)
        self.status.jscallback(value=SAY)
        self.read = text("")
        self.parts = {name: panel.Column(sizing_mode="stretch_width") for name in tasks.PARTS}
        self._make_record_controls()
        self._make_model_controls()
        self._make_plot()
        self.template = self._laid_out()
        panel.state.on_session_destroyed(lambda _: self.close())
        panel.state.add_periodic_callback(self.tick, int(1000 * TICK))
        if file is not None:
            self.begin(file=file, shown=str(file))

    def _make_record_controls(self) -> None:
        widgets = panel.widgets
        wide: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self.drop = widgets.FileDropper(max_file_size=f"{MOST_MEGABYTES}MB", previews=[], **wide)
        self.drop.param.watch(self._dropped, "value")
        samples = {"(choose)": "", **{name: name for name in tasks.sample_names()}}
        self.sample = widgets.Select(name="Or a sample record", options=samples, **wide)
        self.sample.param.watch(lambda event: event.new and self.begin(sample=event.new), "value")
        column: dict[str, Any] = {"restrict": False, "min_characters": 0, "case_sensitive": False, **wide}
        self.reading = {
            "angle": widgets.AutocompleteInput(name="Column of the signal (--angle)", **column),
            "time": widgets.AutocompleteInput(name="Column of the time (--time)", **column),
            "units": widgets.TextInput(name="Unit of the signal (--units): rad, deg, mm, V ...", **wide),
            "signal": widgets.Select(
                name="Measured quantity (--signal)",
                options={"by unit and name": "", **{s: s for s in tasks.QUANTITIES}},
                **wide,
            ),
            "sampling_rate": widgets.FloatInput(
                name="Samples per second (--sampling-rate), without a time column",
                value=None,
                start=0.0,
                **wide,
            ),
            "time_units": widgets.Select(
                name="Unit of the time (--time-units)",
                options={"from the header, or s": "", **{u: u for u in tasks.TIME_UNITS}},
                **wide,
            ),
        }
        self.window = [
            widgets.FloatInput(name=name, value=None, width=130) for name in ("From (s)", "To (s)")
        ]
        for widget in (*self.reading.values(), *self.window):
            widget.param.watch(self._changed, "value")
        self.reset = widgets.Button(name="Whole record", width=130)
        self.reset.on_click(lambda _: self._set_window(*self.whole))

    def _make_model_controls(self) -> None:
        widgets = panel.widgets
        named = {f"{name}: {of.meaning}": name for name, of in st.forces.load_systems().items()}
        options = {"(not stated)": "", **named}
        self.system = widgets.Select(name="System (--system)", options=options, sizing_mode="stretch_width")
        self.forces = widgets.CheckBoxGroup(sizing_mode="stretch_width")
        self.laws = widgets.Checkbox(name="Friction and restoring force, too (takes longest)", value=True)
        self.cancel = widgets.Button(name="Cancel", disabled=True, width=130)
        self._set_system("", ())
        self.system.param.watch(self._system_chosen, "value")
        for widget in (self.forces, self.laws):
            widget.param.watch(self._changed, "value")
        self.cancel.on_click(self._cancelled)

    def _make_plot(self) -> None:
        self.source = ColumnDataSource({"time": [], "value": []})
        self.box = BoxAnnotation(fill_color="#0b5394", fill_alpha=0.1, line_color="#0b5394", visible=False)
        select = BoxSelectTool(dimensions="width")
        self.plot = figure(
            height=240, sizing_mode="stretch_width", tools=[select], toolbar_location=None, active_drag=select
        )
        self.plot.line("time", "value", source=self.source, color="#333333", line_width=0.8)
        self.plot.add_layout(self.box)
        self.plot.xaxis.axis_label = "time (s)"
        self.plot.on_event(SelectionGeometry, self._dragged)

    def _laid_out(self) -> Any:
        hint = "Drag over the plot to choose a part of the record, or use the fields From and To."
        self.shown_record = panel.Column(
            text("<h2>Record</h2>"),
            self.read,
            panel.pane.Bokeh(self.plot, sizing_mode="stretch_width"),
            text(f"<p class=hint>{hint}</p>"),
            visible=False,
            sizing_mode="stretch_width",
        )
        self.card = panel.Card(
            *self.reading.values(), title="How the file is read", collapsed=True, sizing_mode="stretch_width"
        )
        kinds = f"Text, CSV, MATLAB, Excel, HDF5, Parquet or TDMS, at most {MOST_MEGABYTES} MB."
        controls = panel.Column(
            text(f"<h2>1. Record</h2><p class=hint>{kinds} It stays on this machine.</p>"),
            self.drop,
            self.sample,
            self.card,
            text("<h2>2. Window</h2>"),
            panel.Row(*self.window),
            self.reset,
            text("<h2>3. System and forces</h2>"),
            self.system,
            text("<p>Forces to identify (--forces)</p>"),
            self.forces,
            self.laws,
            self.cancel,
            self.status,
            sizing_mode="stretch_width",
        )
        results = panel.Column(self.shown_record, *self.parts.values(), sizing_mode="stretch_width")
        template = panel.Template((FOLDER / "page.html").read_text(encoding="utf-8"))
        template.add_panel("controls", controls)
        template.add_panel("results", results)
        return template

    # Events of the controls.

    def begin(self, **record: Any) -> None:
        """Show another record: `file` and the name `shown`, or `sample`."""
        self.request = tasks.Request(self.folder, **record, suggest=True)
        with self._set_by_program():
            for widget in self.reading.values():
                widget.value = None if isinstance(widget, panel.widgets.FloatInput) else ""
            for widget in self.window:
                widget.value = None
        self.due = time.monotonic()

    def _dropped(self, event: Any) -> None:
        if not event.new:
            return
        name, data = list(event.new.items())[-1]
        # Free the memory; the file is on the disk.
        self.drop.value = {}
        content = data.encode() if isinstance(data, str) else data
        if len(content) > 1e6 * MOST_MEGABYTES:
            self.say("error", f"The file has more than {MOST_MEGABYTES} MB: use the commands in a terminal.")
            return
        self.worker.stop()
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        # A folder of its own, so that no name can meet that of another file.
        file = Path(tempfile.mkdtemp(dir=self.folder)) / safe_name(name)
        file.write_bytes(content)
        with self._set_by_program():
            self.sample.value = ""
        self.begin(file=file, shown=file.name)

    def _dragged(self, event: SelectionGeometry) -> None:
        if event.final:
            self._set_window(*sorted((event.geometry["x0"], event.geometry["x1"])))

    def _set_window(self, low: float, high: float) -> None:
        first, last = self.whole
        if last > first:
            digits = -math.floor(math.log10(WINDOW_STEP * (last - first)))
            for widget, value in zip(self.window, (max(low, first), min(high, last)), strict=True):
                widget.value = round(value, digits)

    def _system_chosen(self, event: Any) -> None:
        if not self.setting:
            self._set_system(event.new, ())
            self._changed()

    def _set_system(self, system: str, forces: tuple[str, ...]) -> None:
        """Show a system, its forces, and the chosen ones among them."""
        names = tasks.force_names(system)
        with self._set_by_program():
            self.system.value = system
            self.forces.options = {f"{name} ({symbol})": symbol for symbol, name in names.items()}
            self.forces.value = list(forces or tasks.usual_forces(system))

    def _changed(self, *_: Any) -> None:
        if not self.setting and (self.request.file or self.request.sample):
            self.due = time.monotonic() + PAUSE

    def _cancelled(self, _: Any) -> None:
        self.worker.stop()
        self.due = math.inf
        self._clear(outdated=True)
        self.say("", "Cancelled. Change a control to compute again.")

    @contextmanager
    def _set_by_program(self) -> Iterator[None]:
        before, self.setting = self.setting, True
        try:
            yield
        finally:
            self.setting = before

    # The work.

    def tick(self) -> None:
        """Start the computation that is due, and show what the worker has sent."""
        if time.monotonic() >= self.due:
            self.due = math.inf
            self._start()
        failed = False
        was_busy = self.worker.busy
        for message in self.worker.messages():
            failed = self._take(message) or failed
        self.cancel.disabled = not self.worker.busy
        if was_busy and not self.worker.busy and not failed:
            self.say("done", "Done.")

    def _start(self) -> None:
        reading = {name: widget.value for name, widget in self.reading.items() if widget.value}
        low, high = (widget.value for widget in self.window)
        chosen = tuple(self.forces.value)
        self.request = replace(
            self.request,
            reading=reading,
            window=(
                None if low is None or low <= self.whole[0] else low,
                None if high is None or high >= self.whole[1] else high,
            ),
            system=self.system.value,
            forces=() if set(chosen) == set(tasks.usual_forces(self.system.value)) else chosen,
            laws=self.laws.value,
        )
        for part in self.parts.values():
            part.styles = {"opacity": "0.4"}
        self.worker.start(self.request)
        self.say("busy", "Reading the record ...")

    def _take(self, message: Any) -> bool:
        """Show what the worker has sent; return true for an error."""
        if isinstance(message, tasks.Progress):
            name, _, detail = message.activity.partition(": ")
            done = "" if message.done is None else f", {message.done:.0%}"
            self.say("busy", f"{TITLES.get(name, name)}{': ' if detail else ''}{detail}{done} ...")
        elif isinstance(message, tasks.Signal):
            self._show_signal(message)
        elif isinstance(message, tasks.Part):
            self._show_part(message)
        elif isinstance(message, tasks.Failure):
            self._show_failure(message)
        return isinstance(message, tasks.Failure)

    def _show_signal(self, signal: tasks.Signal) -> None:
        self.source.data = {"time": signal.time, "value": signal.value}
        self.plot.yaxis.axis_label = signal.label.replace("$", "")
        self.read.object = signal.text
        for name in ("angle", "time"):
            self.reading[name].options = [*signal.columns]
        self.whole = float(signal.time[0]), float(signal.time[-1])
        low, high = self.request.window
        self.box.left = self.whole[0] if low is None else low
        self.box.right = self.whole[1] if high is None else high
        self.box.visible = self.shown_record.visible = True
        with self._set_by_program():
            self._set_window(self.box.left, self.box.right)
        if self.request.suggest:
            self._set_system(signal.system, signal.forces)

    def _show_part(self, part: tasks.Part) -> None:
        stem = Path(self.request.shown or self.request.sample).stem
        files = [
            panel.widgets.FileDownload(
                file=str(file), filename=f"{stem}_{file.name}", label=f"Download the {title}", embed=False
            )
            for title, file in part.files.items()
        ]
        copy = panel.widgets.Button(name="Copy the command")
        copy.js_on_click(code=f"navigator.clipboard.writeText({json.dumps(part.command)})")
        command = f"<p>The same in a terminal:</p><pre tabindex=0>{html.escape(part.command)}</pre>"
        self._fill(part.name, [text(part.text), panel.Row(*files, copy), text(command)])

    def _show_failure(self, failure: tasks.Failure) -> None:
        self.say("error", failure.text)
        if failure.part:
            self._fill(failure.part, [text(f"<p class=error>{html.escape(failure.text)}</p>")])
            return
        self._clear(outdated=True)
        if failure.choices:
            self.reading["angle"].options = [*failure.choices]
            self.reading["angle"].value_input = ""
        self.card.collapsed = False

    def _fill(self, name: str, content: list[Any]) -> None:
        part = self.parts[name]
        part[:] = [text(f"<h2>{TITLES[name]}</h2>"), *content]
        part.styles = {}

    def _clear(self, *, outdated: bool) -> None:
        """Remove the parts, or those of an earlier choice."""
        for part in self.parts.values():
            if part.styles or not outdated:
                part.clear()

    def say(self, kind: str, said: str) -> None:
        """Show the status: its kind is `busy`, `done`, `error` or empty."""
        self.status.value = json.dumps([kind, said])

    def close(self) -> None:
        """End the process of this page, and remove its files."""
        self.worker.stop()
        shutil.rmtree(self.folder, ignore_errors=True)
