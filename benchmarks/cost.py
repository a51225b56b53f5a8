"""Cost of whole processes: processor time, memory, and the longest silence.

python -m benchmarks cost [--only PART] [--samples N]

Each case is a process of its own; times are processor time of it and all it started, memory is the largest
resident size of one process. samples: the command `identify` (both methods, cross-checked) and `Direct`
alone, on decays of 100 samples a period that lose the same part of their amplitude, up to N samples. over-
imports: `identify` over the import of all modules of other packages that it loads, of the example and of a
measured pendulum (bars: 1.7 and, of 13,000 and 84,000 samples, 6 and 15). discover: peak memory of a search,
nothing or cubic damping hidden, all candidates offered. terminal: time to the first word of each command and
its longest silence, also in start-ups of a program that imports numpy, which a busy machine stretches as
well. report: size of a page with a record of N instants, and times to make and to open it.
"""

import os
import pty
import resource
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import xarray as xr

import sysid_trib as st
from benchmarks import DATA

PER_PERIOD, NOISE, W = 100, 2e-4, 9.91
# Of a decay of 500 periods; what is dissipated goes with one over the periods.
FORCES, REFERENCE_PERIODS = {"zeta": 5e-5, "delta": 2e-4, "nu": 1e-2, "epsilon": -0.1}, 500
SEARCHED = {"lambda": 1.6e-5, "zeta": 3.2e-4, "nu": -0.3, "epsilon": 0.3}
DISSIPATIVE = ("lambda", "zeta", "delta", "cubic_damping")
# Samples, periods, bar in MB of a search.
SIZES = ((5_000, 40, 500), (100_000, 40, 1500), (100_000, 1000, 1500))
# Two frames after the page is loaded the first of them is on the screen.
PAINTED = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


def spent(*arguments: str) -> tuple[float, float, float]:
    """Processor time (s), wall time (s) and largest resident size (MB) of a Python process."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{arguments} ended with {process.returncode}")
    return usage.ru_utime + usage.ru_stime, time.perf_counter() - start, usage.ru_maxrss / 1024.0


def child(*call: object) -> tuple[str, ...]:
    """Arguments of a process that calls a function of this file."""
    return ("-m", "benchmarks", "cost", "--call", *map(str, call))


def decay(place: Path, samples: int, periods: float, forces: dict[str, float], start: float) -> Path:
    """A decay of so many samples, as a file."""
    library = [*st.load_library(), *st.load_library("candidate_effects").select(["cubic_damping"])]
    scaled = {s: c * (REFERENCE_PERIODS / periods if s in DISSIPATIVE else 1.0) for s, c in forces.items()}
    at = np.arange(samples) * 2.0 * np.pi * periods / W / samples
    model = st.Model(st.forces.ForceLibrary("both", tuple(library)).select(list(forces)), scaled, W)
    noise = NOISE * np.random.default_rng(2).standard_normal(samples)
    record = xr.Dataset({"angle": st.simulate(model, at, start).angle + noise})
    record.angle.attrs["units"], record.time.attrs["units"] = "rad", "s"
    record.to_netcdf(place, engine="h5netcdf")
    return place


def direct(place: str) -> None:
    """Run the direct identification for the second pair of columns of `samples`."""
    record = st.free_decay(st.read_record(place))
    st.identify(record, st.load_library().select(FORCES), st.methods.Direct())


def search(place: str, kept: str) -> None:
    """Run `discover`; keep the memory before the search, and its outcome."""
    record = st.free_decay(st.read_record(place))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    every = st.forces.ForceLibrary("all", (*st.load_library(), *st.load_library("candidate_effects")))
    found = st.discover(record, st.load_library().select(SEARCHED), every)
    Path(kept).write_text(f"{before:.0f},{found.attrs['search_outcome']}")


def samples(folder: Path, asked: Namespace) -> pd.DataFrame:
    """Time and memory against the samples of a record."""
    rows = []
    for count in (10**power for power in range(3, len(str(asked.samples)))):
        place = str(decay(folder / f"{count}.nc", count, count / PER_PERIOD, FORCES, 0.3))
        whole = spent("-m", "sysid_trib", "identify", place, "--forces", ",".join(FORCES))
        alone = spent(*child("direct", place))
        rows.append((count, whole[0], whole[2], alone[0], alone[2]))
    heads = ["samples", "identify (s)", "memory (MB)", "Direct alone (s)", "memory of it (MB)"]
    return pd.DataFrame(rows, columns=heads)


def searches(folder: Path, asked: Namespace) -> pd.DataFrame:
    """Peak memory of discover."""
    rows = []
    for count, periods, bar in SIZES:
        for hidden in ({}, {"cubic_damping": 1.6e-3}) if count <= asked.samples else ():
            place = decay(folder / "searched.nc", count, periods, SEARCHED | hidden, 0.4)
            peak, kept = spent(*child("search", place, folder / "kept"))[2], folder / "kept"
            rows.append((count, periods, *(hidden or ["nothing"]), peak, bar, *kept.read_text().split(",")))
    heads = ["samples", "periods", "hidden", "peak (MB)", "bar", "before (MB)", "outcome"]
    return pd.DataFrame(rows, columns=heads)


def heard(command: list[str]) -> tuple[float, float, float]:
    """Run a command on a terminal: its first word, its longest silence, its whole time, s."""
    written = [time.perf_counter()]
    process, terminal = pty.fork()
    if process == 0:
        os.execvp(command[0], command)
    while True:
        try:
            if not os.read(terminal, 65536):
                break
        except OSError:  # the end of a terminal on Linux
            break
        written.append(time.perf_counter())
    os.close(terminal)
    os.waitpid(process, 0)
    since = np.array([*written, time.perf_counter()]) - written[0]
    return since[1], np.diff(since).max(), since[-1]


def terminal(folder: Path, asked: Namespace) -> pd.DataFrame:
    """First words, in an order in which each command finds what it needs."""
    long = decay(folder / "long.nc", min(asked.samples, 100_000), 160, FORCES, 0.4)
    commands = f"""forces; simulate -o {folder}/swing.csv --noise 1e-4; look {folder}/swing.csv; look {long}
        ; identify; identify {folder}/swing.csv -o {folder}/result.nc --plot {folder}/figures
        ; compare {folder}/swing.csv; discover {folder}/swing.csv --time-limit 30
        ; report {folder}/result.nc -o {folder}/report.html"""
    base = min(heard([sys.executable, "-c", "import numpy; print('ready')"])[2] for _ in range(3))
    rows = []
    for words in commands.split(";"):
        first, longest, whole = heard([sys.executable, "-m", "sysid_trib", *words.split()])
        shown = " ".join(words.split()).replace(f"{folder}/", "")
        rows.append((shown, first, first / base, longest, longest / base, whole))
    heads = ["command", "first word (s)", "(start-ups)", "longest silence (s)", "(of these)", "whole (s)"]
    return pd.DataFrame(rows, columns=heads)


def opening(page: Path) -> tuple[float, float]:
    """Times from the address to the first frame with all figures, s: on the clock, and of its main thread."""
    from headless import FLAGS, browser_path
    from playwright.sync_api import sync_playwright

    if not browser_path():
        return np.nan, np.nan
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_path(), args=list(FLAGS))
        shown = browser.new_page(viewport={"width": 1400, "height": 900})
        session = shown.context.new_cdp_session(shown)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        start = time.perf_counter()
        shown.goto(page.as_uri())
        shown.evaluate(PAINTED)
        clock = time.perf_counter() - start
        metrics = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
        browser.close()
    return clock, metrics["TaskDuration"]


def reports(folder: Path, asked: Namespace) -> pd.DataFrame:
    """Pages of the example, and of it with record and motions at N instants."""
    from helpers import lengthened

    example = st.free_decay(st.records.paper_twin())
    library = st.load_library().select(["lambda", "zeta", "delta", "nu", "epsilon"])
    pair = (st.identify(example, library, method) for method in (st.methods.Averaging(), st.methods.Direct()))
    tree, page, rows = st.cross_check(example, *pair), folder / "page.html", []
    for result in (tree, lengthened(tree, asked.samples)):
        start = time.perf_counter()
        st.report(result, page)
        made, size = time.perf_counter() - start, page.stat().st_size / 1e6
        rows.append((result["record"].sizes["time"], size, made, *opening(page)))
    heads = ["samples", "size (MB)", "made in (s)", "opened in (s)", "of the processor (s)"]
    return pd.DataFrame(rows, columns=heads)


# Imports the modules whose names a file holds; some cannot be imported by themselves.
IMPORT_ALL = """
import sys
from contextlib import suppress
from importlib import import_module
for name in open(sys.argv[1]).read().split():
    with suppress(Exception):
        import_module(name)
