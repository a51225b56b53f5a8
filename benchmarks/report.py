"""Size of a report, and times to make it and to open it in a browser without a window.

python benchmarks/report.py [--samples N]

The embedded example's identification; then the same with its record and motions at N instants (10^6), as a
faster sampling would give them. Opening is timed from the address to the first frame with all figures;
processor time is that of the page's main thread, which a busy machine does not stretch.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from headless import FLAGS, browser_path  # noqa: E402
from helpers import lengthened  # noqa: E402
from stopwatch import timed  # noqa: E402

import sysid_trib as st  # noqa: E402

# Two frames after the page is loaded the first of them is on the screen.
PAINTED = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


def example() -> xr.DataTree:
    """The embedded example, identified in two ways."""
    decay = st.free_decay(st.records.paper_twin())
    library = st.load_library().select(["lambda", "zeta", "delta", "nu", "epsilon"])
    both = (st.identify(decay, library, method) for method in (st.methods.Averaging(), st.methods.Direct()))
    return st.cross_check(decay, *both)


def opening(page: Path) -> tuple[float, float]:
    """Times to open a page, s: on the clock, and of the processor."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_path(), args=list(FLAGS))
        shown = browser.new_page(viewport={"width": 1400, "height": 900})
        session = shown.context.new_cdp_session(shown)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        _, clock = timed(lambda: (shown.goto(page.as_uri()), shown.evaluate(PAINTED)))
        metrics = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
        browser.close()
    return clock, metrics["TaskDuration"]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=1_000_000)
    samples = parser.parse_args().samples
    tree = example()
    print(" samples  size (MB)  made in (s)  opened in (s)  of the processor (s)")
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        for result in (tree, lengthened(tree, samples)):
            _, made = timed(lambda result=result: st.report(result, page))
            clock, processor = opening(page) if browser_path() else (np.nan, np.nan)
            size = page.stat().st_size / 1e6
            count = result["record"].sizes["time"]
            print(f"{count:8} {size:10.2f} {made:12.1f} {clock:14.2f} {processor:21.2f}")


if __name__ == "__main__":
    main()
