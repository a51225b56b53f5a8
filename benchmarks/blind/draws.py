"""Experiments: frequency, amplitude, noise, length, random force, shape parameters in wide ranges."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from .effects import SENSORS, TABLES, Shapes, make
from .generator import NoDecayError, Oscillator, motion

# What is drawn evenly in its logarithm: rad/s, rad, noise over the first angle, samples a period, periods,
# RMS of what a random force adds at the end of a record in noise levels.
FREQUENCY, AMPLITUDE, NOISE = (0.3, 300.0), (0.02, 1.2), (3e-4, 1e-2)
SAMPLING, PERIODS, WANDER = (20.0, 200.0), (8.0, 200.0), (1.0, 20.0)
# Samples of all runs together.
MOST_SAMPLES = 20_000
# Share of records with one, two, ... runs, of those with a random force, of those that stop inside.
RUNS, PUSHED, STOPPING = (0.55, 0.2, 0.12, 0.13), 0.5, 0.15
# Part of its first angle to which a motion decays that does not stop.
DECAYED = (0.05, 0.7)
# Steps of the integrator, each with its own random force, in a period at least.
STEPS = 60
# Steps of an effect in one of the motion that do not depend on the amplitude.
COARSE = 3
# Effects that only take one sign: springs that pull back, contacts that lose energy.
ONE_SIGN = {
    "structural_damping", "maxwell", "resonator", "jenkins", "iwan", "dahl", "lugre", "bouc_wen",
    "bouc_wen_2", "partial_slip", "masing", "freeplay", "wall", "inertia", "ambient", "friction_bump",
    "speed_bump",
}  # fmt: skip


@dataclass(frozen=True)
class Experiment:
    """Runs of one oscillator: released from `starts` (rad), `count` samples `step` apart in tau.

    `level` is the standard deviation of the noise (rad), `growth` how the variance of v grows by a random
    force, rad^2 a unit of tau.
    """

    oscillator: Oscillator
    starts: list[float]
    step: float
    count: int
    colour: str
    weights: np.ndarray
    level: float
    wander: float
    growth: float
    stops: bool
    seed: int

    @property
    def time(self) -> np.ndarray:
        return np.arange(self.count) * self.step / self.oscillator.w

    def measured(self, effects: list[tuple[str, Shapes, float]]) -> list[np.ndarray]:
        """The angle of each run as it is measured, with effects (symbol, shapes, coefficient)."""
        return [self._run(effects, at) for at in range(len(self.starts))]

    def _run(self, effects: list[tuple[str, Shapes, float]], at: int) -> np.ndarray:
        """Simulate a run with the same impulses, noise and sensor zero for any effects."""
        pushes, sensor = (np.random.default_rng([self.seed, at, i]) for i in range(2))
        forces = [(make(symbol, p), c) for symbol, p, c in effects if symbol not in SENSORS]
        least = int(np.ceil(STEPS * self.step / (2.0 * np.pi)))
        # Lengths of hysteresis, and the steps that they ask for, are those of swings of some 0.4 rad.
        finer = [
            effect.parts if effect.parts <= COARSE else effect.parts * self.starts[0] / 0.4
            for effect, _ in forces
        ]
        parts = max([least, *(int(np.ceil(q)) for q in finer)])
        draws = pushes.standard_normal((self.count, least)) * np.sqrt(self.growth * least / self.step)
        # A force that needs finer steps is pushed by the same random force.
        kicks = np.repeat(draws, -(-parts // least), axis=1) if self.growth else None
        found = motion(self.oscillator, forces, self.starts[at], self.step, self.count, parts, kicks)
        if np.abs(found.x[self.count // 2 :]).max() > 0.97 * self.starts[at]:
            raise NoDecayError("the motion does not decay")
        angle = found.x + sensor.uniform(-0.01, 0.01) * self.starts[0]
        for symbol, _, c in effects:
            if symbol in SENSORS:
                angle += c * SENSORS[symbol](found.x, found.v, self.time)
        if self.colour == "quantised":
            # A little noise beside, as any sensor has.
            least_step = np.sqrt(12.0) * self.level
            beside = 0.2 * self.level * sensor.standard_normal(self.count)
            return np.asarray(least_step * np.round((angle + beside) / least_step))
        return np.asarray(angle + self.level * noise(sensor, self.colour, self.weights, self.count))


def _even_log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_experiment(rng: np.random.Generator, colour: str) -> Experiment:
    """An experiment with noise of this colour."""
    runs = 1 + int(rng.choice(len(RUNS), p=RUNS))
    while True:
        rate, periods = _even_log(rng, *SAMPLING), _even_log(rng, *PERIODS)
        if rate * periods * runs <= MOST_SAMPLES:
            break
    start, stops = _even_log(rng, *AMPLITUDE), bool(rng.uniform() < STOPPING)
    remaining = rng.uniform(*DECAYED)
    base = _base_forces(rng, start, float(remaining), periods, stops)
    weights = whitener(rng, colour)
    level = start * _even_log(rng, *NOISE)
    wander = _even_log(rng, *WANDER) if rng.uniform() < PUSHED else 0.0
    tau = 2.0 * np.pi * periods
    # Variance of x in an oscillator of this decay in white acceleration: growth / (4 zeta) in the end.
    decay = -np.log(remaining)
    growth = (wander * level) ** 2 * 4.0 * decay / tau / -np.expm1(-2.0 * decay)
    return Experiment(
        oscillator=Oscillator(_even_log(rng, *FREQUENCY), base),
        starts=[start, *(float(start * rng.uniform(0.5, 1.0)) for _ in range(runs - 1))],
        step=2.0 * np.pi / rate,
        count=int(periods * rate),
        colour=colour,
        weights=weights,
        level=level,
        wander=wander,
        growth=float(growth),
        stops=stops,
        seed=int(rng.integers(2**32)),
    )


def _base_forces(
    rng: np.random.Generator, start: float, remaining: float, periods: float, stops: bool
) -> dict[str, float]:
    """Friction that leaves this part of the first angle, in shares of one to three forces, and springs."""
    dissipative = [name for name in ("lambda", "zeta", "delta") if rng.uniform() < 0.6]
    dissipative = dissipative or ["zeta"]
    if stops and "lambda" not in dissipative:
        dissipative = ["lambda", *dissipative]
    shares = rng.dirichlet(np.ones(len(dissipative)))
    # Logarithmic decrement of a period, as that in the middle of the decay.
    decrement, middle = -np.log(remaining) / periods, start * np.sqrt(remaining)
    a_decrement = {"lambda": 0.25 * middle, "zeta": 0.5 / np.pi, "delta": 0.375 / middle}
    base = {
        name: float(share * decrement * a_decrement[name])
        for name, share in zip(dissipative, shares, strict=True)
    }
    if stops:
        # Dry friction alone takes four times itself a period.
        base["lambda"] = float(start * rng.uniform(1.05, 1.6) / (4.0 * periods))
    for name, power in (("nu", 1), ("epsilon", 2)):
        if rng.uniform() < 0.5:
            base[name] = float(rng.choice([-1, 1]) * rng.uniform(0.02, 0.2) / start**power)
    return base


def shapes(rng: np.random.Generator, symbol: str, start: float, w: float, duration: float) -> Shapes:
    """Shape parameters within the reach of the motion."""
    given = {"u": rng.uniform, "pick": rng.choice, "np": np, "start": start, "w": w, "duration": duration}
    drawn = eval(TABLES["shapes"].get(symbol, "{}"), given)
    return {k: float(q) for k, q in drawn.items()}


def whitener(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Filter that whitens noise of this kind, [1, ...]; of 1/f and quantised noise it is that of white."""
    if kind == "ar1":
        return np.array([1.0, -rng.uniform(0.3, 0.9)])
    if kind == "ar2":
        # A resonance anywhere above the motion's own frequency.
        radius, angle = rng.uniform(0.5, 0.9), rng.uniform(0.4, 2.5)
        return np.array([1.0, -2.0 * radius * np.cos(angle), radius**2])
    return np.ones(1)


def innovation(weights: np.ndarray) -> float:
    """Standard deviation of the innovations of noise of unit standard deviation."""
    return float(1.0 / np.linalg.norm(lfilter([1.0], weights, np.eye(1, 3000)[0])))


def noise(rng: np.random.Generator, kind: str, weights: np.ndarray, count: int) -> np.ndarray:
    """Noise of unit standard deviation."""
    if kind == "pink":
        spectrum = np.fft.rfft(rng.standard_normal(2 * count))
        spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
        spectrum[0] = 0.0
        values = np.fft.irfft(spectrum)[:count]
        return values / values.std()
    values = lfilter([1.0], weights, rng.standard_normal(count + 500))[500:]
    return innovation(weights) * values
