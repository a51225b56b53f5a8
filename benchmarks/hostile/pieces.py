"""What hostile input is made of: numbers, words and texts that programs trip over, and damage to bytes."""

import numpy as np

TIME = 0.01 * np.arange(400)
ANGLE = 0.3 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME)
# Amplitude of records that no file may show: it stands in another file, to which hostile ones point.
SECRET = 0.7777
# What would be made if a text were executed.
MARK = "executed"
EXECUTED = f"__import__('os').system('touch {MARK}')"
NUMBERS = (
    *(
        "0",
        "-0",
        "1",
        "-1",
        "2",
        "0.1",
        "1e-3",
        "1e-12",
        "1e-320",
        "5e-324",
        "1.7e308",
        "-1.7e308",
        "1e75",
        "1e76",
    ),
    *(
        "1e100",
        "1e154",
        "1e400",
        "-1e400",
        "nan",
        "inf",
        "-inf",
        "9" * 40,
        "9" * 400,
        "9" * 4301,
        "0x10",
        "1_000",
    ),
    *(
        "18446744073709551616",
        "-9223372036854775809",
        "4294967296",
        "2147483648",
        "1e9",
        "1e-9",
        "3.14",
        "1/0",
    ),
    *("²", "١٢", "½", "１２", "+-1", "--1", "1e", "e1", ".", "", "1,5", "1;2", "1:2", ":", "None", "true"),
)
WORDS = (
    *(
        "x",
        "time",
        "t",
        "angle",
        "theta (deg)",
        "θ",
        "rate (rad/s)",
        "angle [mm]",
        "a (g)",
        "acc",
        "0",
        "1",
        "²",
    ),
    *(
        "",
        " ",
        "  " * 60,
        "\t",
        "\x00",
        "\x1b[31m",
        "😀",
        "\u202e",
        "\ud800",
        "é",
        "\r",
        "\n",
        "'",
        '"',
        "`",
        "$(true)",
    ),
    *(
        "../../etc/passwd",
        "/dev/null",
        "/dev/zero",
        "<script>alert(1)</script>",
        "{{7*7}}",
        "%s%n",
        "=1+1",
        EXECUTED,
    ),
    *(
        "a" * 5000,
        "(" * 200,
        "[" * 40 + "]" * 40,
        " " * 1000 + "(",
        "-" * 300,
        "per " * 300,
        "s" * 2000,
        "auto",
        "off",
    ),
    *(
        "contact_forces",
        "candidate_effects",
        "systems",
        "pendulum",
        "lambda",
        "zeta",
        "zeta,delta",
        "dahl.s",
        "rpm",
    ),
)
TOKENS = (
    *("x", "v", "t", "p", "z", "pi", "sign", "abs", "min", "max", "exp", "log", "sin", "tan", "sqrt", "tanh"),
    *(
        "(",
        ")",
        "(",
        ")",
        "+",
        "-",
        "*",
        "**",
        "/",
        ",",
        ".",
        "9" * 40,
        "1e400",
        "0",
        "1",
        "2",
        "0.5",
        "1e-320",
    ),
    *(
        "__import__",
        "lambda",
        "²",
        "\x00",
        "😀",
        "[",
        "'",
        "if",
        "==",
        "nan",
        "inf",
        ":=",
        "~",
        "@",
        "//",
        "%",
        "1j",
    ),
    *("x.y", "x[0]", "True", "None", "...", "\\", "#", "\n", ";", "f''", "*x", "**p", "𝑥", "ſin", "ﬁ"),
)
UNARY = ("sign", "abs", "sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "-")
BINARY = ("+", "-", "*", "/", "**", "min", "max")


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


def plain(words: str) -> str:
    """A text that can be encoded."""
    return words.encode("utf-8", "replace").decode("utf-8")


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Some bits or bytes changed, left out, doubled, moved, or the end cut off."""
    changed = bytearray(content)
    # Headers stand at the beginning; of a long file damage elsewhere meets numbers alone.
    reach = len(changed) if random.random() < 0.5 else min(len(changed), 4096)
    for _ in range(random.integers(1, 8)):
        if not changed:
            break
        at = int(random.integers(min(reach, len(changed))))
        kind = random.integers(7)
        if kind == 0:
            changed[at] = int(random.integers(256))
        elif kind == 1:
            del changed[at : at + int(random.integers(1, 40))]
        elif kind == 2:
            changed[at:at] = changed[at : at + int(random.integers(1, 40))]
        elif kind == 3:
            changed[at] ^= 1 << int(random.integers(8))
        elif kind == 4:
            width = int(pick(random, (1, 2, 4, 8)))
            changed[at : at + width] = bytes([int(pick(random, (0, 1, 127, 128, 255)))]) * width
        elif kind == 5:
            other = int(random.integers(len(changed)))
            changed[at : at + 16] = changed[other : other + 16]
        elif random.random() < 0.2:
            del changed[at:]
    return bytes(changed)


def formula(random: np.random.Generator, depth: int = 0) -> str:
    """A formula: words and signs in any order, or one that is well formed."""
    if depth == 0 and random.random() < 0.25:
        return "".join(str(pick(random, TOKENS)) for _ in range(random.integers(1, 14)))
    kind = random.integers(4)
    if depth > 6 or kind == 0:
        return str(
            pick(random, ("x", "v", "x", "v", "t", "p", "z", "1", "2", "0.5", "0", "1e99", "1e-99", "pi"))
        )
    if kind == 1:
        return f"{pick(random, UNARY)}({formula(random, depth + 1)})"
    sign = str(pick(random, BINARY))
    first, second = formula(random, depth + 1), formula(random, depth + 1)
    if sign in ("min", "max"):
        return f"{sign}({first}, {second})"
    if sign == "**":
        return f"({first})**{pick(random, ('2', '3', '0.5', '-1', 'p', '20', '21', '-20', '0'))}"
    return f"({first}){sign}({second})"
