"""A case: runs with hidden effects of known strength, and the answers."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize

from .draws import NOISE, ONE_SIGN, grid, innovation, noise, oscillator, shapes, whitener
from .effects import FORCES, SENSORS, Shapes, family, make
from .generator import NoDecayError
from .sight import SMALL, Glance, Setting, Sight, beside

# A second run is released from this part of the first angle.
SECOND = 0.6
# A stronger force is no missing effect but another oscillator.
STRONGEST = 0.3
# A candidate that explains all but this part of the truth's z competes with it: nine tenths of chi-square.
COMPETING = 0.3
# Shapes of candidates that explain all but this part are searched, in so many responses a shape.
NEAR = 0.7
SEARCHED = 7
FAR = 1e6
# A state that takes more steps than these in one of the motion follows at once, as another candidate does.
QUICKEST = 100
# So small a z is not seen.
UNSEEN = 4.0
HIDDEN = [*FORCES, *SENSORS]


class UnseenError(Exception):
    """An effect that no admissible strength makes visible in this record."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: coefficient, shapes, nominal z."""

    symbol: str
    family: str
    coefficient: float
    shapes: Shapes
    z: float


@dataclass
class Case:
    """Runs (time, angle) to be read, the last one held out; what is offered; the truth."""

    kind: str
    setting: Setting
    runs: list[tuple[np.ndarray, np.ndarray]]
    hidden: list[Hidden]
    # RMS of the noise of the run held out (rad).
    noise: float
    left_out: list[str] = field(default_factory=list)
    # z of the truth that the best one (two) of the candidates would not explain.
    beyond: list[float] = field(default_factory=list)


def draw_setting(rng: np.random.Generator, colour: str, runs: int) -> Setting:
    """An oscillator whose amplitude falls to between 3 and 60 %."""
    while True:
        start = float(rng.uniform(0.2, 0.6))
        periods = rng.uniform(40.0, 60.0)
        rate = rng.uniform(50.0, min(120.0, 3500.0 / periods))
        step, count = 2.0 * np.pi / rate, int(periods * rate)
        weights = whitener(rng, colour)
        setting = Setting(
            oscillator(rng, start),
            [start, SECOND * start][:runs],
            step,
            count,
            colour,
            weights,
            NOISE * start * innovation(weights),
        )
        if all(_decays(setting, [], s) for s in setting.released):
            return setting


def draw(
    kind: str, number: int, symbols: list[str], z: float, *, sign: float = 1.0, colour: str, runs: int = 1
) -> Case:
    """A case with these effects hidden, each with a nominal z about as given."""
    rng = np.random.default_rng([number, *kind.encode()])
    for _ in range(12):
        setting = draw_setting(rng, colour, runs)
        free = [s for s in symbols if s not in setting.oscillator.base]
        if len(free) < len(symbols):
            continue
        sight = Sight(setting)
        hidden = _hidden(rng, sight, symbols, z, sign)
        effects = [(one.symbol, one.shapes, one.coefficient) for one in hidden]
        if not _admissible(setting, effects):
            continue
        measured = [_measured(rng, setting, effects, start) for start in setting.released]
        runs_read = [(setting.time, angle) for angle, _ in measured]
        case = Case(kind, setting, runs_read, hidden, noise=measured[-1][1])
        if kind.startswith(("left out", "outside")):
            _leave_out(case)
        return case
    raise UnseenError(f"{kind} {number}: {symbols} at z = {z:.0f}")


def _hidden(
    rng: np.random.Generator, sight: Sight, symbols: list[str], z: float, sign: float
) -> list[Hidden]:
    """Effects scaled so that each is seen with this z beside the unknowns and the others."""
    setting = sight.setting
    drawn = [(s, shapes(rng, s, setting.starts[0], setting.oscillator.w, setting.time[-1])) for s in symbols]
    outside = [sight.response(s, p)[1] for s, p in drawn]
    found = []
    for i, (symbol, p) in enumerate(drawn):
        others = [u for j, u in enumerate(outside) if j != i]
        size = float(np.linalg.norm(beside(outside[i], others)))
        way = 1.0 if symbol in ONE_SIGN else sign
        found.append(Hidden(symbol, family(symbol), way * z / max(size, 1e-9), p, way * z))
    return found


def _admissible(setting: Setting, effects: list[tuple[str, Shapes, float]]) -> bool:
    """Whether the effects are weak beside the spring, and the motion with them still decays."""
    x = setting.starts[0]
    for symbol, p, c in effects:
        if symbol in SENSORS:
            seen, true = setting.run([(symbol, p, SMALL)], x), setting.run([], x)
            size = np.abs(seen.x - true.x).max() / SMALL
        else:
            push = make(symbol, p).push
            size = max(
                abs(push(q * x, r * x, 1.0, 1.0, setting.time[-1], [x, x]))
                for q, r in ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.45, 0.9), (0.9, 0.45))
            )
        if abs(c) * size > STRONGEST * x:
            return False
    return all(_decays(setting, effects, start) for start in setting.released)


