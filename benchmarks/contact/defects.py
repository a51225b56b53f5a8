"""Kinds of defects: of the clock, of the samples, of what is in a record beside a decay."""

from pathlib import Path

import numpy as np

from benchmarks.contact.writing import DEG, Array, Draw, Right, Swing, cells, decay_at, kind, swing, write

HEADS = ("Time (s),Angle (rad)", "t [s],theta [rad]", "time,angle_rad")


def save(path: Path, draw: Draw, time: Array, x: Array, digits: int = 4) -> None:
    """A plain file of two columns."""
    write(path, cells(f"%.{digits}f %.5f", time, x), draw.pick(*HEADS))


def noisy(draw: Draw, x: Array, of: float = 1e-3) -> Array:
    return x + draw.noise(x.size, of)


def held_by_hand(draw: Draw, motion: Swing, release: float) -> Array:
    """Brought to the start by a hand, with wobbles, and let go at `release`."""
    x = motion.x.copy()
    before = motion.time < release
    s = np.clip(motion.time[before] / (0.8 * release), 0, 1)
    wobble = (
        0.15 * motion.start * np.sin(np.pi * s) * np.sin(draw.rng.uniform(9, 12) * s + draw.rng.uniform(0, 6))
    )
    x[before] = motion.start * s * s * (3 - 2 * s) + wobble
    return x


@kind("rounded_clock", "stamps rounded, or cut off, to so few digits that steps differ")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(29.97, 30.0, 59.94, 97.0, 119.88, 240.0, 330.0, 33.0))
    digits = 2 if motion.rate < 40 else 3
    stamps = draw.pick(np.round, np.floor)(motion.time * 10**digits) / 10**digits
    save(path, draw, stamps, noisy(draw, motion.x), digits)
    return motion.right("angle", "rad")


@kind("jitter", "stamps that jitter by up to a third of a step")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(40, 80))
    of = draw.within(0.02, 0.33) / motion.rate
    time = motion.time + draw.rng.uniform(-of, of, motion.time.size)
    w = 2 * np.pi / motion.period
    save(path, draw, time, noisy(draw, decay_at(time, w, motion.zeta, motion.start)[0]), 6)
    return motion.right("angle", "rad")


