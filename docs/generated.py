"""The parts of the documentation that are made while it is built, so that they cannot go stale.

A page asks for one by a line `<!-- generated: NAME ARGUMENTS -->`, NAME one of `PARTS`; what comes in its
place is Markdown. Where the page itself holds what a command prints, in a block ```console below `$ COMMAND`,

    python docs/generated.py [PAGE ...]

writes it anew, and `tests/test_docs.py` holds it against the program. Measured records are read from the
folder in SYSID_TRIB_DATA; what needs one that is not there stays as it is.
"""

import atexit
import contextlib
import inspect
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import numpy as np
import xarray as xr
from typer.testing import CliRunner

import sysid_trib as st
from sysid_trib.commands.app import app
from sysid_trib.cycles.signatures import signatures_of
from sysid_trib.datasets.registry import certified_rows, registry
from sysid_trib.discovery.engine.trials import Settings
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods import METHODS
from sysid_trib.printing.looked import signature_text
from sysid_trib.validation.separability import exactly_dependent, without_signature

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("SYSID_TRIB_DATA", ROOT.parent / "shared" / "data"))
if DATA.is_dir():
    os.environ.setdefault("SYSID_TRIB_DATA", str(DATA))
MEASURED = (
    "single_pendulum/free_swing.csv",
    "string_pendulum/run_1.txt",
    "roll_decay/model_test_21337.csv",
    "silverbox/multisine_1_to_6.csv",
    *(f"friction_frame/s_b_{load}g_{side}.mat" for load in (250, 350, 550) for side in "xy"),
    "emps/DATA_EMPS.mat",
)
PLACE = re.compile(r"^<!-- generated: (.+?) -->$", re.MULTILINE)
CONSOLE = re.compile(r"^```console\n\$ sysid-trib (.+?)\n(.*?)```$", re.MULTILINE | re.DOTALL)
# Head of a column that is not kept.
TIME = "  time (s)"
# What the page of files calls a result with inputs.
DRIVEN = "identify of a driven record"
# Amplitudes (rad) between which signatures are compared.
LOW, HIGH = 0.02, 0.5


def expand(text: str) -> str:
    """The page with every part in its place."""
    return PLACE.sub(lambda place: _part(*shlex.split(place[1])), text)


def refreshed(text: str) -> str:
    """The page with what each command prints today in the block below its line."""
    return CONSOLE.sub(
        lambda place: f"```console\n$ sysid-trib {place[1]}\n{_today(place[1], place[2].rstrip())}\n```", text
    )


def _today(command: str, before: str) -> str:
    words = shlex.split(command)
    pairs = zip(["", *words], words, strict=False)
    records = [word for flag, word in pairs if flag != "-o" and word.endswith((".csv", ".mat", ".txt"))]
    return without_times(printed(*words)) if all((_folder() / name).exists() for name in records) else before


def without_times(text: str) -> str:
    """What a command prints, without the times that methods take: those of each run are others."""
    lines, column = [], slice(0)
    for line in text.splitlines():
        if column.stop and line:
            line = f"{line[: column.start]}{'…':>{len(TIME)}}{line[column.stop :]}".rstrip()
        else:
            start = line.find(TIME)
            column = slice(start, start + len(TIME)) if start >= 0 else slice(0)
        lines.append(line)
    return "\n".join(lines)


def _part(name: str, *arguments: str) -> str:
    return PARTS[name](*arguments)


