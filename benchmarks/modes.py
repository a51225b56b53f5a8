"""Several modes in one decay: a jointed beam after a hammer blow, whose truth is known.

python -m benchmarks modes [--seeds N] [--only look|beam|close|kinds|coupling]

look   the modes of a record of 65,536 samples and three sensors: errors of the frequencies, processor time
beam   how often the simultaneous 95 % bands of mode 1 hold the truth from 0.1 s after the blow on
close  the same of two modes whose frequencies are 10 to 3 % apart, of three sensors and of one
kinds  the same of the first mode of other beams: frequencies, shapes, a trigger, an offset, mains hum
coupling   how often it is said that the frequency of a mode follows the amplitude of another one
judged     what `discover` says of a mode whose forces are all in its start model, and if one is missing

The modes are made by averaged equations: a' = -zeta(a) w(a) a and phase' = w(a), with the laws of the beam of
`../shared/data/hammer_beam`: w^2 = w0^2 (1 - c a + 3/4 e a^2), and the damping ratio of its decay.
"""

import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import sysid_trib as st
from benchmarks.coupled_modes import random_decay
from benchmarks.study.common import over_seeds, shown, timed
from sysid_trib.arrays import Array
from sysid_trib.cycles.backbone import half_width

W0, Z0, LARGEST = 2.0 * np.pi * 80.0, 0.0015, 2.3986e-4
SLIP, HARDENING = 0.020958, 0.014644
SHAPES = np.array([[0.35, 0.90, -0.60, 0.80], [1.00, -0.20, 0.50, 0.40], [-0.80, 0.70, 0.90, -0.50]])
NOISE, OFFSET = np.array([0.020, 0.008, 0.012]), np.array([0.006, -0.003, 0.010])
# Frequency (Hz), damping ratio and first acceleration (m/s^2) of the linear modes of the beam.
LINEAR = ((298.0, 0.0012, 41.0), (600.0, 0.0009, 38.0), (1527.0, 0.0007, 58.0))
FROM_BLOW = 0.1


@dataclass(frozen=True)
class Law:
    """A mode whose frequency and damping ratio depend on its displacement amplitude.

    Attributes
    ----------
    frequency : rad/s, at small amplitude
    damping : at small amplitude
    scale : m, the amplitude at which slip and hardening are `slip` and `hardening`
    """

    frequency: float = W0
    damping: float = Z0
    scale: float = LARGEST
    slip: float = SLIP
    hardening: float = HARDENING

    def w(self, a: Array) -> Array:
        part = a / self.scale
        return self.frequency * np.sqrt(1.0 - self.slip * part + 0.75 * self.hardening * part**2)

    def zeta(self, a: Array) -> Array:
        """The damping ratio of the decay."""
        part, w = a / self.scale, self.w(a)
        lost = self.damping * self.frequency * w
        lost = lost + 2.0 / (3.0 * np.pi) * self.slip * part * self.frequency**2
        return lost / w**2 * (1.0 + self.slip * part - 0.25 * self.hardening * part**2)


def ringing(clock: Array, law: Law, first: float) -> Array:
    """The acceleration of a mode from a blow at 0 s on, of a first acceleration amplitude (m/s^2)."""

    def slope(_: float, state: Array) -> list[float]:
        a = np.exp(state[0])
        w = float(law.w(a))
        return [-float(law.zeta(a)) * w, w]

    start = [np.log(first / law.frequency**2), 0.0]
    motion = solve_ivp(
        slope, (0.0, clock[-1]), start, rtol=1e-10, atol=1e-12, dense_output=True, max_step=0.05
    )
    level, phase = motion.sol(np.maximum(clock, 0.0))
    a = np.exp(level)
    return np.where(clock >= 0.0, law.w(a) ** 2 * a * np.sin(phase), 0.0)


def linear(clock: Array, frequency: float, damping: float, first: float) -> Array:
    """The acceleration of a linear mode."""
    w, after = 2.0 * np.pi * frequency, np.maximum(clock, 0.0)
    wave = np.sin(w * np.sqrt(1.0 - damping**2) * after)
    return np.where(clock >= 0.0, first * np.exp(-damping * w * after) * wave, 0.0)