@kind("gaps", "samples missing: single ones, one long gap")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(40, 80))
    keep = draw.rng.random(motion.x.size) > 0.01
    keep[0] = True
    at = int(draw.rng.integers(motion.x.size // 3, motion.x.size // 2))
    long = draw.pick(0.0, 0.15, 1.3)
    keep[at : at + int(long * motion.period * motion.rate)] = False
    save(path, draw, motion.time[keep], noisy(draw, motion.x)[keep])
    return motion.right("angle", "rad", decays=2 if long > 1 else 1)


@kind("doubled", "rows written twice, a clock set back once")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rows = cells("%.4f %.5f", motion.time, noisy(draw, motion.x))
    for at in sorted(draw.rng.choice(len(rows), 8, replace=False), reverse=True):
        rows.insert(at, rows[at])
    write(path, rows, draw.pick(*HEADS))
    return motion.right("angle", "rad")


@kind("unsorted", "rows in no order of time")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    order = draw.rng.permutation(motion.x.size)
    save(path, draw, motion.time[order], noisy(draw, motion.x)[order])
    return Right(words=("time must rise", "sort", "order"))


@kind("rest_and_hand", "rest or a hand before the release")
def _(path: Path, draw: Draw) -> Right:
    release = draw.within(1.5, 5.0)
    motion = swing(draw, release=release)
    x = held_by_hand(draw, motion, release) if draw.pick(True, False) else motion.x
    save(path, draw, motion.time, noisy(draw, x))
    return motion.right("angle", "rad")


@kind("plucks", "several decays in one file")
def _(path: Path, draw: Draw) -> Right:
    release = draw.within(1.5, 3.0)
    count = draw.pick(2, 3, 4, 6)
    motion = swing(draw, release=release, samples=(40, 70))
    signs = [draw.pick(1.0, -1.0) * draw.within(0.75, 1.0) for _ in range(count)]
    x = np.concatenate([sign * held_by_hand(draw, motion, release) for sign in signs])
    time = np.arange(x.size) / motion.rate
    save(path, draw, time, noisy(draw, x))
    return Right("angle", "rad", motion.period, motion.zeta, decays=count)


@kind("stop_by_hand", "stopped by a hand")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=5.0)
    end = motion.time[-1] * draw.within(0.7, 0.9)
    rest = draw.within(-0.05, 0.05)
    x = np.where(
        motion.time < end,
        motion.x,
        rest + (motion.x - rest) * np.exp(-np.maximum(motion.time - end, 0) / (0.1 * motion.period)),
    )
    extra = np.arange(int(5 * motion.rate)) / motion.rate
    time = np.concatenate([motion.time, motion.time[-1] + 1 / motion.rate + extra])
    save(path, draw, time, noisy(draw, np.concatenate([x, np.full(extra.size, rest)])))
    return motion.right("angle", "rad")


@kind("stop_by_friction", "stopped by dry friction, away from the middle, and a long rest")
def _(path: Path, draw: Draw) -> Right:
    period, start, zeta, lam = (
        draw.within(0.6, 2.0),
        draw.within(0.2, 0.5),
        draw.within(0.001, 0.004),
        draw.within(1e-3, 4e-3),
    )
    time, x = _dry(period, start, zeta, lam, draw.within(40, 90), draw.within(10, 30))
    save(path, draw, time, noisy(draw, x, 5e-4))
    return Right("angle", "rad", period, amplitude=start)


def _dry(
    period: float, start: float, zeta: float, lam: float, samples: float, rest: float
) -> tuple[Array, Array]:
    """Half periods about +-lam, each viscous; then held."""
    w = 2 * np.pi / period
    half = np.pi / w
    rate = float(f"{samples / period:.2g}")
    turn, points = start, []
    fall = np.exp(-zeta * np.pi / np.sqrt(1 - zeta**2))
    while abs(turn) > lam:
        points.append(turn)
        centre = np.sign(turn) * lam
        turn = centre - (turn - centre) * fall
    end = half * len(points)
    time = np.arange(int((end + rest) * rate)) / rate
    which = np.minimum((time / half).astype(int), len(points) - 1)
    turns = np.array(points)
    centre = np.sign(turns[which]) * lam
    local = np.minimum(time - half * which, half)
    return time, centre + decay_at(local, w, zeta, 1.0)[0] * (turns[which] - centre)


@kind("spikes", "single bad samples, a bad first one")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = noisy(draw, motion.x)
    count = draw.pick(1, 3, 8)
    x[draw.rng.choice(x.size, count, replace=False)] += draw.rng.uniform(1, 8, count) * draw.rng.choice(
        [-1, 1], count
    )
    if draw.pick(True, False):
        x[0] = draw.pick(0.0, 9.99, -5.0)
    save(path, draw, motion.time, x)
    return motion.right("angle", "rad")


@kind("sentinels", "missing values as -999 or 9999, or as zeros")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(60, 120))
    x = 0.7 + noisy(draw, motion.x)
    x[draw.rng.choice(x.size, 6, replace=False)] = draw.pick(-999.0, 9999.0, -9999.0, 0.0, 99.99)
    save(path, draw, motion.time, x)
    return motion.right("angle", "rad")


@kind("wrapped", "cut at 180, 360 deg, pi or 2 pi")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, start=(0.3, 0.9))
    turn, low, unit = draw.pick(
        (360.0, -180.0, "deg"), (360.0, 0.0, "deg"), (2 * np.pi, -np.pi, "rad"), (2 * np.pi, 0.0, "rad")
    )
    scale = DEG if unit == "deg" else 1.0
    centre = low + draw.pick(0.0, 0.0, 0.02, -0.02) * turn
    x = (scale * noisy(draw, motion.x) + centre - low) % turn + low
    write(path, cells("%.4f %.5f", motion.time, x), f"time (s),angle ({unit})")
    return motion.right("angle", unit)


@kind("wrapped_counts", "an encoder's counts of one turn, cut at the turn's end")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, start=(0.4, 0.9))
    counts = draw.pick(1024, 4096, 1000, 3600)
    x = np.round(motion.x / (2 * np.pi) * counts) % counts
    write(path, cells("%.4f %d", motion.time, x), draw.pick("time (s),encoder (counts)", "t [s],counts"))
    return motion.right("displacement", "au", counts / (2 * np.pi))