def _decays(setting: Setting, effects: list[tuple[str, Shapes, float]], start: float) -> bool:
    try:
        x = setting.run(effects, start).x
    except (NoDecayError, OverflowError):
        return False
    last = x[-int(2.0 * np.pi / setting.step) :]
    return bool(0.03 < np.ptp(last) / (2.0 * start) < 0.6)


def _measured(
    rng: np.random.Generator, setting: Setting, effects: list[tuple[str, Shapes, float]], start: float
) -> tuple[np.ndarray, float]:
    """A run as it is measured, and the RMS of its noise."""
    level, zero = NOISE * setting.starts[0], rng.uniform(-0.01, 0.01) * start
    true = setting.run(effects, start).x + zero
    if setting.colour == "quantised":
        # A little noise beside, as any sensor has.
        least = np.sqrt(12.0) * level
        angle = least * np.round((true + 0.2 * level * rng.standard_normal(len(true))) / least)
    else:
        angle = true + level * noise(rng, setting.colour, setting.weights, len(true))
    return angle, float(np.sqrt(np.mean((angle - true) ** 2)))


def _leave_out(case: Case) -> None:
    """Take the truth and what competes with it from the library; z that the best others do not explain."""
    truth, fine = case.hidden[0], case.setting
    # Every other sample shows as much, if its noise counts as much less.
    setting = replace(fine, step=2.0 * fine.step, count=fine.count // 2, level=fine.level / np.sqrt(2.0))
    sight = Glance(setting)
    y = truth.coefficient * sight.response(truth.symbol, truth.shapes)[1]
    # A line at a frequency of its own stands in for nothing else.
    others = {*HIDDEN} - {*setting.oscillator.base, truth.symbol, "ambient"}
    limit = max(UNSEEN, COMPETING * abs(truth.z))
    unexplained = {symbol: _unexplained_by(symbol, sight, y, limit) for symbol in sorted(others)}
    while True:
        stay = sorted((rest, s) for s, (rest, _) in unexplained.items() if s not in case.left_out)
        # Any two of them: a combination that explains all that can be seen competes as well.
        pairs = [
            (float(np.linalg.norm(beside(y, [unexplained[first][1], unexplained[second][1]]))), first)
            for (_, first), (_, second) in itertools.combinations(stay, 2)
        ]
        case.beyond = [stay[0][0], min(pairs)[0]]
        if not case.kind.startswith("left out"):
            return
        near = [s for rest, s in stay if rest < limit] or [s for rest, s in [min(pairs)] if rest < UNSEEN]
        if not near:
            case.left_out = [truth.symbol, *case.left_out]
            return
        case.left_out = [*case.left_out, *near]


def _unexplained_by(symbol: str, sight: Sight, y: np.ndarray, limit: float) -> tuple[float, np.ndarray]:
    """The least part of a response that a candidate does not explain, over its shapes, and its own response.

    The search ends where it is known to compete.
    """
    start, w = sight.setting.starts[0], sight.setting.oscillator.w
    tried: list[tuple[float, np.ndarray, Shapes]] = []

    def rest(p: Shapes) -> float:
        try:
            if symbol not in SENSORS and make(symbol, p).parts > QUICKEST:
                return np.inf
            u = sight.response(symbol, p)[1]
        except (NoDecayError, OverflowError):
            return np.inf
        norm = float(np.linalg.norm(beside(y, [u]))) if np.linalg.norm(u) > 0.0 else np.inf
        tried.append((norm, u, p))
        return norm

    for p in grid(symbol, start, w):
        rest(p)
    least, u, p = min(tried, key=lambda one: one[0], default=(np.inf, y, {}))
    if p and limit < least < NEAR * np.linalg.norm(y):
        names = list(p)
        minimize(
            lambda logs: min(rest(dict(zip(names, np.exp(logs).tolist(), strict=True))), FAR),
            np.log([p[k] for k in names]),
            method="Nelder-Mead",
            options={"maxfev": SEARCHED * len(names), "initial_simplex": _simplex(np.log([*p.values()]))},
        )
        least, u, _ = min(tried, key=lambda one: one[0])
    return least, u


def _simplex(middle: np.ndarray) -> np.ndarray:
    """A start of the search in the logarithms of shapes: a fifth of each."""
    return np.concatenate([middle[None], middle + 0.2 * np.eye(len(middle))])
