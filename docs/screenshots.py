"""Take the pictures of docs/app.md: start the app, use it in a browser, and store what it shows.

`python docs/screenshots.py` needs chromium and the packages of `.[dev]`.
"""

import io
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

import sysid_trib as st

PICTURES = Path(__file__).parent / "pictures"
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
# Milliseconds.
PATIENCE = 300_000
MOST_COLOURS = 64


def write_swing(path: Path) -> None:
    """Write a simulated pendulum with some rest before its release."""
    time = np.arange(0.0, 40.0, 0.02)
    library, _ = st.system("pendulum")
    model = st.Model(library, {"zeta": 0.002, "delta": 0.03, "gravity": 1.0}, 5.2)
    swing = st.simulate(model, time, angle=0.6).angle.values
    angle = np.concatenate([np.full(250, swing[0]), swing])
    angle += 5e-4 * np.random.default_rng(0).standard_normal(angle.size)
    table = np.column_stack([np.arange(angle.size) * 0.02, angle])
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header="time (s),angle (rad)", comments="")


def store(data: bytes, name: str) -> None:
    """Store a picture with few colours."""
    picture = Image.open(io.BytesIO(data)).convert("RGB").quantize(MOST_COLOURS, dither=Image.Dither.NONE)
    picture.save(PICTURES / name, optimize=True)
    print(f"{PICTURES / name}: {(PICTURES / name).stat().st_size / 1000:.0f} kB")


def take(page: Any, swing: Path) -> None:
    """Use the page, and store a picture of each step."""

    def at(heading: str) -> bytes:
        place = page.get_by_role("heading", name=heading, exact=True)
        place.wait_for(timeout=PATIENCE)
        place.evaluate("element => element.scrollIntoView()")
        page.evaluate("window.scrollBy(0, -80)")
        page.wait_for_timeout(500)
        return page.screenshot()

    page.locator("input[type=file]").set_input_files(swing)
    page.wait_for_selector("#status.done", timeout=PATIENCE)
    page.evaluate("window.scrollTo(0, 0)")
    page.wait_for_timeout(500)
    store(page.screenshot(), "app_record.png")
    frame = page.locator(".bk-Figure").bounding_box()
    low, high = (frame["x"] + part * frame["width"] for part in (0.35, 0.85))
    page.mouse.move(low, frame["y"] + 100)
    page.mouse.down()
    page.mouse.move(high, frame["y"] + 100, steps=10)
    store(page.screenshot(clip={"x": 0, "y": 0, "width": 1280, "height": 620}), "app_window.png")
    page.mouse.up()
    page.wait_for_selector("#status.busy", timeout=PATIENCE)
    page.wait_for_selector("#status.done", timeout=PATIENCE)
    store(at("Coefficients and residual"), "app_coefficients.png")
    store(at("Friction and restoring force"), "app_laws.png")


def main() -> None:
    """Start the app and a browser, and take the pictures."""
    found = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chromium-browser"))), None)
    command = [sys.executable, "-m", "sysid_trib", "app", "--no-browser"]
    with tempfile.TemporaryDirectory() as folder, subprocess.Popen(command, stdout=subprocess.PIPE) as app:
        write_swing(Path(folder) / "swing.csv")
        try:
            address = re.search(r"http://\S+", app.stdout.readline().decode())[0]  # type: ignore
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=found, args=FLAGS)
                page = browser.new_page(viewport={"width": 1280, "height": 900})
                page.goto(address)
                page.get_by_label("From (s)").wait_for(timeout=PATIENCE)
                take(page, Path(folder) / "swing.csv")
                browser.close()
        finally:
            app.send_signal(signal.SIGINT)


if __name__ == "__main__":
    main()