@lru_cache
def _folder() -> Path:
    """Where commands run, one folder for all pages, with links to the measured records."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    for record in filter(Path.exists, (DATA / name for name in MEASURED)):
        (Path(folder.name) / record.name).symlink_to(record)
    _blow(Path(folder.name))
    return Path(folder.name)


def _blow(folder: Path) -> None:
    """Write `blow.csv`: accelerometers after a hammer blow, two modes of which the first is not linear."""
    rate, blow = 4000.0, 0.05
    time = np.arange(12_000) / rate
    after = np.maximum(time - blow, 0.0)
    # a' = -(r + s a) a has this solution: damping and frequency go with the amplitude.
    rate_of_decay, by_amplitude, first = 0.75, 0.03, 50.0
    fall = np.exp(-rate_of_decay * after)
    amplitude = rate_of_decay * first * fall / (rate_of_decay + by_amplitude * first * (1.0 - fall))
    phase = 2.0 * np.pi * (80.0 * after - 0.005 * np.cumsum(amplitude) / rate)
    struck = time >= blow
    second = 25.0 * np.exp(-2.3 * after) * np.sin(2.0 * np.pi * 298.0 * after)
    modes = np.array([amplitude * np.sin(phase), second])
    shapes = np.array([[0.35, 0.9], [1.0, -0.2], [-0.8, 0.7]])
    noise = 0.01 * np.random.default_rng(0).standard_normal((3, time.size))
    table = np.column_stack([time, *(shapes @ (modes * struck) + noise)])
    head = "time (s),acc1 (m/s^2),acc2 (m/s^2),acc3 (m/s^2)"
    np.savetxt(folder / "blow.csv", table, "%.7g", ",", header=head, comments="")


def printed(*words: str) -> str:
    """What a command prints."""
    with contextlib.chdir(_folder()):
        ending = CliRunner().invoke(app, words, catch_exceptions=False, prog_name="sysid-trib")
    if ending.exit_code:
        raise RuntimeError(f"{shlex.join(words)}: {ending.output}")
    return "\n".join(line.rstrip() for line in ending.stdout.splitlines())


def commands() -> str:
    """Every command with its options, from the command line itself."""
    text = subprocess.run(
        [sys.executable, "-m", "typer", "sysid_trib.commands.app", "utils", "docs", "--name", "sysid-trib"],
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    ).stdout
    # The page has a title of its own, and its contents list the commands.
    text = (
        text[text.index("## ") :]
        .replace("**Usage**:\n\n", "")
        .replace("* `--help`: Show this message and exit.\n", "")
    )
    return text.replace("[[RECORD]...]...", "[RECORD]...").replace(" <list[Path]>`", "`")


def forces(name: str) -> str:
    """The forces of a library by family: what is declared, and what follows from the formula."""
    library = st.load_library(name)
    unseen = without_signature(_everything(), HIGH, None)
    signatures = signatures_of(library)
    lines = []
    for family in dict.fromkeys(force.family for force in library):
        lines += [f"## {family[0].upper()}{family[1:]}", ""]
        for force in (f for f in library if f.family == family):
            lines += _force(force, signatures.sel(force=force.symbol), unseen)
    return "\n".join(lines)


def _force(force: Force, signature: xr.Dataset, unseen: tuple[str, ...]) -> list[str]:
    title = f"### `{force.symbol}`: {force.name}"
    meaning = f"{force.meaning[0].upper()}{force.meaning[1:]}. *{force.source}*"
    points = [f"Formula `{force.formula.text}`"]
    for word, table in (("State", force.state), ("Memory", force.memory), ("Start", force.start)):
        points += [f"{word} {_equation(word, k, f.text)}" for k, f in table.items()]
    points += [
        f"Shape `{k}` = {s.default:g}, between {s.low:g} and {s.high:g}: {s.meaning}"
        for k, s in force.shape.items()
    ]
    if force.kind == "sensor":
        points.append("An error of the sensor: the measured angle is x + coefficient * formula")
    else:
        kind = f"{force.parity.capitalize()}, {force.character} type"
        points.append(f"{kind}; takes power from the motion: {signature.power.item()}")
        points += _signature(force, signature, unseen)
    if force.units != "1":
        points.append(f"Unit of the coefficient: {force.units}")
    return [title, "", "$$", force.latex, "$$", "", meaning, "", *(f"- {point}" for point in points), ""]


def _equation(word: str, name: str, formula: str) -> str:
    derivative = (
        f"d{name}/d(w t)" if word == "State" else f"{name} after a reversal" if word == "Memory" else name
    )
    return f"{derivative} = `{formula}`"


def _signature(force: Force, signature: xr.Dataset, unseen: tuple[str, ...]) -> list[str]:
    if force.symbol in unseen:
        return ["Signature: none at first order, so that averaging does not identify it"]
    sine, cosine = signature_text(force, signature)
    points = [f"Signature: ⟨h sin φ⟩ = {sine}; ⟨h cos φ⟩ = {cosine}"]
    groups = [[s for s in group if s != force.symbol] for group in _tie_classes() if force.symbol in group]
    if groups:
        points.append(f"Averaging cannot separate it from {'; nor from '.join(map(_listed, groups))}")
    return points


@lru_cache
def _everything() -> ForceLibrary:
    """Both libraries as one."""
    six, candidates = st.load_library("contact_forces"), st.load_library("candidate_effects")
    return ForceLibrary("all", (*six, *(f for f in candidates if f.symbol not in six.symbols)))


@lru_cache
def _tie_classes() -> list[tuple[str, ...]]:
    return st.forces.indistinguishable(_everything(), LOW, HIGH)


def ties() -> str:
    """Which forces averaging cannot tell apart, and which no method can."""
    groups = [f"- {_listed(group)}" for group in _tie_classes()]
    exact = [f"- {_listed(group)}" for group in exactly_dependent(_everything(), HIGH)]
    none = _listed(without_signature(_everything(), HIGH, None))
    return "\n".join(
        [
            f"Between {LOW} and {HIGH} rad, shape parameters at their defaults, averaging cannot separate",
            "",
            *groups,
            "",
            f"and does not identify {none}. Whatever the method, these cannot be separated:",
            "",
            *(exact or ["- none"]),
        ]
    )


def _listed(symbols: Iterable[str]) -> str:
    return ", ".join(f"`{symbol}`" for symbol in symbols)


def api(module: str) -> str:
    """The reference of a module's public names from their docstrings."""
    public = import_module(module)
    return _directives(module, [n for n in public.__all__ if not inspect.ismodule(getattr(public, n))])


