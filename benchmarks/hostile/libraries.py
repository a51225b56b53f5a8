"""TOML as strangers write it: force libraries, systems and studies; what is sound is used."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

import sysid_trib as st
from benchmarks.hostile.pieces import EXECUTED, NUMBERS, damaged, formula, pick, plain, text, words
from sysid_trib.forces.systems import load_system

TEXTS = ("symbol", "name", "formula", "family", "meaning", "source", "kind")
TABLES = ("state", "memory", "start", "shape")
SYSTEM_KEYS = ("name", "meaning", "signal", "forces", "held", "impossible", "not_negative")


def quoted(given: str) -> str:
    """A text of TOML."""
    escaped = "".join(f"\\U{ord(c):08x}" if not c.isprintable() or c in '"\\' else c for c in plain(given))
    return f'"{escaped}"'


def value(random: np.random.Generator, depth: int = 0) -> str:
    """Any value of TOML."""
    kind = random.integers(8)
    if kind < 3:
        return str(pick(random, (*words("0 1 -1 0.5 1e308 1e400 nan -inf 2e-3"), "9" * 400, "9" * 4301)))
    if kind < 5:
        return quoted(text(random))
    if kind == 5 and depth < 3:
        return f"[{', '.join(value(random, depth + 1) for _ in range(random.integers(0, 3)))}]"
    if kind == 6 and depth < 3:
        return f"{{ {key(random)} = {value(random, depth + 1)} }}"
    rest = words("true 1979-05-27T07:32:00Z 07:32:00 0x7fffffffffffffffff 1e-320")
    return str(pick(random, (*rest, "'''\n'''")))


def key(random: np.random.Generator) -> str:
    """A key of TOML."""
    return str(pick(random, (*words("z p s x default low high mean deviation"), quoted(text(random)))))


def force(random: np.random.Generator) -> str:
    """A force, sound or nearly so."""
    entries = {name: quoted(str(pick(random, ("a", "b", "word")))) for name in TEXTS[:6]}
    entries["symbol"] = quoted(f"s{random.integers(5)}")
    entries["formula"] = quoted(formula(random))
    if random.random() < 0.6:
        entries["shape"] = "{ p = { default = 1, low = 0.1, high = 4.0, meaning = 'm' } }"
    if random.random() < 0.3:
        part = pick(random, ("state", "memory"))
        entries[str(part)] = f"{{ z = {quoted(formula(random))} }}"
        if random.random() < 0.5:
            begun = str(pick(random, ("1/0", "x", "0", EXECUTED, formula(random))))
            entries["start"] = f"{{ z = {quoted(begun)} }}"
    if random.random() < 0.1:
        entries["kind"] = '"sensor"'
    if random.random() < 0.1:
        entries["passive"] = value(random)
    if random.random() < 0.3:
        entries[str(pick(random, (*TEXTS, *TABLES, "strange")))] = value(random)
    if random.random() < 0.2:
        low, high = pick(random, NUMBERS), pick(random, NUMBERS)
        entries["shape"] = f"{{ p = {{ default = {pick(random, NUMBERS)}, low = {low}, high = {high} }} }}"
    return _table("[[force]]\n", entries)


def library(random: np.random.Generator) -> str:
    """A library of a few forces."""
    return "".join(['title = "T"\n', *(force(random) for _ in range(random.integers(1, 3)))])


def system(random: np.random.Generator) -> str:
    """A system of laboratories."""
    entries = {"name": '"own"', "forces": '["zeta", "delta"]', "held": "{ gravity = 1.0 }"}
    for _ in range(int(random.integers(0, 4))):
        entries[str(pick(random, SYSTEM_KEYS))] = value(random)
    return _table("[[system]]\n", entries)


def _table(head: str, entries: dict[str, str]) -> str:
    return head + "".join(f"{name} = {given}\n" for name, given in entries.items())


def _written(given: str, place: Path, random: np.random.Generator) -> Path:
    content = given.encode("utf-8", "replace")
    place.write_bytes(damaged(content, random) if random.random() < 0.15 else content)
    return place


def library_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A library: its signatures, its TOML again, and sometimes the motion of its forces."""
    place = _written(library(random), folder / "a.toml", random)
    moves = random.random() < 0.03

    def action() -> None:
        forces = st.load_library(place)
        for one in forces:
            if one.kind == "force":
                st.forces.signature(one, 0.3)
        assert forces.to_toml()
        if moves:
            model = st.Model(forces, dict.fromkeys(forces.symbols, 1e-3), 9.0)
            st.simulate(model, 0.02 * np.arange(50), 0.3)

    return action


def toml_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """Return the reading of a system."""
    place = _written(system(random), folder / "a.toml", random)
    return lambda: load_system(str(place))
