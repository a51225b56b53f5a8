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

import sysid_trib as st
from sysid_trib.app import messages
from sysid_trib.app.controls import FOCUSED, WIDE, Controls
from sysid_trib.app.worker import Worker

panel.extension("filedropper")

# Largest file that can be dropped, in MB.
MOST_MEGABYTES = 200
FILE_KINDS = (
    f"Text, CSV, MATLAB, Excel, HDF5, Parquet or TDMS, at most {MOST_MEGABYTES} MB. It stays on this machine."
)
HOW_TO_CHOOSE = "Drag over the plot to choose a part of the record, or use the fields From and To."
# Seconds between looks at the worker.
POLLING = 0.15
# Seconds from the last change of a control to the next computation.
PAUSE = 0.5
FOLDER = Path(__file__).parent
STYLE = (FOLDER / "parts.css").read_text(encoding="utf-8")
# The status is in the page itself, so that screen readers announce it.
SAY = """
const status = document.getElementById("status");
[status.className, status.textContent] = JSON.parse(cb_obj.value);
"""
# Characters that a file's name must not have.
UNSAFE = re.compile(r"[^\w.+ ()-]")
# Styles of results of an earlier choice, and of current ones.
FAINT = {"opacity": "0.4"}
CLEAR = {"opacity": "1"}
# Value of the first sample, which needs no file.
EXAMPLE = "Synthetic example"


def safe_name(name: str) -> str:
    """Return a file's name without folders and special characters."""
    return UNSAFE.sub("_", name.replace("\\", "/").rpartition("/")[2])[-100:].strip(". ") or "record"


def text(content: str) -> Any:
    """Return a piece of HTML as a part of the page."""
    return panel.pane.HTML(content, stylesheets=[STYLE], margin=(0, 5), **WIDE)


