"""How cost grows: with the samples of a record, with the records of a campaign, with workers; and the start.

python benchmarks/scaling.py [--only samples|records|workers|start] [--samples N] [--records N]

Each case is a process of its own; times are processor time of it and all it started, memory is the largest
resident size of one process. samples: the command `identify` (both methods, cross-checked) and `Direct`
alone, on decays of 100 samples a period that lose the same part of their amplitude, up to N samples. records:
a campaign of `Direct` over simulated runs of the paper's experiment in one process, up to N records. workers:
the same 200 records by this process and by one and two workers. start: the first commands of a process, and
what compiled equations of motion cost when they are compiled and when they are read back.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

import sysid_trib as st

PER_PERIOD, NOISE, W = 100, 2e-4, 9.91
# Of a decay of 500 periods; what is dissipated goes with one over the periods.
FORCES, REFERENCE_PERIODS = {"zeta": 5e-5, "delta": 2e-4, "nu": 1e-2, "epsilon": -0.1}, 500
DISSIPATIVE = ("zeta", "delta")
WORKER_RECORDS = 200


@dataclass(frozen=True)
class Spent:
    """Processor time (s), wall time (s) and largest resident size (MB) of a process that ended well."""

    processor: float
    wall: float
    memory: float


def spent(*arguments: str) -> Spent:
    """What a Python process takes."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{arguments} ended with {process.returncode}")
    return Spent(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024.0)


def decay(folder: Path, samples: int) -> Path:
    """A decay of so many samples, as a file."""
    periods = samples / PER_PERIOD
    scaled = {
        symbol: value * (REFERENCE_PERIODS / periods if symbol in DISSIPATIVE else 1.0)
        for symbol, value in FORCES.items()
    }
    at = np.arange(samples) * 2.0 * np.pi / W / PER_PERIOD
    angle = st.simulate(st.Model(st.load_library("contact_forces").select(FORCES), scaled, W), at, 0.3).angle
    record = xr.Dataset({"angle": angle + NOISE * np.random.default_rng(2).standard_normal(samples)})
    record.angle.attrs["units"], record.time.attrs["units"] = "rad", "s"
    place = folder / f"{samples}.nc"
    record.to_netcdf(place, engine="h5netcdf")
    return place


def samples_table(folder: Path, most: int) -> Table:
    """Time and memory against the samples of a record."""
    columns = ("identify (s)", "memory (MB)", "Direct alone (s)", "memory (MB)")
    table = Table("samples", *columns, title="samples of a record")
    for count in powers(1_000, most):
        place = str(decay(folder, count))
        whole = spent("-m", "sysid_trib", "identify", place, "--forces", ",".join(FORCES))
        direct = spent(__file__, "--direct", place)
        cells = (f"{each.processor:.1f} {each.memory:.0f}".split() for each in (whole, direct))
        table.add_row(f"{count:,}", *(cell for pair in cells for cell in pair))
    return table


def direct_alone(place: str) -> None:
    """What the second column of `samples_table` measures."""
    record = st.free_decay(st.read_record(place))
    st.identify(record, st.load_library("contact_forces").select(FORCES), st.methods.Direct())


def campaign(place: str, output: str, workers: int) -> None:
    """What `records_table` and `workers_table` measure."""
    from campaign import task

    st.campaign(st.campaigns.load_study(place), task("direct"), output=output, workers=workers)


def records_table(folder: Path, most: int) -> Table:
    """Time and memory against the records of a campaign."""
    from campaign import study

    table = Table("records", "s", "ms a record", "memory (MB)", title="records of a campaign, one process")
    for count in powers(1, most):
        place = str(study(folder, count))
        taken = spent(__file__, "--campaign", place, str(folder / f"r{count}.zarr"), "0")
        each = 1e3 * taken.processor / count
        table.add_row(f"{count:,}", f"{taken.processor:.1f}", f"{each:.0f}", f"{taken.memory:.0f}")
    return table


def workers_table(folder: Path) -> Table:
    """Time and memory against workers; processor time beyond that of one process is what workers cost."""
    from campaign import study

    title = f"workers, {WORKER_RECORDS} records"
    table = Table("workers", "processor time (s)", "wall time (s)", "largest process (MB)", title=title)
    place = str(study(folder, WORKER_RECORDS))
    for workers in (0, 1, 2):
        taken = spent(__file__, "--campaign", place, str(folder / f"w{workers}.zarr"), str(workers))
        figures = (f"{taken.processor:.1f}", f"{taken.wall:.1f}", f"{taken.memory:.0f}")
        table.add_row(str(workers or "this process"), *figures)
    return table


def start_table() -> Table:
    """What a process takes before it computes."""
    table = Table("first", "processor time (s)", title="start")
    imported = "import sysid_trib"
    simulated = "; ".join(
        (
            "import numpy as np, sysid_trib as st",
            "model = st.Model(st.load_library('contact_forces'), {'zeta': 0.01}, 10.0)",
            "st.simulate(model, np.linspace(0.0, 10.0, 1001))",
        )
    )
    commands = {
        "sysid-trib --help": ("-m", "sysid_trib", "--help"),
        "import sysid_trib": ("-c", imported),
        "import numba": ("-c", "import numba"),
        "one simulation": ("-c", simulated),
    }
    for name, command in commands.items():
        table.add_row(name, f"{min(spent(*command).processor for _ in range(3)):.2f}")
    return table


def powers(least: int, most: int) -> list[int]:
    """Powers of ten from one number to another."""
    return [10**exponent for exponent in range(len(str(least)) - 1, len(str(most)))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", choices=("samples", "records", "workers", "start"))
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--records", type=int, default=1_000)
    parser.add_argument("--direct", help=argparse.SUPPRESS)
    parser.add_argument("--campaign", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.direct:
        direct_alone(options.direct)
        return
    if options.campaign:
        place, output, workers = options.campaign
        campaign(place, output, int(workers))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = {
            "start": start_table,
            "samples": lambda: samples_table(folder, options.samples),
            "records": lambda: records_table(folder, options.records),
            "workers": lambda: workers_table(folder),
        }
        for part, table in parts.items():
            if options.only in (None, part):
                Console(width=120).print(table())


if __name__ == "__main__":
    main()
