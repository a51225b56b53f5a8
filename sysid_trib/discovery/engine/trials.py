"""Candidates as trials: each force or sensor effect on a grid of its shapes."""

import itertools
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.shape_parameters import (
    TURN,
    is_frequency,
    is_frequency_parameter,
    is_phase,
    is_resonance,
)
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force
from sysid_trib.forces.notation import reference_powers
from sysid_trib.simulation.internal_states import is_stepped


@dataclass(frozen=True)
class Settings:
    """Settings of `discover`; `table` lists the meaning and the source of each.

    Other numbers of the code are accuracies of arithmetic (steps of differences, ridges) or the layout of
    figures (spans, cells of the map); the named effects do not depend on them.

    Raises
    ------
    UsageError
        The level or the number of effects is impossible.
    """

    level: float = 0.01
    max_effects: int = 4
    seed: int = 0
    credible: float = 0.95
    least_gain: float = 0.1
    tolerance: float = 0.1
    family_tolerance: float = 0.5
    fitted: int = 6
    pairs: int = 20
    most_fits: int = 100
    rounds: int = 12
    shape_step: float = 0.1
    shape_values: int = 13
    combinations: int = 24
    lines: int = 3
    testable: float = 1e-3
    strongest: float = 1.0
    independent: float = 0.5
    determined: float = 30.0
    refuted: float = 2.0
    free_residual: float = 2.0
    level_rows: float = 5.0
    ratio_step: float = 1.5
    samples_per_period: int = 60
    points_per_period: int = 360

    def __post_init__(self) -> None:
        if not 0.0 < self.level < 1.0:
            raise UsageError(
                f"A level of {self.level:g} is not a probability; give one between 0 and 1, such as 0.01."
            )
        if self.max_effects < 0:
            raise UsageError(f"At most {self.max_effects} effects cannot be added; give 0 or more.")

    @property
    def outside_of_set(self) -> float:
        """Difference of evidence (-2 ln) that puts the worse of two models outside of the credible set."""
        return 2.0 * float(np.log(self.credible / (1.0 - self.credible)))

    @property
    def far(self) -> float:
        """Threshold of the evidence if as many models as are fitted compete."""
        return 2.0 * float(np.log(self.fitted / (1.0 - self.credible)))

    @staticmethod
    def table() -> list[tuple[str, str, str, str]]:
        """Name, default, meaning and source of each setting (`settings.toml`)."""
        texts = tomllib.loads(Path(__file__).with_name("settings.toml").read_text(encoding="utf-8"))
        return [(entry.name, f"{entry.default:g}", *texts[entry.name]) for entry in fields(Settings)]


DEFAULTS = Settings()

# Fraction of a range within which a shape parameter counts as at its end.
END = 1e-9
# Detunings from the swing's frequency at which a resonance is tried if the spectrum shows no line of it.
OFF_RESONANCE = (0.03, 0.08, 0.2)


@dataclass(frozen=True)
class TrialEffect:
    """A candidate with its shape parameters held (`{"dahl.s": 0.02}`).

    `added` : whether the search added it; effects of the start model are always present. `starts` : trials
    with other shapes, from which a fit starts if the fit from these shapes fails.
    """

    force: Force
    shapes: Mapping[str, float]
    added: bool = True
    starts: tuple["TrialEffect", ...] = field(default=(), compare=False)

    def value(self, name: str) -> float:
        """Return the value of a shape parameter."""
        return self.shapes[f"{self.force.symbol}.{name}"]

    def part(self, name: str) -> float:
        """Return the position of a shape parameter within its range, from 0 to 1."""
        return self.force.shape[name].position(self.value(name))

    def end(self, name: str) -> int:
        """Return -1 or 1 for a shape parameter at the low or the high end of its range, else 0."""
        part = self.part(name)
        return -1 if part <= END else 1 if part >= 1.0 - END else 0

    def stepped(self, name: str, step: float) -> "TrialEffect":
        """Return the trial with a shape changed by a step, as a fraction of its range; a phase wraps."""
        shape, part = self.force.shape[name], self.part(name) + step
        if is_phase(self.force, name):
            middle = 0.5 * (shape.low + shape.high)
            angle = float(shape.at(part)) - middle
            value = middle + float(np.remainder(angle + 0.5 * TURN, TURN)) - 0.5 * TURN
        else:
            value = float(shape.at(np.clip(part, 0.0, 1.0)))
        return replace(self, shapes={**self.shapes, f"{self.force.symbol}.{name}": value})

    def referred(self, factor: float) -> "TrialEffect":
        """Return the effect at a reference frequency higher by a factor, with shapes within their ranges."""
        powers = reference_powers(self.force)
        if powers is None or not self.shapes:
            return self
        values = self.force.shape_values(self.shapes)
        shapes = {
            f"{self.force.symbol}.{name}": float(
                np.clip(values[name] * factor ** powers[name], shape.low, shape.high)
            )
            for name, shape in self.force.shape.items()
        }
        return replace(self, shapes=shapes)


