"""Kinds that loggers, offices and phones write: clocks, dialects, axes, runs, units that nothing states."""

import gzip
from pathlib import Path

import numpy as np
from scipy.io import savemat
from scipy.signal import lfilter

from benchmarks.contact.texts import fine
from benchmarks.contact.writing import DEG, Draw, Right, cells, kind, swing, write


@kind("clock_digits", "stamps of three or four significant digits")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(20.0, 30.0, 60.0), period=(1.0, 2.0))
    kept = motion.time < 30.0
    digits = draw.pick(2, 3)
    sep = draw.pick(";", ",", "\t")
    columns = motion.time[kept], fine(draw, motion.x[kept], DEG)
    write(path, cells(f"%.{digits}E %.4E", *columns), sep.join(("t", "theta (deg)")), sep)
    return motion.right("angle", "deg")


@kind("packets", "stamps of packets, some of them late")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(100.0, 200.0), period=(0.8, 2.0))
    row, size = np.arange(motion.time.size), draw.pick(4, 6, 8)
    late = draw.within(0.0, 0.05) * (draw.noise(row.size, 1.0) > 1.5)[row // size * size]
    # A packet does not overtake the one before.
    arrival = np.maximum.accumulate(row // size * size / motion.rate + late)
    stamps = np.maximum.accumulate(arrival + draw.pick(0.0, 0.001) * (row % size))
    write(path, cells("%.3f %.5f", stamps, fine(draw, motion.x, 1.0)), "time (s),angle (rad)")
    return motion.right("angle", "rad")


@kind("two_clocks", "a coarse clock beside a fine one")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=100.0, period=(0.4, 1.5))
    at = 1000.0 + motion.time
    stamps = [f"16:{int(s // 60) % 60:02d}:{s % 60:06.3f}" for s in at]
    coarse = np.floor(5.0 * motion.time) / 5.0
    first = draw.pick(True, False)
    clocks = (stamps, coarse) if first else (coarse, stamps)
    formats = "%s %.1f %.3f" if first else "%.1f %s %.3f"
    head = "Timestamp,Elapsed (s),Angle (deg)" if first else "Elapsed (s),Timestamp,Angle (deg)"
    write(path, cells(formats, *clocks, fine(draw, motion.x, DEG)), head)
    return motion.right("angle", "deg")


@kind("serial_days", "days of a spreadsheet or of MATLAB")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    days = draw.pick(44000.0, 737000.0) + draw.within(1.0, 900.0) + motion.time / 86400.0
    write(path, cells("%.10f %.5f", days, fine(draw, motion.x, 1.0)), f"{draw.pick('time', 't')},angle (rad)")
    return motion.right("angle", "rad")


@kind("absurd_period", "ms or us without a unit: asked about")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, period=(1.0, 2.2))
    times = draw.pick(1e3, 1e6) * motion.time + draw.pick(0.0, 12345.0)
    write(path, cells("%.0f %.5f", times, fine(draw, motion.x, 1.0)), "Time Stamp,angle (rad)")
    return Right(words=("--time-units",))


@kind("few_samples", "five to ten samples a period")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(5.5, 10.0), falls=6.0)
    write(path, cells("%.6f %.5f", motion.time, fine(draw, motion.x, 1.0)), "t (s),phi (rad)")
    return motion.right("angle", "rad")


@kind("sensor_axes", "three axes that see one rotation: the largest")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    parts = [draw.within(0.9, 1.0), draw.within(0.25, 0.6), -draw.within(0.25, 0.6)]
    order = draw.rng.permutation(3)
    axes = [parts[at] * motion.v + draw.noise(motion.v.size, 0.01) for at in order]
    name = draw.pick("Gyroscope {} (rad/s)", "gyro_{} (rad/s)", "w{} (rad/s)")
    head = ",".join(["Time (s)", *(name.format(axis) for axis in "xyz")])
    write(path, cells("%.4f %.6f %.6f %.6f", motion.time, *axes), head)
    return motion.right("rate", "rad/s", float("nan"))


@kind("numbered_runs", "t1 theta1 omega1 t2 theta2 omega2")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    half = [factor * (motion.x + draw.noise(motion.x.size, 1e-3)) for factor in (DEG, 0.8 * DEG)]
    sep = draw.pick(";", "\t", ",")
    head = sep.join(f"{name}{run}" for run in (1, 2) for name in ("t", "theta", "omega"))
    columns = motion.time, half[0], DEG * motion.v, motion.time, half[1], 0.8 * DEG * motion.v
    write(path, cells("%.4f %.4f %.4f %.4f %.4f %.4f", *columns), head, sep)
    return motion.right("angle", "deg", decays=2)


