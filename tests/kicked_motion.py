"""Motions that are pushed at random, of many seeds at once; the generator shares nothing with the package."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Force = Callable[[Array, Array], Array]

KICKS_PER_PERIOD = 400
SAMPLES_AT_ONCE = 50


def smooth_forces(coefficients: Mapping[str, float]) -> Force:
    """The paper's forces of (x, v) but for dry friction, in dv/dtau = -x - force."""
    c = {name: coefficients.get(name, 0.0) for name in ("zeta", "delta", "alpha", "nu", "epsilon")}

    def force(x: Array, v: Array) -> Array:
        damping = 2.0 * c["zeta"] * v + c["delta"] * np.abs(v) * v
        return damping + c["alpha"] * x + c["nu"] * np.abs(x) * x + c["epsilon"] * x**3

    return force


def kicked_motion(
    time: Array,
    w: float,
    force: Force,
    dry_friction: float,
    density: float,
    seeds: Sequence[int],
    *,
    start: tuple[float, float] = (0.3, 0.0),
    kicks_per_period: int = KICKS_PER_PERIOD,
) -> tuple[Array, Array]:
    """x and v = theta'/w of motions in white acceleration, both (seed, sample), rad.

    Parameters
    ----------
    time : (sample,) array of float, s
        Evenly spaced.
    w : float, rad/s
    force : callable
        Function of (x, v), (seed,) each: all forces other than spring, dry friction and kicks.
    dry_friction : float
        lambda of dv/dtau = -x - lambda sign(v) - force.
    density : float, (rad/s^2)^2/Hz
        One-sided density of the acceleration.
    seeds : sequence of int
        One motion per seed; its kicks depend only on the seed.
    start : (float, float), rad and rad/s
        Angle and rate at the first sample.
    kicks_per_period : int
        At least; a whole number between two samples.

    Notes
    -----
    In each substep half of the other forces (Strang 1968), then spring and dry friction exactly, through a
    reversal or to a stop in it, then the other half, then a Gaussian kick of x and v with the covariance that
    an undamped oscillator gathers from white acceleration. A body that friction holds is moved by the next
    kick, however small, and friction stops it again: white noise has no greatest push. Errors of the motion
    without kicks fall with the square of the substep, those of the law of the wander near a stop too.
    """
    steps = np.diff(time)
    if not np.allclose(steps, steps[0], rtol=1e-6):
        raise ValueError("the samples are not evenly spaced")
    interval = w * float(np.mean(steps))
    substeps = int(np.ceil(interval * kicks_per_period / (2.0 * np.pi)))
    h = interval / substeps
    root = np.sqrt(0.5 * density / w**3) * _root_of_covariance(h)
    streams = [np.random.default_rng([seed, 7]) for seed in seeds]
    x, v = np.full(len(seeds), start[0]), np.full(len(seeds), start[1] / w)
    path = np.empty((2, len(seeds), len(time)))
    path[:, :, 0] = x, v
    for first in range(1, len(time), SAMPLES_AT_ONCE):
        last = min(first + SAMPLES_AT_ONCE, len(time))
        draws = np.stack([stream.standard_normal((last - first, substeps, 2)) for stream in streams], axis=-1)
        kicks = np.einsum("ab,ksbn->ksan", root, draws)
        for k in range(first, last):
            for kick in kicks[k - first]:
                v = v - 0.5 * h * force(x, v)
                x, v = _swung(x, v, h, dry_friction)
                v = np.where(v == 0.0, 0.0, v - 0.5 * h * force(x, v))
                x, v = x + kick[0], v + kick[1]
            path[:, :, k] = x, v
    return path[0], path[1]


def _root_of_covariance(h: float) -> Array:
    """Lower triangular root of the covariance of (x, v) after h, for a growth of v of one a unit of tau."""
    mixed = 0.5 * np.sin(h) ** 2
    # The difference of x is of third order in h: its series where rounding would spoil it.
    of_x = h**3 / 3.0 - h**5 / 15.0 if h < 0.02 else 0.5 * (h - np.sin(h) * np.cos(h))
    return np.linalg.cholesky([[of_x, mixed], [mixed, 0.5 * (h + np.sin(h) * np.cos(h))]])


def _swung(x: Array, v: Array, h: float, dry_friction: float) -> tuple[Array, Array]:
    """Spring and dry friction alone over h, exactly, with one reversal at most."""
    # From rest it goes where the spring pulls, if that is stronger than friction.
    way = np.where(v != 0.0, np.sign(v), np.where(np.abs(x) > dry_friction, -np.sign(x), 0.0))
    shift = dry_friction * way
    turns_after = np.where((v != 0.0) & (way != 0.0), np.arctan2(way * v, way * (x + shift)), np.inf)
    turns_after = np.where(turns_after < 0.0, turns_after + 2.0 * np.pi, turns_after)
    until = np.minimum(turns_after, h)
    moved_x, moved_v = _rotated(x, v, until, shift)
    held = way == 0.0
    moved_x, moved_v = np.where(held, x, moved_x), np.where(held, 0.0, moved_v)
    turned = turns_after < h
    if turned.any():
        back = np.where(np.abs(moved_x) > dry_friction, -np.sign(moved_x), 0.0)
        again_x, again_v = _rotated(moved_x, np.zeros_like(v), h - until, dry_friction * back)
        moved_v = np.where(turned, np.where(back != 0.0, again_v, 0.0), moved_v)
        moved_x = np.where(turned & (back != 0.0), again_x, moved_x)
    return moved_x, moved_v


def _rotated(x: Array, v: Array, angle: Array, shift: Array) -> tuple[Array, Array]:
    """Free oscillation about -shift."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return (x + shift) * cosine + v * sine - shift, v * cosine - (x + shift) * sine
