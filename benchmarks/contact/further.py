"""Further kinds, written after the rules that the others led to: oscilloscopes, applications, mixtures."""

import json
from pathlib import Path

import numpy as np
from scipy.io import savemat

from benchmarks.contact.binaries import book
from benchmarks.contact.defects import held_by_hand, noisy, save
from benchmarks.contact.writing import DEG, Draw, Right, cells, decay_at, kind, swing, write

# Whether it was pushed or two modes beat cannot always be told: what was seen, and what to do, may be said.
PUSHED = ("pushed; end the window before, or start it after",)


@kind("json_lines", "a microcontroller's lines of JSON")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = noisy(draw, motion.x) * DEG
    lines = [
        json.dumps({"t": round(t, 4), "angle": round(v, 3)}) for t, v in zip(motion.time, x, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return motion.right("angle", "deg")


@kind("fortran", "exponents with a D, columns of fixed width")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rows = [[f"{t:14.6E}", f"{v:14.6E}"] for t, v in zip(motion.time, noisy(draw, motion.x), strict=True)]
    rows = [[c.replace("E", draw.pick("D", "D")) for c in row] for row in rows]
    write(path, rows, draw.pick("", "  time (s)    theta (rad)", "# time  theta"), " ")
    return motion.right("angle", "rad")


@kind("bars", "cells between bars")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    write(
        path,
        cells("%.4f %.5f", motion.time, noisy(draw, motion.x)),
        "Time (s)|Angle (rad)",
        draw.pick("|", " | "),
    )
    return motion.right("angle", "rad")


@kind("scope_tek", "an oscilloscope's facts in the first columns of the first rows")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    u = noisy(draw, motion.x) * 2.0
    facts = [
        ("Record Length", "2.5e+03", "Points"),
        ("Sample Interval", f"{1 / motion.rate:.6e}", "s"),
        ("Trigger Point", "0", "Samples"),
        ("", "", ""),
        ("Source", "CH1", ""),
        ("Vertical Units", "V", ""),
    ]
    facts += [("", "", "")] * (u.size - len(facts))
    write(
        path, [[*fact, f"{t:.6f}", f"{v:.5f}", ""] for fact, t, v in zip(facts, motion.time, u, strict=True)]
    )
    return Right("displacement", "V", motion.period, motion.zeta, 2.0 * motion.start)


@kind("scope_keysight", "an oscilloscope: x-axis and channel, units below")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    head = draw.pick(
        "x-axis,1\nsecond,Volt",
        "x-axis,2\nsecond,Volt",
        "Time,Channel A\n(s),(V)\n",
        "Time,Channel A\n(ms),(mV)\n",
    )
    factor, scale, unit = (1e3, 900.0, "mV") if "(ms)" in head else (1.0, 2.0, "V")
    write(path, cells("%.6e %.6e", factor * (motion.time - 0.3), noisy(draw, motion.x) * scale), head)
    return motion.right("displacement", unit, scale)


@kind("sensor_logger", "a phone: time in ns since 1970 beside seconds_elapsed, axes z y x")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=100.0)
    v = motion.v + draw.noise(motion.v.size, 0.005)
    stamps = [1_552_399_353_000_000_000 + round(1e9 * t) for t in motion.time]
    columns = stamps, motion.time + 0.07, 0.01 * v, v, -0.02 * v
    write(path, cells("%d %.9f %.8f %.8f %.8f", *columns), "time,seconds_elapsed,z,y,x")
    return Right("rate", "rad/s", motion.period, motion.zeta, options={"signal": "rate"})


@kind("sensor_log", "a phone: long names with capitals, units in brackets behind them")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=100.0)
    v = motion.v + draw.noise(motion.v.size, 0.005)
    axes = ",".join(f"gyroRotation{axis}(rad/s)" for axis in "XYZ")
    head = f"loggingSample(N),accelerometerTimestamp_sinceReboot(s),{axes}"
    write(
        path,
        cells("%d %.6f %.6f %.6f %.6f", range(1, v.size + 1), 4021.7 + motion.time, 0.01 * v, 0.02 * v, v),
        head,
    )
    return motion.right("rate", "rad/s")