@kind("thousands", "groups of three digits")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    values = 5000.0 + 1000.0 * motion.x + draw.noise(motion.x.size, 1.0)
    style = draw.pick("german", "swiss", "quoted")
    texts = [f"{value:,.3f}" for value in values]
    if style == "german":
        texts = [text.translate(str.maketrans(",.", ".,")) for text in texts]
        write(
            path,
            [[f"{t:.4f}".replace(".", ","), x] for t, x in zip(motion.time, texts, strict=True)],
            "t [s];x [mm]",
            ";",
        )
    elif style == "swiss":
        swiss = [text.replace(",", "'") for text in texts]
        write(path, [[f"{t:.4f}", x] for t, x in zip(motion.time, swiss, strict=True)], "t [s];x [mm]", ";")
    else:
        write(path, [[f"{t:.4f}", f'"{x}"'] for t, x in zip(motion.time, texts, strict=True)], "t [s],x [mm]")
    return motion.right("displacement", "mm", 1000.0)


@kind("typographer", "minus signs of Scandinavian settings")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rows = [
        [cell.replace("-", "\u2212") for cell in row]
        for row in cells("%.4f %.5f", motion.time, fine(draw, motion.x, DEG))
    ]
    write(path, rows, "tid (s);vinkel (°)", ";", comma=draw.pick(True, False))
    return motion.right("angle", "deg")


@kind("units_in_cells", "a unit behind each number")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(("deg", DEG), ("°", DEG), ("mrad", 1e3))
    space = draw.pick(" ", "")
    rows = [
        [f"{t}{space}s", f"{x}{space}{unit}"]
        for t, x in cells("%.4f %.4f", motion.time, fine(draw, motion.x, scale))
    ]
    write(path, rows, "time,angle", ",")
    return motion.right("angle", "mrad" if unit == "mrad" else "deg")


@kind("ruled", "a line of dashes below the names, comma and blank")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, period=(0.5, 1.0))
    stamps = [f"16:{int(s // 60):02d}:{s % 60:06.3f}" for s in motion.time + 120.0]
    rows = cells("%s %.4f %.3f", stamps, 1488.9 + motion.time, fine(draw, motion.x, DEG))
    write(path, rows, "Timestamp, Time_Elapsed(s), Angle(deg)\n" + draw.pick("-", "=", "_") * 40, ", ")
    return motion.right("angle", "deg")


@kind("missing_block", "a block of -999")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = fine(draw, motion.x, 1.0)
    start = int(draw.within(20.0, 0.8 * x.size))
    x[start : start + 3] = draw.pick(-999.0, -9999.0, 9999.0)
    write(path, cells("%.4f %.6g", motion.time, x), "t (s),theta (rad)")
    return motion.right("angle", "rad")


@kind("scalar_rate.mat", "rate or duration as scalars of a .mat")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    scalars = draw.pick(
        {"ActualRate": motion.rate}, {"duration": motion.time.size / motion.rate}, {"acq_rate": motion.rate}
    )
    savemat(path, {"data": fine(draw, motion.x, 1.0), "notes": "", "trial": 1.0, **scalars})
    return motion.right("angle", "rad")


@kind("packed.csv.gz", "a packed file")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    write(path, cells("%.4f %.5f", motion.time, fine(draw, motion.x, 1.0)), "t (s),theta (rad)")
    path.write_bytes(gzip.compress(path.read_bytes()))
    return motion.right("angle", "rad")


@kind("markup.xml", "XML with numbers in it")
def _(path: Path, draw: Draw) -> Right:
    rows = "".join(f"<value>{x:.3f}, {x + 1:.3f}</value>\n" for x in draw.noise(50, 1.0))
    path.write_text(draw.pick("", '<?xml version="1.0"?>\n') + f"<data>\n{rows}</data>\n", encoding="utf-8")
    return Right(words=("XML",))


@kind("few_degrees", "degrees below pi without a unit: the frequency is steady")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, start=(0.022, 0.05))
    write(
        path, cells("%.4f %.5f", motion.time, DEG * (motion.x + draw.noise(motion.x.size, 1e-4))), "t,theta"
    )
    return motion.right("angle", "deg")


@kind("shaken", "ambient shaking of the same mode after the decay")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=200.0, zeta=(0.008, 0.012))
    w = 2.0 * np.pi / motion.period
    pole = np.exp((-motion.zeta + 1j) * w / motion.rate)
    shaking = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], draw.noise(motion.time.size, 1.0))
    x = motion.x + 0.004 * motion.start / shaking.std() * shaking
    write(path, cells("%.4f %.6f", motion.time, x + draw.noise(x.size, 1e-4)), "t (s),theta (rad)")
    return motion.right("angle", "rad", words=("end the window",))
