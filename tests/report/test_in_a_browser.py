"""Pages in a real browser: they open without an error or a request, fit narrow and wide, and print."""

import io
import re
import shutil
import subprocess

import matplotlib as mpl
import matplotlib.image as mpl_image
import numpy as np
import pytest
from headless import FLAGS, browser_path

from sysid_trib.plots.figure import new_figure
from sysid_trib.reporting.page import IMAGE_DPI, inline_svg

# A browser takes its time.
pytestmark = pytest.mark.slow
WIDTHS = (400, 1400)
KINDS = ("identify", "cross_check", "runs", "compare", "discover")
# A minute: machines that run tests are busy.
PATIENCE = 60_000.0
LOOK = (
    "body { margin: 0 } "
    "svg { width: 800px !important; max-width: none !important; height: auto; stroke-linejoin: round }"
)
FIGURES = {"identify": 0, "cross_check": 1, "runs": 0, "compare": 2, "discover": 3}
# Of each figure: its width, that of the box that it can be moved in, and the height of its letters, px.
SIZES = """[...document.querySelectorAll('figure svg')].map((svg) => [
  svg.getBoundingClientRect().width,
  svg.parentElement.getBoundingClientRect().width,
  Math.max(...[...svg.querySelectorAll('use')].map((letter) => letter.getBoundingClientRect().height)),
])"""


@pytest.fixture(scope="module")
def browser():
    found = browser_path()
    if found is None:
        pytest.skip("no chromium on this machine; install Debian's package of that name")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=found, args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture(scope="module")
def opened(browser, pages, tmp_path_factory):
    """Open a page at a width; what it complained of and asked for are in its lists."""
    folder = tmp_path_factory.mktemp("pages")

    def open_page(kind, width):
        (folder / f"{kind}.html").write_text(pages[kind], encoding="utf-8")
        shown = browser.new_page(viewport={"width": width, "height": 900})
        shown.set_default_timeout(PATIENCE)
        complaints, requests = [], []
        shown.on(
            "console",
            lambda said: complaints.append(said.text) if said.type in ("error", "warning") else None,
        )
        shown.on("pageerror", lambda error: complaints.append(str(error)))
        shown.on("request", lambda request: requests.append(request.url))
        shown.goto((folder / f"{kind}.html").as_uri())
        return shown, complaints, requests

    return open_page


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("kind", KINDS)
def test_page_opens_quietly_and_fits(opened, pages, kind, width):
    shown, complaints, requests = opened(kind, width)
    assert complaints == []
    assert len(requests) == 1
    assert requests[0].startswith("file://")
    assert shown.evaluate("document.documentElement.scrollWidth") <= width
    sizes = shown.evaluate(SIZES)
    assert len(sizes) == FIGURES[kind]
    for figure, box, letters in sizes:
        assert box <= width
        # Legible: on a narrow screen it is wider than its box, and moved sideways.
        assert letters >= 6.0
        assert figure > box or width > 1000
    shown.close()


@pytest.mark.parametrize("kind", ["cross_check", "compare", "discover"])
def test_page_prints(opened, kind, tmp_path):
    shown, _, _ = opened(kind, 1400)
    shown.pdf(path=tmp_path / "page.pdf", prefer_css_page_size=True)
    shown.close()
    printed = (tmp_path / "page.pdf").read_bytes()
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 3
    if shutil.which("pdftotext"):
        told = ["pdftotext", tmp_path / "page.pdf", "-"]
        text = subprocess.run(told, capture_output=True, text=True, check=True)
        assert "Reproduce this result" in text.stdout
        assert "zeta" in text.stdout


def test_a_shortened_figure_looks_as_matplotlib_drew_it(browser):
    """Fewer than one pixel in a thousand differs by more than a shade, at two pixels a point."""
    figure, written = drawn_figure(), io.BytesIO()
    shortened = inline_svg(figure, "a", "caption")
    with mpl.rc_context({"svg.fonttype": "path"}):
        figure.savefig(written, format="svg", dpi=IMAGE_DPI)
    shown = browser.new_page(viewport={"width": 900, "height": 700})
    pictures = []
    for svg in (shortened, written.getvalue().decode().split("?>", 1)[1]):
        shown.set_content(f"<style>{LOOK}</style>{svg}")
        pictures.append(mpl_image.imread(io.BytesIO(shown.locator("svg").screenshot()))[..., :3])
    shown.close()
    assert pictures[0].shape == pictures[1].shape
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=-1) > 0.1) < 1e-3


def drawn_figure():
    """Lines, marks, letters, cells."""
    made = new_figure(4.0, 3.0)
    lines, cells = made.subplots(1, 2)
    time = np.linspace(0.0, 1.0, 60)
    lines.errorbar(time, np.sin(9.0 * time), 0.1, fmt="o", markersize=3, label="record")
    lines.plot(time, np.cos(9.0 * time), "--", color="red", label=r"$\omega$")
    lines.fill_between(time, time, -time, alpha=0.3)
    lines.legend()
    cells.pcolormesh(np.outer(time, time)[::10, ::10], rasterized=True)
    return made
