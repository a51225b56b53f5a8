"""The page: controls at the left, results at the right; each open page has its own files and process."""

import html
import json
import math
import re
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import panel
from bokeh.events import SelectionGeometry
from bokeh.models import BoxAnnotation, BoxSelectTool, ColumnDataSource
from bokeh.plotting import figure

from sysid_trib.app import messages, tasks
from sysid_trib.app.controls import WIDE, Controls
from sysid_trib.app.worker import Worker

panel.extension("filedropper")

# Largest file that can be dropped, in MB.
MOST_MEGABYTES = 200
FILE_KINDS = (
    f"Text, CSV, MATLAB, Excel, HDF5, Parquet or TDMS, at most {MOST_MEGABYTES} MB. It stays on this machine."
)
HOW_TO_CHOOSE = "Drag over the plot to choose a part of the record, or use the fields From and To."
# Seconds between looks at the worker, and from the last change of a control to the next computation.
POLLING, PAUSE = 0.15, 0.5
FOLDER = Path(__file__).parent
STYLE = (FOLDER / "parts.css").read_text(encoding="utf-8")
# The status is in the page itself, so that screen readers announce it.
SAY = """
const status = document.getElementById("status");
[status.className, status.textContent] = JSON.parse(cb_obj.value);
"""
# Characters that a file's name must not have.
UNSAFE = re.compile(r"[^\w.+ ()-]")
FAINT, CLEAR = {"opacity": "0.4"}, {"opacity": "1"}
LABELS = {".html": "Download the report", ".csv": "Download the numbers (CSV)"}


def safe_name(name: str) -> str:
    """Return a file's name without folders and special characters."""
    return UNSAFE.sub("_", name.replace("\\", "/").rpartition("/")[2])[-100:].strip(". ") or "record"


