"""Pieces of hostile input: difficult numbers, words and texts, and damage to bytes."""

import numpy as np

TIME = 0.01 * np.arange(400)
ANGLE = 0.3 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME)
# Amplitude of records that no file may show: it stands in another file, to which hostile ones point.
SECRET = 0.7777
# What would be made if a text were executed.
MARK = "executed"
EXECUTED = f"__import__('os').system('touch {MARK}')"


def words(text: str) -> tuple[str, ...]:
    """Words between blanks."""
    return tuple(text.split())


NUMBERS = (
    *words("0 -0 1 -1 2 0.1 1e-3 1e-12 1e-320 5e-324 1.7e308 -1.7e308 1e75 1e76 1e100 1e154 1e400 -1e400"),
    *words(
        "nan inf -inf 0x10 1_000 18446744073709551616 -9223372036854775809 4294967296 2147483648 1e9 1e-9"
    ),
    *words("3.14 1/0 ² ١٢ ½ １２ +-1 --1 1e e1 . 1,5 1;2 1:2 : None true"),
    *("9" * 40, "9" * 400, "9" * 4301, ""),
)
WORDS = (
    *words("x time t angle θ acc 0 1 ² 😀 é ' ` $(true) ../../etc/passwd /dev/null /dev/zero %s%n =1+1 auto"),
    *words("<script>alert(1)</script> {{7*7}} off contact_forces candidate_effects systems pendulum lambda"),
    *words('zeta zeta,delta dahl.s rpm "'),
    *("theta (deg)", "rate (rad/s)", "angle [mm]", "a (g)", "", " ", "  " * 60, "\t", "\x00", "\x1b[31m"),
    *("\u202e", "\ud800", "\r", "\n", EXECUTED, "a" * 5000, "(" * 200, "[" * 40 + "]" * 40),
    *(" " * 1000 + "(", "-" * 300, "per " * 300, "s" * 2000),
)
TOKENS = (
    *words("x v t p z pi sign abs min max exp log sin tan sqrt tanh ( ) ( ) + - * ** / , . 1e400 0 1 2 0.5"),
    *words(
        "1e-320 __import__ lambda ² 😀 [ ' if == nan inf := ~ @ // % 1j x.y x[0] True None ... \\ # ; f''"
    ),
    *words("*x **p 𝑥 ſin ﬁ"),
    *("9" * 40, "\x00", "\n"),
)
UNARY = words("sign abs sin cos tan exp log sqrt tanh -")
BINARY = words("+ - * / ** min max")


def pick(random: np.random.Generator, items: tuple) -> object:
    """One of some items, whatever they are."""
    return items[int(random.integers(len(items)))]


def number(random: np.random.Generator) -> float:
    """A number of any size, or none."""
    kind = random.integers(6)
    if kind == 0:
        return float(pick(random, (0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324, 1.7e308, -1.7e308)))
    sign = -1.0 if random.random() < 0.3 else 1.0
    widest = 300.0 if kind == 1 else 20.0 if kind == 2 else 3.0
    return sign * float(10.0 ** random.uniform(-widest, widest))


def text(random: np.random.Generator) -> str:
    """A word, some of them, or letters of any alphabet."""
    kind = random.integers(4)
    if kind < 2:
        return str(pick(random, WORDS))
    if kind == 2:
        return "".join(str(pick(random, WORDS + NUMBERS)) for _ in range(random.integers(1, 4)))
    letters = random.integers(0, 0x110000, size=random.integers(1, 20))
    return "".join(map(chr, letters))


def plain(given: str) -> str:
    """A text that can be encoded."""
    return given.encode("utf-8", "replace").decode("utf-8")


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Some bits or bytes changed, left out, doubled, moved, or the end cut off."""
    changed = bytearray(content)
    # Headers stand at the beginning; of a long file damage elsewhere meets numbers alone.
    reach = len(changed) if random.random() < 0.5 else min(len(changed), 4096)
    for _ in range(random.integers(1, 8)):
        if not changed:
            break
        at = int(random.integers(min(reach, len(changed))))
        other, size = int(random.integers(len(changed))), int(random.integers(1, 40))
        width = int(pick(random, (1, 2, 4, 8)))
        kind = random.integers(7)
        if kind == 6 and random.random() < 0.8:
            continue
        # Where it begins and ends, and what takes its place.
        start, end, new = (
            (at, at + 1, bytes([int(random.integers(256))])),
            (at, at + size, b""),
            (at, at, changed[at : at + size]),
            (at, at + 1, bytes([changed[at] ^ 1 << int(random.integers(8))])),
            (at, at + width, bytes([int(pick(random, (0, 1, 127, 128, 255)))]) * width),
            (at, at + 16, changed[other : other + 16]),
            (at, len(changed), b""),
        )[kind]
        changed[start:end] = new
    return bytes(changed)


def formula(random: np.random.Generator, depth: int = 0) -> str:
    """A formula: words and signs in any order, or one that is well formed."""
    if depth == 0 and random.random() < 0.25:
        return "".join(str(pick(random, TOKENS)) for _ in range(random.integers(1, 14)))
    kind = random.integers(4)
    if depth > 6 or kind == 0:
        return str(pick(random, words("x v x v t p z 1 2 0.5 0 1e99 1e-99 pi")))
    if kind == 1:
        return f"{pick(random, UNARY)}({formula(random, depth + 1)})"
    sign = str(pick(random, BINARY))
    first, second = formula(random, depth + 1), formula(random, depth + 1)
    if sign in ("min", "max"):
        return f"{sign}({first}, {second})"
    if sign == "**":
        return f"({first})**{pick(random, words('2 3 0.5 -1 p 20 21 -20 0'))}"
    return f"({first}){sign}({second})"
