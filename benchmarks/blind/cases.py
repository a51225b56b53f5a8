"""Cases: which effects are hidden in a record, and how strong."""

from dataclasses import dataclass, field

import numpy as np

from sysid_trib.errors import DecayError

from .draws import ONE_SIGN, Experiment, draw_experiment, shapes
from .effects import FORCES, SENSORS, STRANGERS, Shapes, family, names
from .generator import NoDecayError
from .seen import as_seen, base_model, gained, in_range, left_by_two, offered, resolution, trial_of, true_fit

HIDDEN = [*FORCES, *SENSORS]
# Shares of the kinds of record.
KINDS = {
    "nothing white": 0.12,
    "nothing coloured": 0.12,
    "nothing quantised": 0.12,
    "effect 8-12": 0.1,
    "effect 12-20": 0.1,
    "effect >20": 0.1,
    "strong": 0.1,
    "left out": 0.08,
    "outside": 0.06,
    "two": 0.06,
    "three": 0.04,
}
# z of output error at which effects are drawn, evenly in its logarithm, and the least and the largest z
# beside both noises: coefficients are scaled until the least of a record's effects is between.
DRAWN_Z = {
    "effect 8-12": (9.0, 12.0),
    "effect 12-20": (13.0, 20.0),
    "effect >20": (25.0, 500.0),
    "left out": (150.0, 3000.0),
    "outside": (150.0, 3000.0),
    "two": (30.0, 200.0),
    "three": (30.0, 200.0),
}
LEAST_Z = {"effect 8-12": 8.0, "effect 12-20": 12.0, "two": 10.0, "three": 10.0, "strong": 8.0}
LEAST_ELSE = 20.0
MOST_Z = {"effect 8-12": 12.0, "effect 12-20": 20.0}
SCALINGS = 5
COLOURS = ("ar1", "ar2", "pink")
# Force of a strong effect over the restoring force (RMS); none is stronger.
STRONG = (0.1, 1.0 / 3.0)
# A number that goes through the kinds in their shares, whatever part of the set is run.
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
ATTEMPTS = 40


@dataclass(frozen=True)
class HiddenEffect:
    """An effect, and z as the truth's fit has it."""

    symbol: str
    family: str
    coefficient: float
    shapes: Shapes
    relative_force: float
    z: float


@dataclass(frozen=True)
class Drawn:
    """The angle of each run as measured, and the answers."""

    kind: str
    experiment: Experiment
    angles: list[np.ndarray]
    hidden: list[HiddenEffect] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    # z that the best one, and the best two, of the candidates that are left leave of the truth.
    left_by_others: list[float] = field(default_factory=list)


def kind_of(number: int) -> str:
    ends = np.cumsum([*KINDS.values()])
    return [*KINDS][int(np.searchsorted(ends, (0.5 + GOLDEN * number) % 1.0 * ends[-1], side="right"))]


def draw_case(salt: str, number: int) -> Drawn:
    """The record of this number; the same for the same salt."""
    rng = np.random.default_rng([number, *salt.encode()])
    kind = kind_of(number)
    for _ in range(ATTEMPTS):
        try:
            found = _attempt(rng, kind)
        except (NoDecayError, DecayError, OverflowError):
            # The motion does not decay, or is no record that anybody would have tested.
            continue
        if found is not None:
            return found
    raise NoDecayError(f"{kind} {number}: none in {ATTEMPTS} attempts")


def _attempt(rng: np.random.Generator, kind: str) -> Drawn | None:
    experiment = draw_experiment(rng, _colour(rng, kind))
    plain = experiment.measured([])
    seen = as_seen(experiment.time, plain)
    if kind.startswith("nothing"):
        return Drawn(kind, experiment, plain)
    base = base_model(seen, list(experiment.oscillator.base))
    drawn = _effects(rng, kind, experiment)
    if not all(in_range(symbol, p) for symbol, p in drawn):
        return None
    trials = [trial_of(symbol, p) for symbol, p in drawn]
    errors, sizes = resolution(base, trials)
    target = float(np.exp(rng.uniform(*np.log(DRAWN_Z.get(kind, STRONG)))))
    # Of several effects all have about the same z.
    coefficients = _signs(rng, [s for s, _ in drawn]) * (
        target / sizes if kind == "strong" else target * errors
    )
    if not np.all(np.isfinite(coefficients)):
        return None
    for _ in range(SCALINGS):
        if np.any(np.abs(coefficients) * sizes > STRONG[1]):
            return None
        effects = [(symbol, p, c) for (symbol, p), c in zip(drawn, coefficients.tolist(), strict=True)]
        angles = experiment.measured(effects)
        base = base_model(as_seen(experiment.time, angles), list(experiment.oscillator.base))
        full = true_fit(base, list(zip(trials, coefficients.tolist(), strict=True)))
        zs = gained(base, full)
        low, high = LEAST_Z.get(kind, LEAST_ELSE), MOST_Z.get(kind, np.inf)
        if low <= min(zs) <= high:
            break
        if kind == "strong":
            return None
        # What the random force takes the blame for is not gained: z falls short of that of output error.
        aim = np.sqrt(low * min(high, 2.0 * low))
        coefficients = coefficients * np.clip(aim / max(min(zs), 0.1), 0.25, 4.0)
    else:
        return None
    hidden = [
        HiddenEffect(symbol, family(symbol), c, p, abs(c) * float(size), z)
        for (symbol, p, c), size, z in zip(effects, sizes, zs, strict=True)
    ]
    if kind not in ("left out", "outside"):
        return Drawn(kind, experiment, angles, hidden)
    left_out = sorted(names(hidden[0].symbol)) if kind == "left out" else []
    others = offered(list(experiment.oscillator.base), left_out).forces
    return Drawn(kind, experiment, angles, hidden, left_out, left_by_two(full, hidden[0].symbol, others))


def _colour(rng: np.random.Generator, kind: str) -> str:
    """White in seven of ten records with an effect."""
    name = kind.split()[-1] if kind.startswith("nothing") else ""
    if not name:
        name = str(rng.choice(["white", "coloured", "quantised"], p=[0.7, 0.2, 0.1]))
    return str(rng.choice(COLOURS)) if name == "coloured" else name


def _effects(rng: np.random.Generator, kind: str, experiment: Experiment) -> list[tuple[str, Shapes]]:
    """Effects that the model does not have, no two of the same family."""
    every = [*STRANGERS] if kind == "outside" else [s for s in HIDDEN if s not in experiment.oscillator.base]
    count = {"two": 2, "three": 3}.get(kind, 1)
    while True:
        chosen = [str(s) for s in rng.choice(every, count, replace=False)]
        if len({family(s) for s in chosen}) == count:
            break
    start, w, duration = experiment.starts[0], experiment.oscillator.w, float(experiment.time[-1])
    return [(symbol, shapes(rng, symbol, start, w, duration)) for symbol in chosen]


def _signs(rng: np.random.Generator, symbols: list[str]) -> np.ndarray:
    return np.array([1.0 if symbol in ONE_SIGN or rng.uniform() < 0.5 else -1.0 for symbol in symbols])