def _directives(module: str, names: list[str]) -> str:
    lines = ["```{eval-rst}", f".. py:currentmodule:: {module}", ""]
    for name in names:
        kind = "class" if inspect.isclass(getattr(import_module(module), name)) else "function"
        lines.append(f".. auto{kind}:: {module}.{name}")
        lines += ["   :members:", ""] if kind == "class" else [""]
    return "\n".join([*lines, "```", ""])


@lru_cache
def small_results() -> dict[str, xr.DataTree]:
    """A result of each command, of a short synthetic record, to show what is in it."""
    six = st.load_library("contact_forces")
    model = st.Model(six, {"zeta": 0.01, "delta": 0.05, "epsilon": 0.3}, 10.0)
    time = np.arange(0.0, 12.0, 0.02)
    record = st.simulate(model, time, 0.4)
    record["angle"] = record.angle + 1e-4 * np.random.default_rng(1).standard_normal(time.size)
    record.angle.attrs = {"units": "rad", "long_name": "angle"}
    decay = st.free_decay(record.drop_vars(set(record.data_vars) - {"angle"}))
    start, candidates = six.select(["zeta", "delta"]), six.select(["nu", "epsilon"])
    methods = (st.methods.Averaging(), st.methods.Direct())
    identified = (method.identify(decay, start) for method in methods)
    return {
        "identify": st.cross_check(decay, *identified),
        "compare": st.compare(decay, start, methods),
        "discover": st.discover(decay, start, candidates, max_effects=1),
        "laws": st.laws(decay),
        DRIVEN: driven_result(time),
    }


def driven_result(time: np.ndarray) -> xr.DataTree:
    """A result of `identify` of a short synthetic record with an input."""
    known = [*st.load_library("inputs").select(["gain"]), *st.load_library("contact_forces").select(["zeta"])]
    library = replace(st.load_library("inputs"), forces=tuple(known))
    model = st.Model(library, {"gain": 0.1, "zeta": 0.02}, 10.0)
    record = st.simulate(model, time, 0.1, inputs={"u": np.sin(7.0 * time) + np.sin(11.0 * time)})
    record["angle"] = record.angle + 1e-4 * np.random.default_rng(2).standard_normal(time.size)
    return st.identify(record.assign_attrs(source="driven"), library)