@kind("physics_toolbox", "a phone: clock times with thousandths after a colon, wx wy wz")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=100.0)
    v = motion.v + draw.noise(motion.v.size, 0.005)
    stamps = [
        f"12:{1 + int(s // 60):02d}:{int(s % 60):02d}:{round(s % 1 * 1000) % 1000:03d}"
        for s in motion.time + 1e-6
    ]
    columns = [f"{a:.5f}" for a in 0.01 * v], [f"{a:.5f}" for a in v], [f"{a:.5f}" for a in 0.02 * v]
    write(path, [list(row) for row in zip(stamps, *columns, strict=True)], "time,wx,wy,wz")
    return motion.right("rate", "rad/s")


@kind("motion_capture", "motion capture: Frame, Time (Seconds), X, Y, Z in mm, facts above")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(100.0, 120.0))
    reach = draw.within(300, 900)
    x, y = reach * np.sin(motion.x), 1500 - reach * np.cos(motion.x)
    z = 210 + 0.01 * x
    axes = [a + draw.noise(a.size, 0.2) for a in (x, y, z)]
    head = "Format Version,1.23,Take Name,Take 3,Capture Frame Rate,120.0\n\n"
    head += "Frame,Time (Seconds),X (mm),Y (mm),Z (mm)"
    write(path, cells("%d %.6f %.4f %.4f %.4f", range(x.size), motion.time, *axes), head)
    return motion.right("displacement", "mm", reach)


@kind("no_rate", "frames or counts of samples, no rate anywhere")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25, 60))
    write(
        path,
        cells("%d %.2f", range(motion.x.size), 400 + noisy(draw, motion.x) * 300),
        draw.pick("frame,x (px)", "sample,x (px)", "index,x (px)"),
    )
    return Right(words=("sampling rate",))


@kind("frame_rate_given", "frames, the rate by the option")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25, 60))
    write(
        path,
        cells("%d %.2f", range(motion.x.size), 400 + noisy(draw, motion.x) * 300),
        draw.pick("frame,x (px)", "sample,x (px)"),
    )
    return motion.right("displacement", "px", 300.0, options={"sampling_rate": motion.rate})


@kind("coarse_clock", "a clock of whole seconds: stamps repeat")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(10.0, 20.0), period=(1.0, 2.0))
    write(path, cells("%d %.4f", np.floor(motion.time), noisy(draw, motion.x)), "time (s),angle (rad)")
    return Right(words=("sampling rate", "coarser"))


@kind("newest_first", "rows in falling order of time")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    save(path, draw, motion.time[::-1], noisy(draw, motion.x)[::-1])
    return Right(words=("sort", "order", "time must rise"))


@kind("savetxt", "numpy's savetxt: names, or names and units, behind a hash")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    head, scale, unit = draw.pick(
        ("# t theta", 1.0, "rad"),
        ("# time [s]\tangle [deg]", DEG, "deg"),
        ("# time\tangle\n# s\tdeg", DEG, "deg"),
        ("# t/s phi/rad", 1.0, "rad"),
    )
    write(
        path,
        cells("%.18e %.18e", motion.time, noisy(draw, motion.x) * scale),
        head,
        "\t" if "\t" in head else " ",
    )
    return motion.right("angle", unit)


@kind("repeated_header", "the head again in the middle: the logger was started anew")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=4.0)
    rows = cells("%.4f %.5f", motion.time, noisy(draw, motion.x))
    write(path, [*rows, ["time (s)", "angle (rad)"], *rows], "time (s),angle (rad)")
    return motion.right("angle", "rad", decays=2)


