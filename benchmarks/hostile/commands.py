"""The command line with options and letters of any kind, in this process."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from command_line import run

from benchmarks.hostile.files import sound_files
from benchmarks.hostile.libraries import library, system
from benchmarks.hostile.pieces import NUMBERS, number, pick, text, words
from benchmarks.hostile.results import sound_results

READING = words(
    "--time --angle --signal --units --sampling-rate --time-units --window --equilibrium --decay --system "
    "--length --distance"
)
MODEL = words(
    "--library --forces --omega0 --reference-frequency --random-force --set --fix --bound --tie "
    "--json -o --csv"
)
MOTION = words("--set --library --reference-frequency --duration --sampling-rate --angle0 --rate0 --noise")
OPTIONS = {
    "look": (*READING, "--json", "--plot"),
    "identify": (*READING, *MODEL, "--latex", "--explain", "--quiet"),
    "compare": (*READING, *MODEL),
    "discover": (*READING, *MODEL, *words("--candidates --max-effects --level --time-limit --test")),
    "backbone": (*READING, *words("--json -o --csv --plot")),
    "simulate": (*MOTION, "--random-force", "--seed"),
    "report": (),
    "forces": ("--json",),
    "campaign": (*READING, *MODEL, *words("--task --conditions --scheduler --workers")),
}
SWITCHES = ("--json", "--explain", "--quiet")
VALUES = words(
    "zeta zeta,delta lambda=0 zeta=0:1 zeta=: nu=-2.356*delta nu=nu zeta=1e400 dahl.s=1 auto off 1: :2 2:1 "
    "0:4 9.0 9±0.1 9± ± 9+-10 angle rad deg s pendulum spring"
)


def _value(random: np.random.Generator, folder: Path) -> str:
    files = (folder / "own.toml", folder / "system.toml", folder / "sound.csv", folder, "-", "/dev/null")
    given = (VALUES, VALUES, NUMBERS, (repr(number(random)),), files, (text(random),))
    return str(pick(random, given[random.integers(6)]))


def arguments(random: np.random.Generator, folder: Path) -> list[str]:
    """A command with a file or two, and some options."""
    if not (folder / "sound.csv").exists():
        sound_files(folder)
    (folder / "own.toml").write_text(library(random), "utf-8", "replace")
    (folder / "system.toml").write_text(system(random), "utf-8", "replace")
    sound_results(folder)
    command = str(pick(random, tuple(OPTIONS)))
    if random.random() < 0.03:
        command = text(random)
    given: list[object] = [command]
    files = (*(folder / name for name in words("sound.csv cross_check.nc none.csv . own.toml")), text(random))
    pages = (folder / "p.html", folder, text(random))
    motions = (folder / str(pick(random, (*words("m.csv m.nc m none/m.csv"), plain_name(random)))),)
    given += {
        "report": (pick(random, files[1:]), "-o", pick(random, pages)),
        "forces": (pick(random, (folder / "own.toml", "contact_forces", "systems", text(random))),),
        "simulate": ("-o", *motions),
    }.get(command, (files[0] if random.random() < 0.8 else pick(random, files),))
    known = OPTIONS.get(command, ("--json",))
    for _ in range(int(random.integers(0 if command == "forces" else 1, 4))):
        flag = str(pick(random, known)) if known and random.random() < 0.95 else text(random)
        given.append(flag)
        if flag not in SWITCHES:
            given.append(_value(random, folder))
    # An operating system passes no such letter.
    return [str(word).replace("\0", "") for word in given]


def plain_name(random: np.random.Generator) -> str:
    """A file name as a letter may be lost in it."""
    return f"{text(random)[:40]}.nc".replace("/", "_").replace("\0", "")


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A command: it ends with 0, 1 or 2, and a complaint is one line."""
    given = arguments(random, folder)

    def action() -> None:
        ended = run(*given)
        assert ended.status in (0, 1, 2), f"status {ended.status}"
        assert "Traceback" not in ended.err, ended.err
        assert "Internal error" not in ended.err, ended.err
        assert not ended.status or len(ended.err.splitlines()) == 1, ended.err[:300]

    return action