def results() -> str:
    """Groups, variables, dimensions, units and attributes of each command's result."""
    lines = []
    shown: dict[tuple[str, ...], str] = {}
    for command, tree in small_results().items():
        lines += [f"### Result of {command}", ""]
        for group, node in tree.children.items():
            variables = node.to_dataset().variables
            lines += [f"#### `{group}`", ""]
            if before := shown.get(names := tuple(map(str, variables))):
                lines += [f"The same variables as {before}.", ""]
                continue
            shown[names] = f"`{group}` of {command}"
            lines += ["| variable | over | unit | what |", "| --- | --- | --- | --- |"]
            lines += [
                f"| `{name}` | {', '.join(map(str, v.dims)) or 'one number'} | "
                f"{v.attrs.get('units', '')} | {v.attrs.get('long_name', '')} |"
                for name, v in variables.items()
            ]
            lines += ["", f"Attributes: {_listed(node.attrs)}." if node.attrs else "", ""]
    return "\n".join(lines)


def methods() -> str:
    """What each method observes, identifies, takes and assumes, as it says itself."""
    lines = [
        "| | observes | identifies | several runs | shape parameters | assumes |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind in METHODS:
        scope, options = kind().scope, {option.name for option in fields(kind)}
        shapes = "fits or holds" if "fit_shapes" in options else "holds" if "shapes" in options else "no"
        several = "yes" if scope.several_runs else "no"
        cells = (
            f"`methods.{kind.__name__}`",
            scope.observes,
            scope.identifies,
            several,
            shapes,
            scope.assumes,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def settings() -> str:
    """Every setting of `discover`: its value, what it decides, and the source of its default."""
    rows = [f"| `{name}` | {' | '.join(words)} |" for name, *words in Settings.table()]
    head = ["| setting | value | what it decides | derivation or source |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *rows])


def datasets() -> str:
    """The public records: title, kind, licence, source and citation, as the registry has them."""
    head = ["| RECORD | what | kind | licence | source, citation |", "| --- | --- | --- | --- | --- |"]
    fetched = (record for record in registry().values() if record.kind != "certified")
    rows = [
        f"| `dataset:{one.name}` | {one.title}. {one.known} | {one.kind} | {one.licence} | "
        f"[{one.repository}]({one.source}): {one.citation} |"
        for one in fetched
    ]
    return "\n".join([*head, *rows])


def certified() -> str:
    """The certified decays: title, unknowns, equation and sampling, one row for the three noises."""
    head = ["| decay | what | equation | start, sampling |", "| --- | --- | --- | --- |"]
    rows = {}
    for name, row in certified_rows().items():
        start = f"{float(row['start_angle']):g} rad, {float(row['start_rate']):g} rad/s"
        sampling = f"{float(row['duration']):g} s at {float(row['sampling_rate']):g} Hz"
        given = f"; w = {row['w_given']} rad/s given" if row["w_given"] else ""
        short, title = name.rpartition("_")[0], row["title"].rpartition(",")[0]
        rows[short] = f"| `{short}` | {title} | `{row['equation']}` | {start}; {sampling}{given} |"
    return "\n".join([*head, *rows.values()])


PARTS: dict[str, Callable[..., str]] = {
    part.__name__: part
    for part in (api, certified, commands, datasets, forces, methods, results, settings, ties)
}


def main() -> None:
    """Write anew what commands print on the pages named, or on all."""
    named = [Path(name).resolve() for name in sys.argv[1:]]
    for page in named or [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))]:
        before = page.read_text(encoding="utf-8")
        if (after := refreshed(before)) != before:
            page.write_text(after, encoding="utf-8")
            print(f"{page.name}: written anew")


if __name__ == "__main__":
    main()