def sensors(time_: Array, signals: Array) -> xr.Dataset:
    """Signals as `read_sensors` returns them."""
    names = [f"acc{at}" for at in range(1, len(signals) + 1)]
    signal = (("sensor", "time"), signals, {"units": "m/s^2"})
    return xr.Dataset(
        {"signal": signal}, {"sensor": names, "time": ("time", time_, {"units": "s"})}, {"source": "beam"}
    )


@dataclass(frozen=True)
class Beam:
    """A record of a beam, without noise, and the laws of its nonlinear modes by their numbers.

    Attributes
    ----------
    time : (sample,) array of float, s
    clean : (sensor, sample) array of float
    laws : dict of int to Law
    blow : float, s
    noise : (sensor,) array of float
    """

    time: Array
    clean: Array
    laws: dict[int, Law]
    blow: float
    noise: Array

    def record(self, seed: int) -> xr.Dataset:
        random = np.random.default_rng([seed, 7])
        return sensors(self.time, self.clean + self.noise[:, None] * random.standard_normal(self.clean.shape))


def beam(
    count: int = 64_000,
    rate: float = 12_800.0,
    blow: float = 0.05,
    factor: float = 1.0,
    offset: float = 1.0,
    hum: float = 0.0,
    shapes: Array = SHAPES,
) -> Beam:
    """The beam, or one whose frequencies are `factor` times as high."""
    time_ = np.arange(count) / rate
    clock = time_ - blow
    law = Law(W0 * factor, Z0, LARGEST / factor**2)
    modes = [ringing(clock, law, 62.0)] + [linear(clock, f * factor, z, a) for f, z, a in LINEAR]
    clean = shapes @ np.array(modes) + offset * OFFSET[:, None]
    return Beam(time_, clean + hum * np.sin(2.0 * np.pi * 50.0 * time_ + 1.0), {1: law}, blow, NOISE)


def close_modes(count: int, apart: float = 1.1) -> Beam:
    """Two nonlinear modes, at so many sensors; `apart` is the ratio of their frequencies."""
    rate, blow = 5120.0, 0.05
    time_ = np.arange(round(5.0 * rate)) / rate
    laws = {
        1: Law(W0, 0.0015, 62.0 / W0**2, 0.02, 0.012),
        2: Law(apart * W0, 0.002, 50.0 / (apart * W0) ** 2, 0.025, 0.0),
    }
    modes = np.array([ringing(time_ - blow, laws[1], 62.0), ringing(time_ - blow, laws[2], 50.0)])
    shapes = np.array([[0.5, 1.0], [1.0, -0.7], [-0.8, 0.4]]) if count == 3 else np.ones((1, 2))
    return Beam(time_, shapes @ modes, laws, blow, np.full(count, 0.01))


def holds(curves: xr.Dataset, law: Law, blow: float) -> dict[str, bool]:
    """Whether the bands hold the truth at all amplitudes from 0.1 s after the blow on."""
    amplitude = curves.amplitude.values
    first = np.interp(blow + FROM_BLOW, curves.time.values, curves.amplitude_over_time.values)
    inside = amplitude <= first
    truth = {"frequency": law.w(amplitude), "damping_ratio": law.zeta(amplitude)}
    return {
        name: bool(np.all((np.abs(curves[name].values - value) <= half_width(curves, name))[inside]))
        for name, value in truth.items()
    }


def squared_errors(curves: xr.Dataset, law: Law, blow: float) -> dict[str, float]:
    """Mean squares of the errors over the stated ones, from 0.1 s after the blow on."""
    amplitude = curves.amplitude.values
    first = np.interp(blow + FROM_BLOW, curves.time.values, curves.amplitude_over_time.values)
    truth = {"frequency": law.w(amplitude), "damping_ratio": law.zeta(amplitude)}
    return {
        f"square_{name}": float(
            np.mean(
                (((curves[name] - value) / curves[f"{name}_standard_error"]).values[amplitude <= first]) ** 2
            )
        )
        for name, value in truth.items()
    }


