"""What a command shows on a terminal, and when: time to its first word, longest silence, whole time.

python benchmarks/first_word.py

Each command runs on a pseudo terminal. Times are also multiples of the start-up of a program that imports
numpy, which a busy or slow machine stretches as well.
"""

import os
import pty
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

SAMPLES = 100_000
BASE = [sys.executable, "-c", "import numpy; print('ready')"]


@dataclass(frozen=True)
class Heard:
    """Times of a command, s."""

    first_word: float
    longest_silence: float
    whole: float


def heard(command: list[str]) -> Heard:
    """Run a command on a terminal and note when it writes."""
    begin = time.perf_counter()
    process, terminal = pty.fork()
    if process == 0:
        os.execvp(command[0], command)
    written = [begin]
    while True:
        try:
            if not os.read(terminal, 65536):
                break
        except OSError:  # the end of a terminal on Linux
            break
        written.append(time.perf_counter())
    os.close(terminal)
    os.waitpid(process, 0)
    end = time.perf_counter()
    silences = [after - before for before, after in zip(written, [*written[1:], end], strict=True)]
    return Heard((written[1] if len(written) > 1 else end) - begin, max(silences), end - begin)


def long_record(path: Path) -> None:
    """A record of 10^5 samples."""
    import numpy as np

    at = np.arange(SAMPLES) / 1000.0
    angle = 0.4 * np.exp(-0.01 * at) * np.cos(8.0 * at)
    angle += 1e-4 * np.random.default_rng(0).standard_normal(SAMPLES)
    table = np.column_stack([at, angle])
    np.savetxt(path, table, "%.6f", ",", header="time (s),angle (rad)", comments="")


def commands(folder: Path) -> list[list[str]]:
    """The commands, in an order in which each finds what it needs."""
    swing, long, result = folder / "swing.csv", folder / "long.csv", folder / "result.nc"
    long_record(long)
    return [
        ["forces"],
        ["simulate", "-o", f"{swing}", "--noise", "1e-4"],
        ["look", f"{swing}"],
        ["look", f"{long}"],
        ["identify"],
        ["identify", f"{swing}", "-o", f"{result}", "--plot", f"{folder / 'figures'}"],
        ["compare", f"{swing}"],
        ["discover", f"{swing}", "--time-limit", "30"],
        ["report", f"{result}", "-o", f"{folder / 'report.html'}"],
    ]


def after_start_up(path: Path) -> float:
    """Time of `look` in a process that has imported all it needs, s."""
    script = (
        "import sys, time, contextlib\n"
        "from sysid_trib import cli\n"
        f"sys.argv = ['sysid-trib', 'look', {str(path)!r}]\n"
        "for _ in range(2):\n"
        "    begin = time.perf_counter()\n"
        "    with contextlib.suppress(SystemExit):\n"
        "        cli.main()\n"
        "print(time.perf_counter() - begin)\n"
    )
    made = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return float(made.stdout.splitlines()[-1])


def main() -> None:
    base = min(heard(BASE).whole for _ in range(3))
    print(
        f"start-up of numpy {base:.2f} s; first word and longest silence in s (and in start-ups); whole in s"
    )
    with tempfile.TemporaryDirectory() as folder:
        for words in commands(Path(folder)):
            times = heard([sys.executable, "-m", "sysid_trib", *words])
            shown = " ".join(word.replace(f"{folder}/", "") for word in words)
            first, longest = (f"{t:.2f} ({t / base:.1f})" for t in (times.first_word, times.longest_silence))
            print(f"{shown:<72} {first:>12} {longest:>12} {times.whole:8.1f}", flush=True)
        seconds = after_start_up(Path(folder) / "long.csv")
        print(f"look on {SAMPLES} samples, after start-up: {seconds:.2f} s")


if __name__ == "__main__":
    main()
