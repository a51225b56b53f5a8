"""The app in a browser, as a person uses it, and with hostile files."""

import contextlib
import gzip
import os
import re
import signal
import subprocess
import sys
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import linear, write_table
from headless import FLAGS, browser_path

import sysid_trib as st

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser_path() is None, reason="no chromium on this machine"),
    pytest.mark.skipif(os.name == "nt", reason="sends a signal"),
]
PATIENCE = 120_000
TIME = np.arange(0.0, 10.0, 0.02)
# Label of the focused element.
FOCUSED = """() => {
    let element = document.activeElement;
    while (element.shadowRoot?.activeElement) element = element.shadowRoot.activeElement;
    return element === document.body ? "body" : element.labels?.[0]?.innerText || element.innerText;
}"""
# A control without a name, in the tree that screen readers get.
UNNAMED = re.compile(r"- (?:button|textbox|combobox|checkbox|spinbutton)(?: \[.*|:|)$", re.MULTILINE)
PENDULUM = f"pendulum: {st.forces.load_systems()['pendulum'].meaning}"
SIGNAL = linear(TIME) + 1e-4 * np.random.default_rng(0).standard_normal(TIME.size)


@dataclass
class Server:
    url: str
    folder: Path
    errors: Path


@dataclass
class Opened:
    """An open page, what it complained of, and what it asked for."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def drop(self, file: Path) -> None:
        """Drop a file, and wait until its computation has begun or has failed."""
        self.page.locator("#status").evaluate("element => { element.className = 'waiting' }")
        self.page.locator("input[type=file]").set_input_files(file)
        self.until("busy", "error")

    def until(self, *kinds: str) -> str:
        """Wait for one of these kinds of status, and return its text."""
        selector = ", ".join(f"#status.{kind}" for kind in kinds)
        return self.page.wait_for_selector(selector, timeout=PATIENCE).text_content()

    @property
    def cancel(self):
        return self.page.get_by_role("banner").get_by_role("button", name="Cancel")

    def command(self, name: str) -> str:
        return self.page.locator("pre", has_text=f"sysid-trib {name} ").text_content(timeout=PATIENCE)

    def until_command(self, name: str, part: str) -> None:
        selector = f"pre:has-text('sysid-trib {name}'):has-text('{part}')"
        self.page.wait_for_selector(selector, timeout=PATIENCE)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    pytest.importorskip("panel")
    folder = tmp_path_factory.mktemp("temporary")
    errors = tmp_path_factory.mktemp("errors") / "stderr.txt"
    command = [sys.executable, "-m", "sysid_trib", "app", "--no-browser"]
    options = {"stdout": subprocess.PIPE, "text": True, "env": os.environ | {"TMPDIR": str(folder)}}
    with errors.open("w") as stream, subprocess.Popen(command, stderr=stream, **options) as running:
        url = re.search(r"http://\S+", running.stdout.readline())[0]
        yield Server(url, folder, errors)
        running.send_signal(signal.SIGINT)
        assert running.wait(timeout=60) == 0
    assert "Traceback" not in errors.read_text()
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=browser_path(), args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture
def open_page(server, browser):
    with contextlib.ExitStack() as stack:

        def opened():
            page = browser.new_page(viewport={"width": 1280, "height": 900}, accept_downloads=True)
            stack.callback(page.close)
            shown = Opened(page)
            page.on("console", lambda m: shown.complaints.append(m.text) if m.type == "error" else None)
            page.on("pageerror", lambda error: shown.complaints.append(str(error)))
            page.on("dialog", lambda dialog: shown.complaints.append(f"dialog {dialog.message}"))
            page.on("request", lambda request: shown.requests.append(request.url))
            page.goto(server.url)
            page.get_by_label("From (s)").wait_for(timeout=PATIENCE)
            return shown

        yield opened


@pytest.fixture(scope="module")
def swing(tmp_path_factory):
    return write_table(tmp_path_factory.mktemp("files") / "swing.csv", "time (s),angle (rad)", TIME, SIGNAL)


def test_from_a_dropped_file_to_downloads(open_page, server, swing):
    shown = open_page()
    page = shown.page
    shown.drop(swing)
    assert shown.until("done", "error") == "Done. The model explains the record: the residual is noise."
    assert "swing.csv" in shown.command("identify")
    # The window: by the plot, then by a field.
    frame = page.locator(".bk-Figure").bounding_box()
    page.mouse.move(frame["x"] + 0.4 * frame["width"], frame["y"] + 100)
    page.mouse.down()
    page.mouse.move(frame["x"] + 0.9 * frame["width"], frame["y"] + 110, steps=8)
    page.mouse.up()
    shown.until_command("backbone", "--window")
    low = float(page.get_by_label("From (s)").input_value())
    assert 2.0 < low < 5.0
    page.get_by_label("From (s)").fill("1")
    page.keyboard.press("Enter")
    shown.until_command("backbone", "--window 1:")
    page.get_by_label("System (--system)").select_option(PENDULUM)
    page.get_by_label("Friction and restoring force as curves, too").uncheck()
    shown.until_command("identify", "--system pendulum")
    assert shown.until("done", "error").startswith("Done. ")
    assert page.get_by_role("heading", name="Friction and restoring force").count() == 0
    assert "gravity" in page.locator("table").last.text_content()
    for name, part in (
        ("swing_identify.html", "sysid-trib identify swing.csv --window 1:"),
        ("swing_coefficients.csv", "averaging,zeta,"),
    ):
        with page.expect_download(timeout=PATIENCE) as download:
            page.get_by_text(f"Download {name}").click()
        assert download.value.suggested_filename == name
        assert part in Path(download.value.path()).read_text(encoding="utf-8")
    assert all(image.get_attribute("alt") for image in page.locator("img").all())
    assert shown.complaints == []
    assert {url.split("/")[2] for url in shown.requests if url.startswith(("http", "ws"))} == {
        server.url.split("/")[2]
    }


def test_cancel_ends_the_computation_and_pages_are_apart(open_page, server, swing):
    shown, other = open_page(), open_page()
    shown.drop(swing)
    shown.cancel.click()
    shown.page.get_by_text("Cancelled.").wait_for(timeout=PATIENCE)
    assert shown.cancel.is_disabled()
    assert other.page.locator("#status").text_content() == "Choose a record."
    assert other.page.get_by_text("swing.csv").count() == 0
    assert len(list(server.folder.glob("sysid-trib-*/*"))) >= 2


def test_every_control_has_a_name_and_is_reached_by_keys(open_page):
    page = open_page().page
    page.get_by_role("button", name="How the file is read").press("Enter")
    page.get_by_label("Column of the signal (--angle)").wait_for(timeout=PATIENCE)
    assert UNNAMED.findall(page.locator("body").aria_snapshot()) == []
    page.locator("input[type=file]").focus()
    names = []
    while "body" not in names:
        page.keyboard.press("Tab")
        names.append(page.evaluate(FOCUSED))
        assert len(names) < 60
    order = ["Or a sample record", "Column of the signal (--angle)", "From (s)", "To (s)", "Whole record"]
    places = [names.index(name) for name in [*order, "System (--system)"]]
    assert places == sorted(places)


def test_the_reader_asks_and_the_user_goes_on(open_page, tmp_path):
    file = write_table(tmp_path / "two.csv", "t,first,second", TIME, SIGNAL, linear(TIME, omega=7.0))
    shown = open_page()
    shown.drop(file)
    assert "could each be the signal" in shown.until("error")
    field_ = shown.page.get_by_label("Column of the signal (--angle)")
    field_.click()
    shown.page.get_by_text("second", exact=True).click()
    shown.until_command("backbone", "--angle second")


def hostile_files(folder):
    """Files that no reader should be asked to read, by name."""
    rows = "\n".join(f"{t:.2f},{a:.6f}" for t, a in zip(TIME, SIGNAL, strict=True))
    contents = {
        "empty.csv": b"",
        "garbage.bin": np.random.default_rng(0).bytes(200_000),
        "garbage.mat": b"MATLAB 5.0 MAT-file" + np.random.default_rng(1).bytes(50_000),
        "nan.csv": b"t,angle\n" + b"\n".join(b"%d,nan" % i for i in range(1000)),
        "bomb.csv.gz": gzip.compress(bytes(300_000_000)),
        "<img src=x onerror=alert(1)>.csv": b"no,numbers\n<script>alert(1)</script>,x\n",
        "header.csv": f"t,<img src=x onerror=alert(1)> (<b>rad</b>)\n{rows}\n".encode(),
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
        yield folder / name
    long = np.arange(0.0, 1300.0, 0.0005)
    yield write_table(folder / "long.csv", "time (s),angle (rad)", long, linear(long, zeta=0.0005))


def test_hostile_files_end_in_a_sentence_and_the_server_goes_on(open_page, server, tmp_path, swing):
    shown = open_page()
    for file in hostile_files(tmp_path):
        shown.drop(file)
        if file.name == "long.csv":
            assert file.stat().st_size > 50e6
            shown.page.wait_for_selector("pre:has-text('sysid-trib backbone long.csv')", timeout=PATIENCE)
            shown.cancel.click()
        else:
            said = shown.until("done", "error")
            assert file.name == "header.csv" or (said and "Traceback" not in said and "Internal" not in said)
        assert "Traceback" not in shown.page.locator("body").inner_text()
        assert shown.page.locator("img[onerror], script:has-text('alert(1)')").count() == 0
    shown.drop(swing)
    shown.until_command("backbone", "swing.csv")
    assert shown.complaints == []
    assert "Traceback" not in server.errors.read_text()
    with urllib.request.urlopen(server.url, timeout=60) as answer:
        assert answer.status == 200


@pytest.mark.parametrize(("origin", "status"), [("http://elsewhere.example", 403), (None, 101)])
def test_a_foreign_page_cannot_talk_to_the_app(server, origin, status):
    import http.client

    host = server.url.split("/")[2]
    with urllib.request.urlopen(server.url, timeout=60) as answer:
        token = re.search(r'"token":"([^"]+)"', answer.read().decode())[1]
    connection = http.client.HTTPConnection(host, timeout=60)
    headers = {
        **{"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"},
        **{"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Origin": origin or server.url.rstrip("/")},
        "Sec-WebSocket-Protocol": f"bokeh, {token}",
    }
    connection.request("GET", "/ws", headers=headers)
    assert connection.getresponse().status == status
    connection.close()