def reference_power(force: Force) -> float:
    """Return the power of the reference frequency in a coefficient, as for a force of x if unknown."""
    powers = reference_powers(force)
    return -2.0 if powers is None else powers[""]


def trials_of(
    candidates: Iterable[Force], frequencies: Sequence[float], w: float, settings: Settings = DEFAULTS
) -> list[TrialEffect]:
    """Return every candidate at a grid of its shape parameters.

    Parameters
    ----------
    candidates : iterable of Force
    frequencies : sequence of float, rad/s
        Frequencies at which resonances and forces periodic in time are tried.
    w : float, rad/s
        Reference frequency; resonances are given in units of it.
    settings : Settings
    """
    trials = []
    for force in candidates:
        grids = [_grid(force, name, frequencies, w, settings) for name in force.shape]
        pairs = zip(grids, force.shape, strict=True)
        tried = max((len(grid) for grid, name in pairs if is_frequency_parameter(force, name)), default=0)
        most = max(settings.combinations, tried * settings.shape_values)
        while np.prod([len(grid) for grid in grids], dtype=int) > most:
            longest = int(np.argmax([len(grid) for grid in grids]))
            grids[longest] = grids[longest][::2]
        for values in itertools.product(*grids):
            shapes = {f"{force.symbol}.{k}": float(v) for k, v in zip(force.shape, values, strict=True)}
            trials.append(TrialEffect(force, shapes))
    return trials


def frequencies_of(trial: TrialEffect, w: float) -> list[float]:
    """Return frequencies (rad/s) at which a force is periodic or resonates; `w` rad/s is the reference."""
    force, frequencies = trial.force, list[float]()
    for name in force.shape:
        if is_frequency_parameter(force, name):
            frequencies.append(trial.value(name) * (1.0 if is_frequency(force, name) else w))
    return frequencies


def _grid(force: Force, name: str, frequencies: Sequence[float], w: float, settings: Settings) -> Array:
    shape = force.shape[name]
    if is_frequency(force, name):
        inside = [q for q in frequencies if shape.low <= q <= shape.high]
        return np.array(inside or [shape.default])
    if is_resonance(force, name):
        inside = [q / w for q in frequencies if shape.low <= q / w <= shape.high]
        # A resonance may be too broad for a spectral line of its own, or lie within the line of the swing.
        broad = np.geomspace(shape.low, shape.high, settings.lines)
        nearby = [1.0 + side * off for off in OFF_RESONANCE for side in (-1.0, 1.0)]
        return np.sort([*inside, *broad, *(k for k in nearby if shape.low <= k <= shape.high)])
    if is_phase(force, name):
        # Do not start at an end of the range: the way to the optimum can be longest from there.
        return np.linspace(-0.5, 0.5, settings.shape_values, endpoint=False) * TURN + 0.5 * (
            shape.low + shape.high
        )
    # Use fewer values for a single frequency, because its grid is refined where needed; for states that are
    # integrated one by one, which is slow; and if there are many frequencies.
    fast = force.memoryless or is_stepped(force)
    count = settings.shape_values if fast and len(force.shape) > 1 else (settings.shape_values + 1) // 2
    if any(is_resonance(force, other) for other in force.shape):
        count = (count + 3) // 4
    return shape.at(np.linspace(0.0, 1.0, count))
