"""Which cases the study runs: deterministic, so that a stopped study goes on where it was."""

from dataclasses import dataclass

import numpy as np

from .cases import HIDDEN, Case, draw
from .effects import STRANGERS

# Classes of strength, by nominal z.
STRENGTHS = {"8-20": (9.0, 20.0), "20-60": (20.0, 60.0), "60-300": (60.0, 300.0), ">300": (300.0, 1000.0)}
# Steps through the list of effects, so that a part of the study sees all families; coprime to its length.
STRIDE = 11
COLOURS = ("ar1", "ar2", "pink")
# Pairs are of one of each, so that both can be told apart.
FIRST = ("cubic_damping", "stribeck", "van_der_pol", "damping_drift", "jenkins", "tilted_friction")
SECOND = ("quintic", "even_drag", "stiffness_drift", "sensor_cubic", "freeplay", "ambient", "even_spring")


@dataclass(frozen=True)
class Planned:
    """One case of the study."""

    kind: str
    number: int

    @property
    def key(self) -> str:
        return f"{self.kind}/{self.number}"

    def draw(self) -> Case:
        """The case, drawn anew from its number alone."""
        kind, n = self.kind, self.number
        runs = 1 + n % 2
        rng = np.random.default_rng([n, *self.key.encode()])
        if kind.startswith("nothing"):
            name = kind.split()[1]
            colour = COLOURS[n // 2 % len(COLOURS)] if name == "coloured" else name
            return draw(kind, n, [], 0.0, colour=colour, runs=runs)
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        if kind == "two":
            pair = [FIRST[n % len(FIRST)], SECOND[n % len(SECOND)]]
            z = float(np.exp(rng.uniform(np.log(30.0), np.log(200.0))))
            return draw(kind, n, pair, z, sign=sign, colour="white", runs=runs)
        if kind.startswith("left out"):
            z = float(kind.split()[-1])
            symbol = HIDDEN[(STRIDE * n + 3) % len(HIDDEN)]
            return draw(kind, n, [symbol], z, sign=sign, colour="white", runs=runs)
        if kind.startswith("outside"):
            z = float(kind.split()[-1])
            return draw(
                kind, n, [list(STRANGERS)[n % len(STRANGERS)]], z, sign=sign, colour="white", runs=runs
            )
        low, high = STRENGTHS[kind.split()[1]]
        z = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        colour = "white" if rng.uniform() < 0.7 else str(rng.choice([*COLOURS[:2], "quantised"]))
        symbol = HIDDEN[(STRIDE * n) % len(HIDDEN)]
        return draw(kind, n, [symbol], z, sign=sign, colour=colour, runs=runs)


# Records of each class in the whole study.
FULL = {
    "nothing white": 200,
    "nothing coloured": 150,
    "nothing quantised": 50,
    **{f"effect {name}": 2 * len(HIDDEN) for name in ("8-20", "20-60", "60-300")},
    "effect >300": len(HIDDEN),
    "left out 20": 40,
    "left out 60": 40,
    "left out 200": 40,
    "outside 60": 21,
    "outside 200": 21,
    "two": 70,
}


def planned(only: str, most: int | None) -> list[Planned]:
    """Cases of the classes whose name holds `only`, at most so many of each.

    Mixed in the proportions of the whole, so that a study that is stopped has seen something of every class.
    """
    counts = {kind: min(count, most or count) for kind, count in FULL.items() if only in kind}
    found = [((n + 0.5) / count, Planned(kind, n)) for kind, count in counts.items() for n in range(count)]
    return [one for _, one in sorted(found, key=lambda pair: pair[0])]
