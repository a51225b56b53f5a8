"""Random decays of two or three modes, with and without a frequency that follows another mode's amplitude."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from sysid_trib.arrays import Array

RATE, COUNT, BLOW = 4096.0, 16_384, 0.05


@dataclass(frozen=True)
class RandomMode:
    """A mode whose frequency depends on its own amplitude by a law of random kind.

    Attributes
    ----------
    frequency : rad/s, at small amplitude
    damping : damping ratio, constant
    first : m, the first amplitude
    law : the relative change of the frequency at an amplitude over the first one
    """

    frequency: float
    damping: float
    first: float
    law: Callable[[Array], Array]


def laws(random: np.random.Generator) -> list[Callable[[Array], Array]]:
    """Laws of the frequency: polynomial, saturating, with a kink, and with a step."""
    slip, hardening = (random.choice([0.0, random.uniform(0.0, size)]) for size in (0.015, 0.007))
    return [
        lambda part: hardening * part**2 - slip * part,
        lambda part: -slip * part / (part + 0.2),
        lambda part: slip * np.maximum(part - 0.3, 0.0) / (0.05 + part),
        lambda part: -slip / (1.0 + np.exp(-(np.log(part) + 1.0) / 0.15)),
    ]


def random_decay(seed: int, coupling: float) -> tuple[Array, Array]:
    """Return times (s) and signals (sensor, sample) of a random beam.

    Parameters
    ----------
    seed : int
    coupling : float
        Relative change of the frequency of mode 1 by the first amplitude of mode 2, with its square.
    """
    random = np.random.default_rng([seed, 11])
    count = int(random.integers(2, 4))
    hertz = random.uniform(60.0, 120.0) * np.exp(
        np.append(0.0, np.cumsum(random.uniform(0.3, 1.5, count - 1)))
    )
    modes = []
    for frequency in 2.0 * np.pi * hertz:
        damping = np.exp(random.uniform(np.log(0.0007), np.log(0.004)))
        first = random.uniform(10.0, 60.0) / frequency**2
        modes.append(RandomMode(frequency, damping, first, laws(random)[random.integers(4)]))
    noise = np.exp(random.uniform(np.log(0.002), np.log(0.05)))
    coupling *= random.choice([-1.0, 1.0])
    time = np.arange(COUNT) / RATE
    clock = np.maximum(time - BLOW, 0.0)

    def slope(_: float, state: Array) -> Array:
        part = np.exp(state[:count])
        relative = np.array([float(mode.law(p)) for mode, p in zip(modes, part, strict=True)])
        relative[0] += coupling * part[1] ** 2
        frequency = np.array([mode.frequency for mode in modes])
        damping = np.array([mode.damping for mode in modes])
        return np.concatenate([-damping * frequency, frequency * (1.0 + relative)])

    motion = solve_ivp(
        slope, (0.0, clock[-1]), np.zeros(2 * count), rtol=1e-10, atol=1e-10, dense_output=True, max_step=0.05
    )
    level, phase = np.split(motion.sol(clock), 2)
    size = np.array([mode.first * mode.frequency**2 for mode in modes])
    waves = np.where(time >= BLOW, size[:, None] * np.exp(level) * np.sin(phase), 0.0)
    shapes = random.uniform(0.3, 1.0, (3, count)) * random.choice([-1.0, 1.0], (3, count))
    clean = shapes @ waves
    return time, clean + noise * random.standard_normal(clean.shape)
