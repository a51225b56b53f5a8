"""Pages in a real browser: they open without an error or a request, fit narrow and wide, and print."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from headless import FLAGS, IDLE, browser_path

# A browser takes its time.
pytestmark = pytest.mark.slow
WIDTHS = (400, 1400)
KINDS = ("identify", "cross_check", "runs", "compare", "discover")
# A minute: machines that run tests are busy.
PATIENCE = 60_000.0
# How many different colours each canvas has.
COLOURS = """() => {
  const found = [];
  const look = (node) => {
    for (const one of node.querySelectorAll('*')) {
      if (one.tagName === 'CANVAS' && one.width > 100 && one.height > 100) found.push(one);
      if (one.shadowRoot) look(one.shadowRoot);
    }
  };
  look(document);
  return found.map((canvas) => {
    const image = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return new Set(new Uint32Array(image.data.buffer)).size;
  });
}"""


def figures_of(page):
    return len(re.findall(r"<div id=[^>]*data-root-id=", page))


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
        if figures_of(pages[kind]):
            shown.wait_for_function(IDLE)
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
    # Axes, text and marks with their smooth edges; an empty canvas, as those above the figures, has one.
    drawn = [count for count in shown.evaluate(COLOURS) if count > 20]
    assert len(drawn) == figures_of(pages[kind])
    shown.close()


def test_zoom_into_the_record_goes_with_the_residual(opened):
    shown, _, _ = opened("cross_check", 1400)
    ends = "[...Bokeh.documents[0].roots()].slice(0, 2).map((f) => [f.x_range.start, f.x_range.end])"
    shown.evaluate("Bokeh.documents[0].roots()[0].x_range.setv({start: 2, end: 5})")
    np.testing.assert_array_equal(shown.evaluate(ends), [[2, 5], [2, 5]])
    shown.close()


@pytest.mark.parametrize("kind", ["cross_check", "compare", "discover"])
def test_page_prints(opened, kind, tmp_path):
    shown, _, _ = opened(kind, 1400)
    shown.pdf(path=tmp_path / "page.pdf", prefer_css_page_size=True)
    images = shown.locator(".paper img").count()
    shown.close()
    printed = (tmp_path / "page.pdf").read_bytes()
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 3
    assert len(re.findall(rb"/Subtype\s*/Image\b", printed)) >= images
    if shutil.which("pdftotext"):
        told = ["pdftotext", tmp_path / "page.pdf", "-"]
        text = subprocess.run(told, capture_output=True, text=True, check=True)
        assert "How to make it again" in text.stdout
        assert "zeta" in text.stdout


def test_without_scripts_figures_that_do_not_move_are_there(browser, pages, tmp_path):
    (tmp_path / "page.html").write_text(pages["cross_check"], encoding="utf-8")
    context = browser.new_context(java_script_enabled=False)
    shown = context.new_page()
    shown.goto((tmp_path / "page.html").as_uri())
    assert shown.locator(".paper img").first.is_visible()
    assert not shown.locator(".panels").first.is_visible()
    context.close()