"""


def loaded_by(*arguments: str) -> list[str]:
    """Names of the modules of other packages that a Python process loads."""
    process = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True
    )
    lines = [line for line in process.stderr.splitlines() if line.startswith("import time:")]
    names = [line.rpartition("|")[2].strip() for line in lines]
    return [name for name in names if name.partition(".")[0] != "sysid_trib"]


def over_imports(folder: Path, asked: Namespace) -> pd.DataFrame:
    """Processor time of `identify` over that of the imports it needs, medians of five alternating pairs."""
    commands = {"the example": ("--omega0", "8.87")}
    swing = DATA / "single_pendulum" / "free_swing.csv"
    if swing.is_file():
        part = folder / "part.csv"
        table = pd.read_csv(swing)
        table[table.time_s.between(15.0, 80.0)].iloc[::5].to_csv(part, index=False)
        commands["pendulum, 13,000 samples"] = (str(part), "--system", "pendulum")
        commands["pendulum, 84,000 samples"] = (str(swing), "--system", "pendulum")
    # As Python does unless told otherwise, modules are stored in compiled form, by the first run of each.
    stored = {"PYTHONPYCACHEPREFIX": str(folder / "compiled"), "PYTHONDONTWRITEBYTECODE": ""}
    rows = []
    with mock.patch.dict(os.environ, stored):
        for name, given in commands.items():
            command = ("-m", "sysid_trib", "identify", *given)
            modules = folder / "modules.txt"
            modules.write_text("\n".join(loaded_by(*command)))
            imports = ("-c", IMPORT_ALL, str(modules))
            spent(*imports)
            pairs = np.array([(spent(*imports)[0], spent(*command)[0]) for _ in range(5)])
            ratio = np.median(pairs[:, 1] / pairs[:, 0])
            rows.append((name, *np.median(pairs, axis=0), ratio))
    return pd.DataFrame(rows, columns=["identify", "imports (s)", "command (s)", "ratio"])


PARTS = {"samples": samples, "over-imports": over_imports}
PARTS |= {"discover": searches, "terminal": terminal, "report": reports}


def cost(asked: Namespace) -> None:
    if asked.call:
        {"direct": direct, "search": search}[asked.call[0]](*asked.call[1:])
        return
    for part in (part for name, part in PARTS.items() if asked.only in name):
        with tempfile.TemporaryDirectory() as folder:
            print(part(Path(folder), asked).to_string(index=False, float_format="%.2f"), flush=True)