@kind("clipped", "the sensor clips at first, on one side or both")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    limit = motion.start * draw.within(0.55, 0.8)
    low = draw.pick(-limit, -10.0)
    save(path, draw, motion.time, np.clip(noisy(draw, motion.x), low, limit))
    return Right("angle", "rad", motion.period, motion.zeta, limit)


@kind("clipped_throughout", "clipped to the end")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=3.0)
    limit = motion.start / draw.within(4.0, 6.0)
    save(path, draw, motion.time, np.clip(noisy(draw, motion.x), -limit, limit))
    return Right(words=("clip", "range"))


@kind("quantised", "a coarse sensor without noise")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    step = motion.start / draw.pick(30.0, 60.0, 200.0)
    save(path, draw, motion.time, np.round(motion.x / step) * step)
    return motion.right("angle", "rad")


@kind("drifting_zero", "a zero that drifts slowly")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    drift = draw.within(0.02, 0.15) * motion.start * motion.time / motion.time[-1]
    save(path, draw, motion.time, noisy(draw, motion.x + draw.within(-2, 2) + draw.pick(1, -1) * drift))
    return motion.right("angle", "rad")


@kind("held_frames", "a logger faster than its sensor: values are held over rows")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(90, 180))
    hold = draw.pick(2, 3, 5)
    x = np.repeat(noisy(draw, motion.x, 2e-3)[::hold], hold)[: motion.x.size]
    save(path, draw, motion.time, x)
    return motion.right("angle", "rad")


@kind("driven_then_free", "driven until its drive is switched off, the drive in a column or not")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    w = 2 * np.pi / motion.period
    drive = draw.pick(15, 30) * motion.period
    count = int(drive * motion.rate)
    before = motion.start * np.cos(w * (np.arange(count) / motion.rate - count / motion.rate))
    x = noisy(draw, np.concatenate([before, motion.x]))
    time = np.arange(x.size) / motion.rate
    push = np.where(np.arange(x.size) < count, draw.within(1, 20) * np.sin(w * time), 0.0)
    if draw.pick(True, False):
        write(
            path,
            cells("%.4f %.4f %.5f", time, push, x),
            draw.pick("Time (s),Motor (V),Angle (rad)", "t [s],Drive [V],Theta [rad]"),
        )
    else:
        save(path, draw, time, x)
    return motion.right("angle", "rad")


@kind("copy_and_filtered", "raw and filtered angle, its rate and its acceleration beside it")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = noisy(draw, motion.x)
    filtered = np.convolve(np.pad(x, 2, mode="edge"), np.ones(5) / 5, "valid")
    head = draw.pick(
        "Time (s),Angle (rad),Angle filtered (rad),Angular velocity (rad/s),Angular acceleration (rad/s^2)",
        "t [s],theta [rad],theta_f [rad],omega [rad/s],alpha [rad/s²]",
    )
    write(path, cells("%.4f %.5f %.5f %.4f %.3f", motion.time, x, filtered, motion.v, motion.a), head)
    return motion.right("angle", "rad")


@kind("deg_and_rad", "the angle in degrees and in rad")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = noisy(draw, motion.x)
    write(path, cells("%.4f %.4f %.6f", motion.time, x * DEG, x), "Time (s),Angle (deg),Angle (rad)")
    return Right("angle", "", motion.period, motion.zeta, motion.start)


@kind("resting_sensor", "another sensor that rests, or only hums")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    other = draw.pick(
        draw.noise(motion.x.size, 0.002),
        0.01 * np.sin(37.0 * motion.time),
        np.zeros(motion.x.size),
        20 + 0.001 * motion.time,
    )
    head = draw.pick("Time (s),Ch 1 (V),Ch 2 (V)", "t [s],U1 [V],U2 [V]", "t/s,Sensor A / V,Sensor B / V")
    columns = [other, 3.0 * noisy(draw, motion.x)]
    if draw.pick(True, False):
        columns.reverse()
    write(path, cells("%.4f %.5f %.5f", motion.time, *columns), head)
    return motion.right("displacement", "V", 3.0)