def text(content: str) -> Any:
    """Return a piece of HTML as a part of the page."""
    return panel.pane.HTML(content, stylesheets=[STYLE], margin=(0, 5), **WIDE)


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
        self.request = messages.Request(folder)
        self.worker = Worker()
        self.due = math.inf
        self.outdated: set[str] = set()
        self.controls = Controls(self._changed)
        self.drop = panel.widgets.FileDropper(max_file_size=f"{MOST_MEGABYTES}MB", previews=[], **WIDE)
        self.drop.param.watch(self._dropped, "value")
        samples = {"choose": "", **{name: name for name in tasks.sample_names()}}
        self.sample = panel.widgets.Select(name="Or a sample record", options=samples, **WIDE)
        self.sample.param.watch(self._sample_chosen, "value")
        self.cancel = panel.widgets.Button(name="Cancel", disabled=True, width=100)
        self.cancel.on_click(self._cancelled)
        self.status: Any = panel.widgets.TextInput(visible=False)
        self.status.jscallback(value=SAY)
        self.verdict, self.read = text(""), text("")
        self.parts = {name: panel.Column(**WIDE) for name in messages.TITLES}
        self._make_plot()
        self.template = self._laid_out()
        panel.state.on_session_destroyed(lambda _: self.close())
        panel.state.add_periodic_callback(self.tick, int(1000 * POLLING))
        if file is not None:
            self.begin(file=file, shown=str(file))

    def _make_plot(self) -> None:
        self.source = ColumnDataSource({"time": [], "value": []})
        self.box = BoxAnnotation(fill_color="#0b5394", fill_alpha=0.12, line_color="#0b5394")
        select = BoxSelectTool(dimensions="width")
        ranges = {"x_range": (0.0, 1.0), "y_range": (0.0, 1.0)}
        self.plot = figure(height=240, tools=[select], toolbar_location=None, **ranges, **WIDE)
        self.plot.line("time", "value", source=self.source, color="#333333", line_width=0.8)
        self.plot.add_layout(self.box)
        self.plot.xaxis.axis_label = "time (s)"
        self.plot.on_event(SelectionGeometry, self._dragged)

    def _laid_out(self) -> Any:
        of = self.controls
        controls = panel.Column(
            text(f"<h2>1. Record</h2><p class=hint>{FILE_KINDS}</p>"),
            *(self.drop, self.sample, of.reading),
            text("<h2>2. Window</h2>"),
            *(panel.Row(of.low, of.high), of.whole),
            text("<h2>3. System and forces</h2>"),
            of.system,
            text("<p class=hint>Forces to identify (--forces)</p>"),
            *(of.forces, text("<h2>4. Results</h2>"), of.laws, self.status),
            **WIDE,
        )
        plot = panel.pane.Bokeh(self.plot, **WIDE)
        shown = text("<h2>Record</h2>"), plot, text(f"<p class=hint>{HOW_TO_CHOOSE}</p>"), self.read
        self.record = panel.Column(*shown, visible=False, **WIDE)
        template = panel.Template((FOLDER / "page.html").read_text(encoding="utf-8"))
        template.add_panel("cancel", self.cancel)
        template.add_panel("controls", controls)
        template.add_panel("results", panel.Column(self.verdict, self.record, *self.parts.values(), **WIDE))
        return template

    def begin(self, **record: Any) -> None:
        """Show another record: `file` and the name `shown`, or `sample`."""
        self.request = messages.Request(self.request.folder, **record, suggest=True)
        self.controls.clear()
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
        self.close()
        # A folder of its own, so that no name is that of another file.
        self.request.folder.mkdir()
        file = Path(tempfile.mkdtemp(dir=self.request.folder)) / safe_name(name)
        file.write_bytes(content)
        self.sample.value = ""
        self.begin(file=file, shown=file.name)

    def _sample_chosen(self, event: Any) -> None:
        if event.new:
            self.begin(sample=event.new)

    def _dragged(self, event: Any) -> None:
        if event.final:
            self.controls.show_window(*sorted((event.geometry["x0"], event.geometry["x1"])))

    def _changed(self) -> None:
        # A chosen system is not replaced by the suggested one.
        if self.controls.system.value != self.request.system:
            self.request = replace(self.request, suggest=False)
        if self.request.file or self.request.sample:
            self.due = time.monotonic() + PAUSE

    def _cancelled(self, _: Any) -> None:
        self.worker.stop()
        self.due = math.inf
        self.cancel.disabled = True
        self._remove_outdated()
        self.say("", "Cancelled. Change a control to compute again.")

    def tick(self) -> None:
        """Start the computation that is due, and show what the worker has sent."""
        if time.monotonic() >= self.due:
            self.due = math.inf
            self._start()
        was_busy, failed = self.worker.busy, False
        for message in self.worker.messages():
            failed = failed or isinstance(message, messages.Failure)
            self._take(message)
        self.cancel.disabled = not self.worker.busy
        if was_busy and not self.worker.busy and not failed:
            self._remove_outdated()
            self.say("done", "Done.")

    def _start(self) -> None:
        self.request = replace(self.request, **self.controls.values())
        self._show_box()
        self.outdated = set(self.parts)
        for part in (self.verdict, *self.parts.values()):
            part.styles = FAINT
        self.worker.start(self.request)
        self.say("busy", "Reading the record ...")

    def _show_box(self) -> None:
        (low, high), ends = self.request.window, self.controls.ends
        self.box.left = ends[0] if low is None else low
        self.box.right = ends[1] if high is None else high

    def _take(self, message: Any) -> None:
        """Show what the worker has sent."""
        if isinstance(message, messages.Progress):
            done = "" if message.done is None else f", {message.done:.0%}"
            self.say("busy", f"{message.activity}{done} ...")
        elif isinstance(message, messages.Signal):
            self._show_signal(message)
        elif isinstance(message, messages.Section):
            self._show_part(message)
        else:
            self._show_failure(message)

    def _show_signal(self, signal: messages.Signal) -> None:
        self.source.data = {"time": signal.time, "value": signal.value}
        self.plot.x_range.update(start=signal.ends[0], end=signal.ends[1])
        self.plot.y_range.update(start=signal.limits[0], end=signal.limits[1])
        self.plot.yaxis.axis_label = signal.label.replace("$", "")
        self.read.object = signal.text
        self.controls.offer_columns(signal.columns)
        self.controls.show_record(signal.ends)
        self._show_box()
        self.record.visible = True
        if self.request.suggest:
            self.request = replace(self.request, suggest=False)
            self.controls.show_system(signal.system, signal.forces)

    def _show_part(self, part: messages.Section) -> None:
        stem = Path(self.request.shown or self.request.sample).stem
        files = [
            panel.widgets.FileDownload(
                file=str(file), filename=f"{stem}_{file.name}", label=LABELS[file.suffix]
            )
            for file in part.files
        ]
        copy = panel.widgets.Button(name="Copy the command")
        copy.js_on_click(code=f"navigator.clipboard.writeText({json.dumps(part.command)})")
        command = (
            f"<p class=hint>The same in a terminal:</p><pre tabindex=0>{html.escape(part.command)}</pre>"
        )
        self._fill(part.name, [text(part.text), text(command), panel.Row(*files, copy)])
        if part.verdict:
            self.verdict.object = f"<p class=verdict>{html.escape(part.verdict)}</p>"
            self.verdict.styles = CLEAR

    def _show_failure(self, failure: messages.Failure) -> None:
        self.say("error", failure.text)
        if failure.part:
            self._fill(failure.part, [text(f"<p class=error>{html.escape(failure.text)}</p>")])
            return
        self._remove_outdated()
        if failure.choices:
            self.controls.offer_columns(failure.choices, signals_only=True)
        self.controls.reading.collapsed = False

    def _fill(self, name: str, content: Sequence[Any]) -> None:
        self.outdated.discard(name)
        self.parts[name][:] = [text(f"<h2>{messages.TITLES[name]}</h2>"), *content]
        self.parts[name].styles = CLEAR

    def _remove_outdated(self) -> None:
        """Remove the parts of an earlier choice."""
        for name in self.outdated:
            self.parts[name].clear()
        if "identify" in self.outdated:
            self.verdict.object = ""

    def say(self, kind: str, said: str) -> None:
        """Show the status: its kind is `busy`, `done`, `error` or empty."""
        self.status.value = json.dumps([kind, said])

    def close(self) -> None:
        """End the process of this page, and remove its files."""
        self.worker.stop()
        shutil.rmtree(self.request.folder, ignore_errors=True)