@kind("hum", "mains hum over the swing")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=500.0, period=(0.8, 1.6), falls=5.0)
    hum = draw.within(0.01, 0.08) * motion.start * np.sin(2 * np.pi * 50.0 * motion.time)
    save(path, draw, motion.time, noisy(draw, motion.x + hum))
    return motion.right("angle", "rad")


@kind("fast", "many samples a period")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(800, 2000), falls=3.0)
    save(path, draw, motion.time, noisy(draw, motion.x), 6)
    return motion.right("angle", "rad")


@kind("strong_damping", "a few periods alone")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, zeta=(0.05, 0.08), falls=20.0, samples=(80, 160))
    save(path, draw, motion.time, noisy(draw, motion.x, 3e-4))
    return motion.right("angle", "rad")


@kind("weak_damping", "the amplitude hardly falls")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, zeta=(0.0003, 0.0008), falls=1.3)
    save(path, draw, motion.time, noisy(draw, motion.x))
    return motion.right("angle", "rad")


@kind("other_angles", "gon, turns, minutes of arc")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(
        ("rev", 0.5 / np.pi),
        ("turns", 0.5 / np.pi),
        ("gon", 200 / np.pi),
        ("arcmin", 60 * DEG),
        ("µrad", 1e6),
    )
    write(path, cells("%.4f %.8g", motion.time, noisy(draw, motion.x) * scale), f"time (s),angle ({unit})")
    return motion.right("angle", {"turns": "rev"}.get(unit, unit))


@kind("clock_head", "the form of the clock in the head's brackets")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=50.0)
    stamps = [f"00:{int(s // 60):02d}:{s % 60:06.3f}" for s in motion.time]
    head = draw.pick(
        "Time (hh:mm:ss.ms),Angle (deg)", "Time [hh:mm:ss],Angle [deg]", "Timestamp (UTC),Angle (deg)"
    )
    write(path, [[s, f"{v:.3f}"] for s, v in zip(stamps, noisy(draw, motion.x) * DEG, strict=True)], head)
    return motion.right("angle", "deg")


@kind("pumped", "pushed up by a hand over several periods, let swing, twice")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    w = 2 * np.pi / motion.period
    up = np.arange(int(draw.pick(6, 10) * motion.period * motion.rate)) / motion.rate
    ramp = motion.start * (up / up[-1]) * np.cos(w * (up - up[-1] - 1 / motion.rate))
    one = np.concatenate([ramp, motion.x])
    x = np.concatenate([one, one])
    save(path, draw, np.arange(x.size) / motion.rate, noisy(draw, x))
    return Right("angle", "rad", motion.period, motion.zeta, decays=2, words=PUSHED)


@kind("pushed_again", "a push in the middle of a decay")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, falls=4.0)
    w = 2 * np.pi / motion.period
    again = decay_at(motion.time, w, motion.zeta, motion.start)[0]
    x = np.concatenate([motion.x, again])
    save(path, draw, np.arange(x.size) / motion.rate, noisy(draw, x))
    return Right("angle", "rad", motion.period, motion.zeta, decays=2, words=PUSHED)


@kind("cell_runs.mat", "MATLAB: a cell of runs, or y and fs of each in a struct")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = noisy(draw, motion.x)
    content = draw.pick(
        {"y": x, "fs": motion.rate},
        {"run": {"signal": x, "samplerate": motion.rate}},
        {"theta": x, "time": motion.time, "note": "third run", "g": 9.81},
    )
    savemat(path, content)
    return Right(
        "displacement" if "theta" not in content else "angle",
        "au" if "theta" not in content else "rad",
        motion.period,
        motion.zeta,
        motion.start,
    )


@kind("two_tables.xlsx", "Excel: two runs side by side, an empty column between")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25, 40), falls=5.0)
    columns = [motion.time, noisy(draw, motion.x) * DEG]
    rows: list[list[object]] = [
        [float(t), float(x), None, float(t), float(0.8 * x)] for t, x in zip(*columns, strict=True)
    ]
    head: list[list[object]] = [
        ["Run 1", None, None, "Run 2", None],
        ["Time (s)", "Angle (deg)", None, "Time (s)", "Angle (deg)"],
    ]
    book(path, {"Sheet1": [*head, *rows]})
    return motion.right("angle", "deg", decays=2)