def tried(source: Beam, number: int) -> Callable[[int], dict]:
    """What the bands of a mode hold of one record, and the processor time."""

    def one(seed: int) -> dict:
        def made() -> xr.Dataset:
            return st.backbone(st.free_decay(st.one_mode(source.record(seed), number)))

        curves, seconds = timed(made, time.process_time)
        widths = {
            f"half_{name}": float(np.median(half_width(curves, name)))
            for name in ("frequency", "damping_ratio")
        }
        law = source.laws[number]
        errors = squared_errors(curves, law, source.blow)
        return holds(curves, law, source.blow) | errors | widths | {"seconds": seconds}

    return one


# Ratios of the frequencies of close modes, and numbers of sensors.
CLOSE = ((1.1, 3), (1.1, 1), (1.05, 3), (1.05, 1), (1.04, 3), (1.03, 3))
# Beams of other kinds: what is other than in the first.
KINDS = {
    "three times as high": {"factor": 3.0, "rate": 25_600.0, "count": 64_000},
    "half as high": {"factor": 0.5},
    "trigger 0.5 s before the blow": {"blow": 0.5},
    "offset of 3, -1.5, 5 m/s^2": {"offset": 500.0},
    "mains hum of 0.3 m/s^2": {"hum": 0.3},
    "other shapes": {
        "shapes": np.array([[1.0, 0.3, 0.7, -0.2], [0.5, 0.8, -0.3, 0.9], [-0.2, 0.6, 1.0, 0.4]])
    },
}


def modes(asked: Namespace) -> None:
    heads = (
        "record",
        "mode",
        "held: frequency %",
        "damping %",
        "error / stated: frequency",
        "damping",
        "half width (rad/s)",
        "of damping",
        "s",
    )
    table = []

    def add(name: str, source: Beam, seeds: int | None = None) -> None:
        for number in source.laws:
            rows = over_seeds(asked, tried(source, number), seeds=seeds, case=f"{name}, {number}")
            held = [
                f"{100 * np.mean([row[key] for row in rows]):.0f}" for key in ("frequency", "damping_ratio")
            ]
            widths = [
                f"{np.mean([row[f'half_{key}'] for row in rows]):.1e}"
                for key in ("frequency", "damping_ratio")
            ]
            errors = [
                f"{np.sqrt(np.mean([row[f'square_{key}'] for row in rows])):.2f}"
                for key in ("frequency", "damping_ratio")
            ]
            seconds = f"{np.mean([row['seconds'] for row in rows]):.2f}"
            table.append([name, str(number), *held, *errors, *widths, seconds])

    if asked.only in "look":
        look()
    if asked.only in "beam":
        add("beam", beam())
    if asked.only in "close":
        for apart, count in CLOSE:
            add(f"{100 * (apart - 1):.0f} % apart, sensors: {count}", close_modes(count, apart))
    if asked.only in "kinds":
        for name, options in KINDS.items():
            add(name, beam(**options), 3)
    if table:
        shown("", heads, table, 140)
    if asked.only in "coupling":
        coupled(asked)
    if asked.only in "judged":
        judged(asked)


# Forces of a simulated mode (coefficients in 1 and 1/m), its first amplitude (m), duration (s), rate (Hz).
FORCES_OF_MODE = {"zeta": 0.003, "delta": 15.0, "nu": -60.0}
FIRST_OF_MODE, RINGS_FOR, RATE_OF_MODE = 2.4e-4, 1.5, 5120.0
NOISE_OF_MODE = 0.01


@lru_cache(1)
def clean_mode() -> Array:
    """The acceleration of a mode with the `FORCES_OF_MODE` (m/s^2), at rest for the first 0.05 s."""
    clock = np.arange(round(RINGS_FOR * RATE_OF_MODE)) / RATE_OF_MODE
    model = st.Model(st.load_library(), FORCES_OF_MODE, W0)
    motion = st.simulate(model, clock, angle=0.0, rate=FIRST_OF_MODE * W0)
    acceleration = make_interp_spline(clock, motion.angle.values, 7)(clock, 2)
    return np.concatenate([np.zeros(round(0.05 * RATE_OF_MODE)), acceleration])