def sample_names() -> list[str]:
    """Return the names of the records that can be chosen without a file; the app takes no driven records."""
    table = st.datasets.table()
    return [EXAMPLE, *table.index[table.kind != "driven"]]


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
        self.worker = Worker()
        # The record with its suggestion, and what was computed last.
        self.begun: messages.Request | None = None
        self.started: messages.Request | None = None
        self.due = math.inf
        self.ends = 0.0, 0.0
        self.verdict = ""
        self.controls = Controls(self._changed)
        self.drop = panel.widgets.FileDropper(max_file_size=f"{MOST_MEGABYTES}MB", previews=[], **WIDE)
        self.drop.param.watch(self._dropped, "value")
        samples = ["choose", *sample_names()]
        self.sample = panel.widgets.Select(name="Or a sample record", options=samples, **WIDE)
        self.sample.param.watch(self._sample_chosen, "value")
        self.cancel = panel.widgets.Button(name="Cancel", disabled=True, width=100, **FOCUSED)
        self.cancel.on_click(self._cancelled)
        self.status: Any = panel.widgets.TextInput(visible=False)
        self.status.jscallback(value=SAY)
        self.read = text("")
        self.parts = {name: panel.Column(**WIDE) for name in messages.TITLES}
        self._make_plot()
        self.template = self._laid_out()
        panel.state.on_session_destroyed(lambda _: self.close())
        panel.state.add_periodic_callback(self.tick, int(1000 * POLLING))
        if file is not None:
            self.begin(str(file), str(file))

    def _make_plot(self) -> None:
        self.source = ColumnDataSource({"time": [], "value": []})
        self.box = BoxAnnotation(fill_color="#0b5394", fill_alpha=0.12, line_color="#0b5394")
        select = BoxSelectTool(dimensions="width")
        self.plot = figure(height=240, tools=[select], toolbar_location=None, **WIDE)
        self.plot.line("time", "value", source=self.source, color="#333333", line_width=0.8)
        self.plot.add_layout(self.box)
        self.plot.x_range.range_padding = 0.0
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
        template.add_panel("results", panel.Column(self.record, *self.parts.values(), **WIDE))
        return template

    def begin(self, record: str, shown: str) -> None:
        """Show another record: its file or name, and its name in the command."""
        self.controls.clear()
        self.begun = messages.Request(self.folder, record, shown, suggest=True)
        self.started = None
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
        self.folder.mkdir()
        file = Path(tempfile.mkdtemp(dir=self.folder)) / safe_name(name)
        file.write_bytes(content)
        self.sample.value = "choose"
        self.begin(str(file), file.name)

    def _sample_chosen(self, event: Any) -> None:
        if event.new == EXAMPLE:
            self.begin("", "")
        elif event.new != "choose":
            self.begin(f"dataset:{event.new}", f"dataset:{event.new}")

    def _dragged(self, event: Any) -> None:
        if event.final:
            low, high = sorted((event.geometry["x0"], event.geometry["x1"]))
            self.controls.show_window(low, high, self.ends)

    def _changed(self) -> None:
        if self.begun:
            self.due = time.monotonic() + PAUSE

    def _cancelled(self, _: Any) -> None:
        self.worker.stop()
        self.started, self.due = None, math.inf
        self.cancel.disabled = True
        self._remove_outdated()
        self.say("", "Cancelled. Change a control to compute again.")

    def tick(self) -> None:
        """Start the computation that is due, and show what the worker has sent."""
        if self.begun and time.monotonic() >= self.due:
            self.due = math.inf
            self._start(replace(self.begun, **self.controls.values()))
        was_busy = self.worker.busy
        failed = False
        for message in self.worker.messages():
            failed = failed or isinstance(message, messages.Failure)
            self._take(message)
        self.cancel.disabled = not self.worker.busy
        if was_busy and not self.worker.busy and not failed:
            self._remove_outdated()
            self.say("done", f"Done. {self.verdict}")

    def _start(self, request: messages.Request) -> None:
        # The program itself shows the suggested forces, which were computed already.
        if request == self.started:
            return
        # A chosen system is not replaced by the suggested one.
        self.started = replace(request, suggest=request.suggest and not request.system)
        self._show_box()
        for part in self.parts.values():
            part.styles = FAINT
        self.worker.start(self.started)
        self.say("busy", "Reading the record ...")

    def _show_box(self) -> None:
        low, high = self.controls.values()["window"]
        self.box.left = self.ends[0] if low is None else low
        self.box.right = self.ends[1] if high is None else high

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
        self.plot.yaxis.axis_label = signal.label.replace("$", "")
        self.read.object = signal.text
        self.controls.offer_columns(signal.columns, "angle", "time")
        self.ends = signal.ends
        self._show_box()
        self.record.visible = True
        if self.begun and self.started and self.started.suggest and not self.controls.system.value:
            self.begun = replace(self.begun, suggest=False)
            self.started = replace(self.started, system=signal.system, forces=signal.forces, suggest=False)
            self.controls.show_system(signal.system, signal.forces)

    def _show_part(self, part: messages.Section) -> None:
        stem = Path(self.started.shown).stem if self.started else ""
        files = [
            panel.widgets.FileDownload(file=str(file), filename=f"{stem}_{file.name}", **FOCUSED)
            for file in part.files
        ]
        copy = panel.widgets.Button(name="Copy the command", **FOCUSED)
        copy.js_on_click(
            code=f"navigator.clipboard.writeText({json.dumps(part.command)}); cb_obj.origin.label = 'Copied'"
        )
        command = (
            f"<p class=hint>The same in a terminal:</p><pre tabindex=0>{html.escape(part.command)}</pre>"
        )
        self._fill(part.name, [text(part.text), text(command), panel.Row(*files, copy)])
        if part.name == "identify":
            self.verdict = part.verdict

    def _show_failure(self, failure: messages.Failure) -> None:
        self.say("error", failure.text)
        if failure.part:
            self._fill(failure.part, [text(f"<p class=error>{html.escape(failure.text)}</p>")])
            return
        self._remove_outdated()
        if failure.choices:
            self.controls.offer_columns(failure.choices, "angle")
        self.controls.reading.collapsed = False

    def _fill(self, name: str, content: Sequence[Any]) -> None:
        self.parts[name][:] = [text(f"<h2>{messages.TITLES[name]}</h2>"), *content]
        self.parts[name].styles = CLEAR

    def _remove_outdated(self) -> None:
        """Remove the parts of an earlier choice."""
        for part in self.parts.values():
            if part.styles == FAINT:
                part.clear()

    def say(self, kind: str, said: str) -> None:
        """Show the status: its kind is `busy`, `done`, `error` or empty."""
        self.status.value = json.dumps([kind, said])

    def close(self) -> None:
        """End the process of this page, and remove its files."""
        self.worker.stop()
        shutil.rmtree(self.folder, ignore_errors=True)
