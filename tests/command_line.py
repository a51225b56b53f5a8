"""The command line run in this process: its output and exit status."""

import io
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sysid_trib import cli

TIME = np.arange(0.0, 20.0, 0.01)


@dataclass(frozen=True)
class Ending:
    """Exit status and output of a command."""

    status: int
    out: str
    err: str

    @property
    def complaint(self) -> str:
        """The only line on stderr of a command that failed and printed nothing."""
        lines = [line for line in self.err.splitlines() if line.strip()]
        assert len(lines) == 1, self.err
        assert lines[0].startswith("sysid-trib: ")
        assert "Traceback" not in self.err
        assert self.out == ""
        return lines[0]


def run(*arguments: object, encoding: str = "utf-8") -> Ending:
    """Run `sysid-trib ARGUMENTS` in this process, on terminals of this encoding."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["sysid-trib", *map(str, arguments)])
        patch.setattr(sys, "stdout", out)
        patch.setattr(sys, "stderr", err)
        patch.setattr(sys, "unraisablehook", sys.unraisablehook)
        before = signal.getsignal(signal.SIGINT)
        with pytest.raises(SystemExit) as ending:
            cli.main()
        signal.signal(signal.SIGINT, before)
    texts = [stream.buffer.getvalue().decode(encoding) for stream in (out, err)]  # type: ignore[attr-defined]
    return Ending(int(ending.value.code or 0), *texts)


def linear(time=TIME, zeta=0.01, omega=9.9, amplitude=0.3):
    return amplitude * np.exp(-zeta * omega * time) * np.cos(omega * time)


def write_table(path: Path, header: str, *columns) -> Path:
    """Write columns of numbers below their header."""
    rows = (",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def write_csv(path: Path, time=TIME, angle=None, header="time (s),angle (rad)") -> Path:
    """Write a record; without an angle, of a decay with a little noise."""
    if angle is None:
        angle = linear(time) + 1e-4 * np.random.default_rng(1).standard_normal(len(time))
    return write_table(path, header, time, angle)