@kind("several_defects", "a hand, spikes, missing values, a coarse sensor, an uneven clock at once")
def _(path: Path, draw: Draw) -> Right:
    release = draw.within(1.5, 4.0)
    motion = swing(draw, release=release, samples=(50, 100))
    x = held_by_hand(draw, motion, release)
    step = motion.start / 150
    x = np.round(noisy(draw, x) / step) * step
    x[draw.rng.choice(x.size, 3, replace=False)] += draw.pick(3.0, -4.0)
    rows = cells("%.2f %.4f" if motion.rate < 50 else "%.3f %.4f", motion.time, 10.0 + x * DEG)
    for row in draw.rng.choice(len(rows), 8, replace=False):
        rows[row][1] = draw.pick("", "NaN", "--")
    write(
        path,
        rows,
        draw.pick("Zeit [s];Winkel [°]", "t (s);angle (deg)"),
        ";",
        comma=draw.pick(True, False),
        end="\r\n",
    )
    return motion.right("angle", "deg")


@kind("mixture", "style, language, unit, delimiter, clock and columns beside it drawn each")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(30.0, 50.0, 97.0, 100.0, 250.0), period=(0.9, 2.2))
    quantity, name, unit, scale, result = draw.pick(
        ("angle", "Angle", "deg", DEG, "deg"),
        ("angle", "Winkel", "°", DEG, "deg"),
        ("angle", "ángulo", "rad", 1.0, "rad"),
        ("displacement", "Position", "cm", 8.0, "cm"),
        ("displacement", "Spannung", "Volt", 2.0, "V"),
        ("displacement", "élongation", "mm", 60.0, "mm"),
        ("rate", "Angular velocity", "deg/s", DEG, "deg/s"),
        ("rate", "omega", "rad·s⁻¹", 1.0, "rad/s"),
        ("acceleration", "a", "m/s²", 0.05, "m/s^2"),
    )
    signal = {"rate": motion.v, "acceleration": motion.a}.get(quantity, motion.x)
    y = scale * (signal + draw.noise(signal.size, 2e-3 * np.abs(signal).max()))
    form = draw.pick("%s (%s)", "%s [%s]", "%s / %s", "%s in %s", "Run 1: %s (%s)", "Latest: %s (%s)")
    factor, clock = draw.pick((1.0, "s"), (1e3, "ms"), (1.0, "sec"))
    digits = {"ms": 0, "s": 3, "sec": 4}[clock]
    sep = draw.pick(",", ";", "\t")
    comma = sep != "," and draw.pick(True, False)
    columns = [factor * (motion.time + draw.pick(0.0, 12.345, 900.0)), y]
    heads, formats = (
        [form % (draw.pick("Time", "t", "Zeit", "temps"), clock), form % (name, unit)],
        [f"%.{digits}f", "%.6g"],
    )
    if draw.pick(True, False):
        columns.insert(1, 21 + 0.01 * np.cumsum(draw.noise(y.size, 0.05)))
        heads.insert(1, form % ("Temperatur", "°C"))
        formats.insert(1, "%.2f")
    if draw.pick(True, False):
        columns.append(0.0 * y)
        heads.append(form % ("Trigger", "V"))
        formats.append("%.0f")
    write(
        path,
        cells(" ".join(formats), *columns),
        draw.pick("", "Versuch 3\n", "# operator: n. n.\n") + sep.join(heads),
        sep,
        comma=comma,
        encoding=draw.pick("utf-8", "utf-8-sig", "utf-16"),
    )
    return motion.right(quantity, result, 1.0 if quantity == "angle" else scale)
