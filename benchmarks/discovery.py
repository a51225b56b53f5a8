"""How the time of discover grows with samples and with candidates: second calls in a process, processor time.

python benchmarks/discovery.py [--quick]

Beside each time its ratio to one direct identification of the paper's run in the same process, which
separates slow machines from slow code; below, the slopes of lines through logarithms, where 1 is linear.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from helpers import FIVE, paper_run  # noqa: E402
from stopwatch import times  # noqa: E402

from sysid_trib import ForceLibrary, discover, load_library  # noqa: E402
from sysid_trib.methods import Direct  # noqa: E402

# Samples a second, and duration (s): more of them in the same motion, and a longer motion.
RATES = ((50.0, 25.0), (100.0, 25.0), (1000.0, 25.0))
DURATIONS = ((100.0, 12.5), (100.0, 25.0), (100.0, 50.0))
CANDIDATES = (10, 20, 40)


def seconds(call: Callable[[], object], repeats: int = 1) -> float:
    """Least processor time of a call."""
    return float(np.min(times(call, repeats, process_time)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two of each only")
    most = 2 if parser.parse_args().quick else 9
    contact = load_library()
    start = contact.select(["lambda", "zeta", "delta"])
    effects = (*contact.select(["nu", "epsilon"]), *load_library("candidate_effects"))
    paper = paper_run().decay(0)
    unit = seconds(lambda: Direct().identify(paper, contact.select(FIVE)), 5)

    def time_of(rate: float, duration: float, count: int) -> float:
        record = paper_run(sampling_rate=rate, duration=duration).decay(0)
        return seconds(lambda: discover(record, start, ForceLibrary("candidates", effects[:count])))

    rows = [
        *(("candidates", 100.0, 25.0, count) for count in (*CANDIDATES, len(effects))[:most]),
        *(("rate", *pair, 40) for pair in RATES[:most]),
        *(("duration", *pair, 40) for pair in DURATIONS[:most]),
    ]
    print(f"{'grows':12}{'samples':>10}{'candidates':>12}{'time (s)':>10}{'in direct identifications':>28}")
    measured: dict[str, list[tuple[float, float]]] = {}
    for what, rate, duration, count in rows:
        spent = time_of(rate, duration, count)
        size = count if what == "candidates" else rate * duration
        measured.setdefault(what, []).append((size, spent))
        line = f"{what:12}{rate * duration:10,.0f}{count:12}{spent:10.2f}{spent / unit:28.0f}"
        print(line, flush=True)
    for what, points in measured.items():
        sizes, spent_times = np.log(np.array(points)).T
        print(f"slope with {what}: {np.polyfit(sizes, spent_times, 1)[0]:.2f}")
    print(f"one direct identification: {1e3 * unit:.0f} ms")


if __name__ == "__main__":
    main()