def mode_of_known_forces(seed: int) -> xr.Dataset:
    """The free decay of that mode, as an accelerometer with white noise shows it."""
    clean = clean_mode()
    noise = NOISE_OF_MODE * np.random.default_rng([seed, 13]).standard_normal(clean.size)
    time_ = np.arange(clean.size) / RATE_OF_MODE
    return st.free_decay(st.one_mode(sensors(time_, (clean + noise)[None]), 1))


def verdict_on_mode(seed: int, known: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """The outcome of `discover` that starts from some of the forces, and the forces that it adds."""
    library = st.load_library()
    start = replace(library, forces=tuple(force for force in library if force.symbol in known))
    found = st.discover(mode_of_known_forces(seed), start)
    steps = found["steps"].to_dataset()
    added = steps.symbol.values.tolist() if steps.sizes.get("step") else []
    return str(found.attrs["search_outcome"]), tuple(added)


def judged(asked: Namespace) -> None:
    """How often the verdict on a simulated mode is right: all forces known, and one missing."""
    table = []
    for missing in ("", "delta", "nu"):

        def one(seed: int, missing: str = missing) -> dict:
            known = tuple(name for name in FORCES_OF_MODE if name != missing)
            verdict, added = verdict_on_mode(seed, known)
            right = ("explained", (missing,)) if missing else ("nothing missing", ())
            return {"right": (verdict, added) == right, "unknown": verdict == "unknown effect"}

        rows = over_seeds(asked, one, case=f"without {missing or 'none'}")
        shares = [f"{100 * np.mean([row[name] for row in rows]):.1f}" for name in ("right", "unknown")]
        table.append([missing or "none", str(len(rows)), *shares])
    heads = ("missing force", "records", "right verdict %", "unknown effect %")
    shown("discover of a mode with viscous and quadratic friction and a softening spring", heads, table, 100)


# Relative changes of the frequency of mode 1 by the first amplitude of mode 2.
COUPLINGS = (0.0, 5e-4, 1.5e-3, 5e-3)


def coupled(asked: Namespace) -> None:
    """Statements on the frequency of a mode that follows another one, in random decays."""
    rows = []
    for coupling in COUPLINGS:

        def one(seed: int, coupling: float = coupling) -> dict:
            said = st.modes(sensors(*random_decay(seed, coupling))).attrs["influences"]
            follows = [sentence for sentence in said if "depends on the amplitude" in sentence]
            right = "the frequency of mode 1 depends on the amplitude of mode 2"
            return {
                "right": bool(coupling) and any(right in sentence for sentence in follows),
                "wrong": any(not coupling or right not in sentence for sentence in follows),
            }

        made = over_seeds(asked, one, case=f"coupling {coupling:g}")
        shares = [f"{100 * np.mean([row[name] for row in made]):.1f}" for name in ("right", "wrong")]
        rows.append([f"{100 * coupling:g} %", str(len(made)), *shares])
    heads = ("change of the frequency", "records", "right statement %", "wrong statement %")
    shown("the frequency of mode 1 follows the amplitude of mode 2", heads, rows, 100)


def look() -> None:
    """The modes of 65,536 samples of three sensors."""
    record = beam(count=65_536).record(0)
    listed, seconds = timed(lambda: st.modes(record), time.process_time)
    truth = [80.0, *(f * np.sqrt(1.0 - z**2) for f, z, _ in LINEAR)]
    rows = [
        [f"{true:.2f}", f"{value:.4f}", f"{100 * (value / true - 1.0):+.4f}"]
        for true, value in zip(truth, listed.frequency.values, strict=True)
    ]
    shown(
        f"modes of 65,536 samples x 3 sensors: {seconds:.2f} s of processor",
        ("Hz", "listed", "error %"),
        rows,
        60,
    )
