"""What a record shows of an effect beside what its model's own unknowns can move."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from .effects import SENSORS, Shapes, make
from .first_order import Deviations
from .generator import Motion, Oscillator, motion

# The run that is predicted is released from this part of the first angle.
HELD_OUT = 0.8
# Coefficient at which an effect is still linear.
SMALL = 1e-7


@dataclass
class Setting:
    """What a case is drawn from: the oscillator, its runs, and how the noise is whitened."""

    oscillator: Oscillator
    starts: list[float]
    step: float
    count: int
    colour: str
    weights: np.ndarray
    level: float

    @property
    def time(self) -> np.ndarray:
        return np.arange(self.count) * self.step / self.oscillator.w

    @property
    def released(self) -> list[float]:
        """Angles of all runs, that held out last."""
        return [*self.starts, HELD_OUT * self.starts[0]]

    def run(
        self,
        symbols: list[tuple[str, Shapes, float]],
        start: float,
        parts: int | None = None,
        **changed: float,
    ) -> Motion:
        """The run from `start` with these effects; `changed` adds to base coefficients."""
        base = self.oscillator.base
        moved = Oscillator(self.oscillator.w, base | {k: base.get(k, 0.0) + q for k, q in changed.items()})
        active = [(make(s, p), c) for s, p, c in symbols if s not in SENSORS]
        found = motion(moved, active, start, self.step, self.count, parts)
        x = found.x.copy()
        for symbol, _, c in symbols:
            if symbol in SENSORS:
                x += c * SENSORS[symbol](found.x, found.v, self.time)
        return Motion(x, found.v)

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        return lfilter(self.weights, [1.0], columns, axis=0) / self.level


class Sight:
    """What a record shows of an effect beside its model's own unknowns, by finite differences."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.known: dict[tuple[float, int], np.ndarray] = {}
        self.plain = [setting.run([], start) for start in setting.starts]
        blocks = [self._unknowns(i) for i in range(len(setting.starts))]
        shared = np.concatenate([shared for shared, _ in blocks])
        own = [
            np.concatenate([o if i == j else np.zeros_like(o) for j, (_, o) in enumerate(blocks)])
            for i in range(len(blocks))
        ]
        table = np.concatenate([shared, *own], axis=1)
        self.space, _ = np.linalg.qr(table / np.linalg.norm(table, axis=0))

    def _unknowns(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by base coefficients and w, and by start angle, start rate and offset, of one run."""
        setting, start, plain = self.setting, self.setting.starts[i], self.plain[i]
        size = {"lambda": 1e-8 * start, "zeta": 1e-8, "delta": 1e-7, "nu": 1e-7, "epsilon": 1e-6}
        shared = [
            (setting.run([], start, **{k: size[k]}).x - plain.x) / size[k] for k in setting.oscillator.base
        ]
        # tau = w t and the start rate shifts the time.
        shared.append(plain.v * setting.time)
        by_start = (setting.run([], start * (1 + 1e-7)).x - plain.x) / (start * 1e-7)
        own = [by_start, plain.v, np.ones(setting.count)]
        return setting.whitened(np.stack(shared, axis=1)), setting.whitened(np.stack(own, axis=1))

    def _without(self, start: float, parts: int) -> np.ndarray:
        if (start, parts) not in self.known:
            self.known[start, parts] = self.setting.run([], start, parts).x
        return self.known[start, parts]

    def response(self, symbol: str, p: Shapes) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of all runs by the coefficient, whitened: whole, and outside of the unknowns."""
        found = []
        # In the same steps: small effects are differences of motions that are alike in their errors too.
        parts = 1 if symbol in SENSORS else make(symbol, p).parts
        for start in self.setting.starts:
            moved = self.setting.run([(symbol, p, SMALL)], start, parts).x - self._without(start, parts)
            found.append(self.setting.whitened(moved[:, None])[:, 0] / SMALL)
        return self._outside(found)

    def _outside(self, found: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Whitened derivatives of all runs: whole, and outside of the unknowns."""
        whole = np.concatenate(found)
        return whole, whole - self.space @ (self.space.T @ whole)


class Glance(Sight):
    """The same, quicker: forces to first order."""

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        oscillator, step, count = setting.oscillator, setting.step, setting.count
        self.near = [Deviations(oscillator, start, step, count) for start in setting.starts]

    def response(self, symbol: str, p: Shapes) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of all runs by the coefficient, whitened: whole, and outside of the unknowns."""
        if symbol in SENSORS:
            return super().response(symbol, p)
        moved = [one.by_force(make(symbol, p)) for one in self.near]
        return self._outside([self.setting.whitened(one[:, None])[:, 0] for one in moved])


def beside(u: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """The part of a response outside of those of others."""
    if not others:
        return u
    basis, _ = np.linalg.qr(np.stack(others, axis=1))
    return np.asarray(u - basis @ (basis.T @ u))