@kind("temperature", "temperature, humidity and battery beside an angle")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    columns = (
        21 + 0.01 * np.cumsum(draw.noise(motion.x.size, 0.1)),
        noisy(draw, motion.x) * DEG,
        3.9 - motion.time / 1e4,
    )
    write(
        path,
        cells("%.4f %.2f %.3f %.3f", motion.time, *columns),
        "time (s),temp (°C),angle (deg),battery (V)",
    )
    return motion.right("angle", "deg")


# What is to be refused.
@kind("beats", "beats of two modes")
def _(path: Path, draw: Draw) -> Right:
    one, ratio = swing(draw, zeta=(0.001, 0.003), falls=4.0), draw.within(1.05, 1.12)
    x = 0.5 * one.x + 0.5 * decay_at(one.time, ratio * 2 * np.pi / one.period, one.zeta, one.start)[0]
    save(path, draw, one.time, noisy(draw, x))
    return Right(words=("beat", "two modes", "rises again"))


@kind("driven", "a constant amplitude")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=4.0)
    x = motion.start * np.cos(2 * np.pi / motion.period * motion.time)
    save(path, draw, motion.time, noisy(draw, x))
    return Right(words=("driven", "does not decay"))


@kind("growing", "an amplitude that grows")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=draw.within(2.0, 8.0), zeta=(0.004, 0.02))
    save(path, draw, motion.time, noisy(draw, motion.x[::-1], 5e-4))
    return Right(words=("grow",))


@kind("resonance", "a drive that is switched on: the amplitude grows and settles")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=8.0)
    w = 2 * np.pi / motion.period
    x = motion.start * np.cos(w * motion.time) * (1 - np.exp(-motion.zeta * w * motion.time))
    save(path, draw, motion.time, noisy(draw, x))
    return Right(words=("grow", "driven", "does not decay"))


@kind("constant", "a column that never moves")
def _(path: Path, draw: Draw) -> Right:
    time = np.arange(800) / draw.within(20, 200)
    value = draw.pick(0.0, 0.1234, -5.0, 90.0)
    save(path, draw, time, np.full(time.size, value))
    return Right(words=("flat", "constant"))


@kind("noise_alone", "noise, no oscillation")
def _(path: Path, draw: Draw) -> Right:
    time = np.arange(3000) / draw.within(20, 200)
    save(path, draw, time, draw.noise(time.size, 0.05))
    return Right(words=("no oscillation", "noise"))


@kind("too_short", "two or three half periods")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    part = motion.time < draw.within(0.9, 1.5) * motion.period
    save(path, draw, motion.time[part], noisy(draw, motion.x[part]))
    return Right(words=("half period", "too short", "record longer", "samples"))


@kind("pulses", "a light barrier, or contacts")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(150, 300), falls=3.0)
    light = np.exp(-((motion.x / (0.06 * motion.start)) ** 4))
    low, high = draw.pick((92.0, 18.0), (0.0, 5.0), (5.0, 0.1))
    x = low + (high - low) * light
    write(
        path,
        cells("%.4f %.3f", motion.time, x + draw.noise(x.size, 0.01)),
        draw.pick("Time (s),Light Intensity (%)", "t [s],Gate [V]", "time,U (V)"),
    )
    return Right(words=("pulse", "light barrier"))


@kind("aliased", "two or three samples a period")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(3.1, 4.8))
    save(path, draw, motion.time, noisy(draw, motion.x))
    return Right(words=("sample faster",))


@kind("creep", "no oscillation: it creeps back")
def _(path: Path, draw: Draw) -> Right:
    time = np.arange(2000) / draw.within(50, 100)
    x = draw.within(0.2, 0.6) * np.exp(-time / draw.within(1.0, 4.0))
    save(path, draw, time, noisy(draw, x))
    return Right(words=("no oscillation", "half periods"))


@kind("texts_only", "a file of words")
def _(path: Path, draw: Draw) -> Right:
    path.write_text(
        "Protocol of the lab course\nWe measured a pendulum.\nSee the other file.\n", encoding="utf-8"
    )
    return Right(words=("no rows of numbers",))
