"""Kinds of text files: instruments, languages, units, clocks, layouts."""

from pathlib import Path

import numpy as np

from benchmarks.contact.writing import DEG, GRAVITY, Draw, Right, cells, kind, swing, write

ANGLES = {"rad": 1.0, "deg": DEG, "mrad": 1e3}
ANGLE_SPELLINGS = {
    "rad": ("[rad]", "(rad)", "in rad", "/ rad", "(radians)", "/rad"),
    "deg": ("[°]", "(°)", "(degrees)", "(deg)", "in deg", "/ °", "in Grad", "[grados]", "(degrés)", "[deg.]"),
    "mrad": ("[mrad]", "(mrad)", "/ mrad"),
}
LENGTHS = {
    "m": (0.05, ("(m)", "[m]", "/ m", "in m", "(meters)")),
    "cm": (5.0, ("(cm)", "[cm]", "/ cm", "in cm", "(centimeters)")),
    "mm": (50.0, ("(mm)", "[mm]", "/ mm", "in mm", "(millimeters)", "_mm")),
    "µm": (800.0, ("(µm)", "[um]", "/ μm", "(microns)")),
    "px": (300.0, ("(px)", "[pixel]", "(pixels)", "in px")),
    "V": (3.0, ("(V)", "[Volt]", "/ V", "(volts)", "in Volt")),
    "mV": (900.0, ("(mV)", "[mV]", "/ mV")),
    "au": (400.0, ("(a.u.)", "[au]", "(counts)", "[arb. units]", "(ADC)")),
}
ACCELERATIONS = ("m/s²", "m/s^2", "m s^-2", "m·s⁻²", "m/s/s", "m/s2", "ms⁻²", "m.s-2")
RATES = {
    "rad/s": (1.0, ("(rad/s)", "[rad/s]", "(rad s^-1)", "[rad·s⁻¹]", "(rad/sec)", "in rad/s")),
    "deg/s": (DEG, ("(°/s)", "[deg/s]", "(dps)", "(deg s⁻¹)", "(degrees/s)", "(deg/sec)")),
}


def fine(draw: Draw, x: np.ndarray, scale: float) -> np.ndarray:
    """Angles in another unit, with noise."""
    return scale * (x + draw.noise(x.size, 1e-3))


@kind("angle_units", "spellings of the unit of an angle")
def _(path: Path, draw: Draw) -> Right:
    unit = draw.pick("rad", "deg", "deg", "mrad")
    motion = swing(draw)
    name = draw.pick("Angle", "theta", "phi", "Theta_1", "alpha", "Angular position")
    head = f"{draw.pick('Time (s)', 't [s]', 't/s', 'time in s')},{name} {draw.pick(*ANGLE_SPELLINGS[unit])}"
    write(path, cells("%.4f %.6g", motion.time, fine(draw, motion.x, ANGLES[unit])), head)
    return motion.right("angle", unit)


@kind("length_units", "spellings of the unit of a displacement")
def _(path: Path, draw: Draw) -> Right:
    unit = draw.pick(*LENGTHS)
    scale, spellings = LENGTHS[unit]
    motion = swing(draw)
    name = draw.pick("Displacement", "x", "Position", "Signal", "Channel 1", "Laser", "Sensor")
    sep = draw.pick(",", ";", "\t")
    head = sep.join([draw.pick("Time (s)", "t [s]", "time"), f"{name} {draw.pick(*spellings)}"])
    offset = draw.within(-2.0, 2.0) * scale
    write(path, cells("%.4f %.7g", motion.time, offset + fine(draw, motion.x, scale)), head, sep)
    return motion.right("displacement", unit, scale)


@kind("acceleration_units", "spellings of m/s^2 and g, an axis of gravity beside it")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, period=(0.3, 0.9), start=(0.02, 0.06))
    unit = draw.pick(*ACCELERATIONS, "g", "g")
    scale = 1.0 / GRAVITY if unit == "g" else 1.0
    a = scale * (motion.a + draw.noise(motion.a.size, 0.01 * np.abs(motion.a).max()))
    rest = scale * (GRAVITY + draw.noise(a.size, 0.01))
    name = draw.pick("Acceleration", "a", "acc", "Linear Acceleration")
    head = f'"Time (s)","{name} x ({unit})","{name} z ({unit})"'
    write(path, cells("%.6e %.9e %.9e", motion.time, a, rest), head)
    return motion.right("acceleration", "g" if unit == "g" else "m/s^2", 1.0)


@kind("rate_units", "spellings of the unit of a rate, with a bias")
def _(path: Path, draw: Draw) -> Right:
    unit = draw.pick(*RATES)
    scale, spellings = RATES[unit]
    motion = swing(draw)
    name = draw.pick("Gyro y", "omega", "Angular velocity", "wz", "Rotation rate", "Gyroscope z")
    head = f"{draw.pick('Time (s)', 't [s]')},{name} {draw.pick(*spellings)}"
    rate = scale * (motion.v + 0.01 + draw.noise(motion.v.size, 0.01))
    write(path, cells("%.5f %.7g", motion.time, rate), head)
    return motion.right("rate", unit)


@kind("time_units", "spellings of the unit of time")
def _(path: Path, draw: Draw) -> Right:
    factor, spellings = draw.pick(
        (1.0, ("Time [sec]", "t / s", "time (seconds)", "Zeit in Sekunden", "elapsed_s", "Time(s)")),
        (1e3, ("Time [ms]", "t_ms", "time (msec)", "Zeit in ms", "time (milliseconds)", "millis")),
        (1e6, ("Time [µs]", "t_us", "time (us)", "t/μs", "micros")),
        (1.0 / 60.0, ("Time [min]", "time (minutes)")),
    )
    motion = swing(draw)
    head = f"{draw.pick(*spellings)},Angle (rad)"
    write(path, cells("%.10g %.5f", factor * motion.time, fine(draw, motion.x, 1.0)), head)
    return motion.right("angle", "rad")


@kind("loggerpro", "LoggerPro: groups before the names, a rate beside the angle")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit = draw.pick("rad", "°")
    scale = 1.0 if unit == "rad" else DEG
    group = draw.pick("Latest: ", "Run 1: ", "Data Set: ", "Data Set 1:")
    sep = draw.pick(",", "\t")
    space = draw.pick(" ", "")
    head = sep.join(
        f'"{group}{text}"'
        for text in (f"Time{space}(s)", f"Angle{space}({unit})", f"Velocity{space}({unit}/s)")
    )
    columns = motion.time, fine(draw, motion.x, scale), scale * motion.v
    write(path, cells("%.4f %.5f %.4f", *columns), head, sep, end="\r\n")
    return motion.right("angle", "rad" if unit == "rad" else "deg")


@kind("vernier_format", "Vernier Format 2: names, short names and units in rows of their own")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(("m", 0.1), ("cm", 8.0), ("mm", 30.0))
    head = f"Vernier Format 2\nrun.txt 10/1/2019 14:02:33 .\nRun {draw.pick(1, 3)}\n"
    head += f"Time\tPosition\tVelocity\nt\tx\tv\ns\t{unit}\t{unit}/s\n"
    columns = motion.time, scale * 4.0 + fine(draw, motion.x, scale), scale * motion.v
    write(path, cells("%.4f %.5f %.5f", *columns), head, "\t", end="\r\n")
    return motion.right("displacement", unit, scale)


@kind("capstone", "Capstone: the run in the head, empty cells where a run is shorter")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(("rad", 1.0), ("°", DEG), ("deg", DEG))
    run = draw.pick("Run #1", "Run #7")
    head = draw.pick(
        f"Time (s) {run},Angle ({unit}) {run}",
        f"{run},{run}\nTime (s),Angle ({unit})",
        f'"Time (s) {run}","Angle, Ch P1 ({unit}) {run}"',
    )
    write(path, cells("%.4f %.5f", motion.time, fine(draw, motion.x, scale)), head)
    return motion.right("angle", "rad" if unit == "rad" else "deg")


@kind("datastudio", "DataStudio: title, blanks within the brackets")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(("rad", 1.0), ("deg", DEG))
    head = f"Angular Position, Ch 1&2, Run #{draw.pick(1, 2)}\nTime ( s )\tAngular Position ( {unit} )"
    write(path, cells("%.4f %.4f", motion.time, fine(draw, motion.x, scale)), head, "\t", end="\r\n")
    return motion.right("angle", unit)


@kind("tracker_polar", "Tracker: track, then t x y r and theta with an index")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25.0, 50.0))
    length = draw.within(0.3, 1.5)
    angle = motion.x + draw.noise(motion.x.size, 1e-3)
    theta, unit = draw.pick((angle * DEG, "°"), (angle, "rad"), (angle * DEG, ""))
    name = draw.pick("θ", "θ_{r}", "theta")
    columns = motion.time, length * np.sin(angle), -length * np.cos(angle), np.full(angle.size, length), theta
    comma = draw.pick(True, False)
    sep = ";" if comma else draw.pick("\t", ",", ";")
    named = f"{name} ({unit})" if unit else name
    head = f"mass A{sep * 4}\n" + sep.join(["t", "x", "y", "r", named])
    write(path, cells("%.5f %.5f %.5f %.5f %.5f", *columns), head, sep, comma=comma)
    return motion.right("angle", "rad" if unit == "rad" else "deg")


@kind("phyphox_absolute", "phyphox: three axes and their absolute value, which swings twice as often")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    sep = draw.pick(",", ";", "\t")
    axis = draw.pick(0, 1, 2)
    axes = [0.002 * motion.v + 0.01 * k + draw.noise(motion.v.size, 0.004) for k in range(3)]
    axes[axis] = motion.v + draw.noise(motion.v.size, 0.004)
    axes.append(np.sqrt(sum(a**2 for a in axes)))
    head = sep.join(
        f'"{text}"' for text in ("Time (s)", *(f"Gyroscope {a} (rad/s)" for a in "xyz"), "Absolute (rad/s)")
    )
    write(
        path, cells("%.9e " * 5, motion.time, *axes), head, sep, comma=sep == ";" and draw.pick(True, False)
    )
    return motion.right("rate", "rad/s")


@kind("phyphox_with_g", "phyphox: acceleration with g of a mass on a spring, absolute value")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, period=(0.4, 0.9), start=(0.01, 0.04))
    axis = draw.pick(1, 2)
    a = motion.a + draw.noise(motion.a.size, 0.02)
    axes = [0.02 * a + 0.1 + draw.noise(a.size, 0.02) for _ in range(3)]
    axes[axis] = GRAVITY + a
    axes.append(np.sqrt(sum(one**2 for one in axes)))
    head = ",".join(
        f'"{text}"'
        for text in (
            "Time (s)",
            *(f"Acceleration {k} (m/s^2)" for k in "xyz"),
            "Absolute acceleration (m/s^2)",
        )
    )
    write(path, cells("%.9e " * 5, motion.time, *axes), head)
    return motion.right("acceleration", "m/s^2")


@kind("cassy", "CASSY: units after a stroke, Greek letters, decimal commas")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    name, unit, scale, quantity = draw.pick(
        ("α", "°", DEG, "angle"),
        ("β", "°", DEG, "angle"),
        ("φ", "rad", 1.0, "angle"),
        ("s_A1", "mm", 40.0, "displacement"),
        ("U_B1", "V", 3.0, "displacement"),
    )
    note = draw.pick("", "MIN=0\tMAX=20\nDEC=3\n")
    write(
        path,
        cells("%.3f %.5f", motion.time, fine(draw, motion.x, scale)),
        f"{note}t / s\t{name} / {unit}",
        "\t",
        comma=True,
        encoding=draw.pick("utf-8", "utf-16"),
    )
    return motion.right(
        quantity, "deg" if unit == "°" else unit, scale if quantity == "displacement" else 1.0
    )


@kind("arduino_monitor", "Arduino's serial monitor: clock times and an arrow before the values")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(50.0, 100.0))
    stamps = [f"14:{int(s // 60) + 2:02d}:{s % 60:06.3f}" for s in motion.time]
    adc = np.round(512 + 400 * motion.x)
    write(
        path,
        [[f"{s} -> {v:.0f}"] for s, v in zip(stamps, adc, strict=True)],
        draw.pick("", "14:01:58.001 -> Calibrating", "14:01:58.001 -> ready"),
    )
    return (
        motion.right("angle", "", np.nan, options={"units": "counts"})
        if False
        else Right(
            "displacement", "au", motion.period, motion.zeta, 400 * motion.start, options={"units": "counts"}
        )
    )


@kind("arduino_log", "Arduino: a greeting, then millis and counts")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(50.0, 100.0, 200.0))
    adc = np.round(512 + 400 * motion.x)
    head = draw.pick("Pendulum logger v1.2\nready\nmillis,adc", "Starting...\nmillis,adc", "millis,pot")
    write(path, cells("%d %d", np.round(1000 * motion.time) + 1832, adc), head, end="\r\n")
    return motion.right("displacement", "au", 400.0)


@kind("arduino_plotter", "Arduino's serial plotter: a label before each value")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    sep = draw.pick(",", "\t", " ")
    x = fine(draw, motion.x, DEG)
    write(path, [[f"time:{s:.4f}", f"angle:{v:.2f}"] for s, v in zip(motion.time, x, strict=True)], sep=sep)
    return motion.right("angle", "deg")


@kind("lvm", "LabVIEW measurement file, its times in the first column")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    _lvm(path, draw, motion, fine(draw, motion.x, 3.0), times=True)
    return motion.right("displacement", "V", 3.0)


@kind("lvm_no_times", "LabVIEW measurement file without times: Delta_X in its head")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    _lvm(path, draw, motion, fine(draw, motion.x, 3.0), times=False)
    return motion.right("displacement", "V", 3.0)


def _lvm(path: Path, draw: Draw, motion: object, values: np.ndarray, *, times: bool) -> None:
    comma = draw.pick(True, False)
    sign = "," if comma else "."
    step = f"{1.0 / motion.rate:.6f}".replace(".", sign)  # type: ignore[attr-defined]
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t{sign}\nMulti_Headings\tYes\nX_Columns\t"
        f"{'One' if times else 'No'}\nTime_Pref\tRelative\n"
        "Operator\tlab\nDate\t2019/03/12\nTime\t14:02:33,1234567\n***End_of_Header***\t\n\t\nChannels\t1\t\n"
        f"Samples\t{values.size}\t\nDate\t2019/03/12\t\nTime\t14:02:33,1234567\t\n"
        "Y_Unit_Label\tVolts\t\nX_Dimension\tTime\t\n"
        f"X0\t0{sign}0000000000000000E+0\t\nDelta_X\t{step}\t\n***End_of_Header***\t\t\nX_Value\tVoltage\tComment"
    )
    stamps = [f"{t:.6f}" for t in motion.time] if times else [""] * values.size  # type: ignore[attr-defined]
    write(
        path,
        [[t, f"{v:.6f}"] for t, v in zip(stamps, values, strict=True)],
        head,
        "\t",
        comma=comma,
        end="\r\n",
    )


LANGUAGES = (
    ("Zeit", "s", "Auslenkung", "mm"),
    ("Zeit", "s", "Winkel", "Grad"),
    ("Zeit", "s", "Weg", "cm"),
    ("Zeit", "s", "Auslenkwinkel", "°"),
    ("temps", "s", "angle", "degrés"),
    ("Temps", "s", "élongation", "cm"),
    ("Temps", "s", "position", "mm"),
    ("temps", "s", "angle", "°"),
    ("tiempo", "s", "ángulo", "grados"),
    ("Tiempo", "s", "posición", "cm"),
    ("tiempo", "s", "angulo", "rad"),
    ("tempo", "s", "angolo", "gradi"),
    ("Tempo", "s", "posizione", "mm"),
    ("tempo", "s", "ângulo", "graus"),
    ("tijd", "s", "hoek", "graden"),
    ("tid", "s", "vinkel", "grader"),
    ("czas", "s", "kąt", "rad"),
    ("Zeit", "ms", "Spannung", "V"),
)


@kind("languages", "names in other languages, decimal commas")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    time, clock, name, unit = draw.pick(*LANGUAGES)
    known = {
        "Grad": "deg",
        "degrés": "deg",
        "grados": "deg",
        "gradi": "deg",
        "graus": "deg",
        "graden": "deg",
        "grader": "deg",
        "°": "deg",
    }
    scale = {"mm": 40.0, "cm": 6.0, "V": 3.0, "rad": 1.0}.get(unit, DEG)
    form = draw.pick("%s (%s)", "%s [%s]", "%s in %s", "%s / %s")
    head = f"{form % (time, clock)};{form % (name, unit)}"
    factor = 1e3 if clock == "ms" else 1.0
    encoding = (
        draw.pick("utf-8", "utf-8-sig", "utf-16")
        if name == "kąt"
        else draw.pick("utf-8", "latin-1", "utf-8-sig")
    )
    write(
        path,
        cells("%.4f %.4f", factor * motion.time, fine(draw, motion.x, scale)),
        head,
        ";",
        comma=True,
        encoding=encoding,
    )
    angle = unit not in ("mm", "cm", "V")
    return motion.right("angle" if angle else "displacement", known.get(unit, unit), 1.0 if angle else scale)


@kind("languages_bare", "names in other languages without units, angles beyond pi: degrees")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, start=(0.3, 0.7))
    time, name = draw.pick(
        ("Zeit", "Winkel"),
        ("temps", "angle"),
        ("tiempo", "angulo"),
        ("tempo", "angolo"),
        ("tijd", "hoek"),
        ("tid", "vinkel"),
        ("t", "φ"),
    )
    write(path, cells("%.4f %.4f", motion.time, fine(draw, motion.x, DEG)), f"{time};{name}", ";", comma=True)
    return motion.right("angle", "deg")


@kind("units_own_row", "units on a row of their own, in brackets or not")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    sep = draw.pick(",", ";", "\t")
    unit, scale, quantity = draw.pick(
        ("deg", DEG, "angle"), ("rad", 1.0, "angle"), ("mm", 50.0, "displacement"), ("V", 3.0, "displacement")
    )
    name = "Angle" if quantity == "angle" else "Signal"
    clock, factor = draw.pick(("s", 1.0), ("ms", 1e3))
    form = draw.pick("[%s]", "(%s)", "%s")
    head = f"Time{sep}{name}\n{form % clock}{sep}{form % unit}{draw.pick('', chr(10))}"
    write(path, cells("%.4f %.5f", factor * motion.time, fine(draw, motion.x, scale)), head, sep)
    return motion.right(quantity, unit, 1.0 if quantity == "angle" else scale)


@kind("time_last", "the time in the last column")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(("deg", DEG), ("rad", 1.0))
    battery = 7.4 - motion.time / 300
    head = draw.pick(f"angle ({unit}),battery (V),time (s)", f"angle [{unit}],battery [V],t [s]")
    write(path, cells("%.5f %.2f %.4f", fine(draw, motion.x, scale), battery, motion.time), head)
    return motion.right("angle", unit)


@kind("no_header", "numbers alone")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    scale = draw.pick(1.0, DEG)
    sep = draw.pick(",", ";", "\t", " ", "   ")
    write(path, cells("%.4f %.5f", motion.time, fine(draw, motion.x, scale)), sep=sep, comma=sep == ";")
    return motion.right("angle", "rad" if scale == 1.0 else "deg")


@kind("no_header_index", "an index, the time, the angle, without names")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    scale = draw.pick(1.0, DEG)
    first = draw.pick(0, 1)
    write(
        path,
        cells("%d %.4f %.5f", range(first, first + motion.x.size), motion.time, fine(draw, motion.x, scale)),
        sep=draw.pick(",", "\t"),
    )
    return motion.right("angle", "rad" if scale == 1.0 else "deg")


@kind("no_header_time_last", "the angle, then the time, without names")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    write(path, cells("%.5f %.4f", fine(draw, motion.x, 1.0), motion.time), sep=draw.pick(",", "\t", " "))
    return motion.right("angle", "rad")


@kind("pandas_index", "pandas: a nameless index before time and angle")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    head = draw.pick(",time,angle", ",t,theta", "Unnamed: 0,time (s),theta (rad)")
    write(
        path,
        cells("%d %r %r", range(motion.x.size), motion.time.tolist(), fine(draw, motion.x, 1.0).tolist()),
        head,
    )
    return motion.right("angle", "rad")


@kind("epoch_ms", "milliseconds since 1970")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(50.0, 100.0, 125.0))
    stamps = draw.pick(1_552_399_353_120, 1_712_345_678_004) + np.round(1e3 * motion.time)
    head = draw.pick("", "timestamp,angle", "time,theta_rad", "ts,angle")
    write(path, cells("%d %.5f", stamps, fine(draw, motion.x, 1.0)), head)
    return motion.right("angle", "rad")


@kind("iso_stamps", "dates and times as ISO 8601 or nearly so")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(20.0, 50.0, 100.0))
    day = np.datetime64("2019-03-12T23:59:40.000")
    stamps = [str(day + np.timedelta64(round(1000 * s), "ms")) for s in motion.time]
    form = draw.pick(
        lambda s: s,
        lambda s: s + "Z",
        lambda s: s.replace("T", " "),
        lambda s: s + "+01:00",
        lambda s: s.replace("T", " ").replace("-", "/"),
    )
    head = draw.pick(
        "timestamp,angle (deg)", "Date Time,Angle (deg)", "time,angle_deg", "datetime,theta (deg)"
    )
    write(path, [[form(s), f"{v:.3f}"] for s, v in zip(stamps, fine(draw, motion.x, DEG), strict=True)], head)
    return motion.right("angle", "deg")


@kind("clock_times", "h:m:s, m:s, with AM or PM, or decimal commas")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(20.0, 50.0, 100.0))
    form = draw.pick(
        lambda s: f"12:{int(s // 60):02d}:{s % 60:06.3f}",
        lambda s: f"{int(s // 60):02d}:{s % 60:06.3f}",
        lambda s: f"2:{int(s // 60):02d}:{s % 60:06.3f} PM",
        lambda s: f"00:{int(s // 60):02d}:{int(s % 60):02d}:{round(s % 1 * 1000):03d}",
        lambda s: f"12:{int(s // 60):02d}:{s % 60:06.3f}".replace(".", ","),
    )
    head = draw.pick("Time;Angle (deg)", "Uhrzeit;Winkel (°)", "hora;ángulo (grados)")
    write(
        path,
        [
            [form(round(s, 3)), f"{v:.3f}"]
            for s, v in zip(motion.time, fine(draw, motion.x, DEG), strict=True)
        ],
        head,
        ";",
    )
    return motion.right("angle", "deg")


@kind("date_and_time", "the date and the time of the day in two columns")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, clock=draw.pick(20.0, 50.0))
    date = draw.pick("2019-03-12", "12.03.2019", "03/12/2019", "12/03/2019")
    rows = [
        [date, f"14:{int(s // 60):02d}:{s % 60:06.3f}", f"{v:.3f}"]
        for s, v in zip(motion.time, fine(draw, motion.x, DEG), strict=True)
    ]
    write(
        path, rows, draw.pick("Date,Time,Angle (deg)", "Datum,Uhrzeit,Winkel (Grad)", "date,time,theta_deg")
    )
    return motion.right("angle", "deg")


@kind("comment_rate", "the rate in a comment, one column")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rate = f"{motion.rate:g}"
    line = draw.pick(
        f"# fs = {rate} Hz",
        f"% Sampling rate: {rate} Hz",
        f"# sample_rate={rate}",
        f"# Abtastrate: {rate} Hz",
        f"# dt = {1 / motion.rate:.9g} s",
        f"# Sampling interval: {1e3 / motion.rate:.9g} ms",
        f"# {rate} fps",
        f"# frame rate {rate} fps",
        f"# sampling frequency (Hz): {rate}",
        f"# {rate} samples/s",
    )
    mark = line[0]
    write(
        path,
        cells("%.5f", fine(draw, motion.x, 1.0)),
        f"{mark} torsion rig, run 12\n{line}\n{mark} unit: rad",
    )
    return motion.right("angle", "rad")


@kind("trailing_text", "a summary below the numbers")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    tail = draw.pick(
        "\nMean,0.0012\nStd,0.1",
        "# end of measurement",
        "Statistics\nMin,-0.3\nMax,0.4\nN,2000",
        "End of file",
        "\n\nMeasurement stopped by user",
    )
    write(path, cells("%.4f %.5f", motion.time, fine(draw, motion.x, 1.0)), "Time (s),Angle (rad)", tail=tail)
    return motion.right("angle", "rad")


@kind("text_within", "a line of text among the rows, a comment column")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rows = cells("%.4f %.5f", motion.time, fine(draw, motion.x, 1.0))
    if draw.pick(True, False):
        rows = [[*row, "released" if n == 40 else ""] for n, row in enumerate(rows)]
        write(path, rows, "Time (s),Angle (rad),Comment")
    else:
        rows.insert(len(rows) // 3, [draw.pick("# marker", "# --- event 1 ---")])
        write(path, rows, "Time (s),Angle (rad)")
    return motion.right("angle", "rad")


@kind("nan_spellings", "missing values in many spellings")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(60.0, 120.0))
    rows = cells("%.4f %.5f", motion.time, fine(draw, motion.x, 1.0))
    text = draw.pick(
        "NaN",
        "nan",
        "",
        "NA",
        "N/A",
        "#N/A",
        "-",
        "null",
        "1.#QNAN",
        "-1.#IND",
        "NaN(char)",
        "?",
        "***",
        "missing",
        "OVL",
        "#VALUE!",
        "nan ",
    )
    for row in draw.rng.choice(len(rows), 12, replace=False):
        rows[row][1] = text
    write(path, rows, "Time (s),Angle (rad)")
    return motion.right("angle", "rad")


@kind("quoted", "quoted cells, a delimiter at the end of each row")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rows = [[f'"{c}"' for c in row] for row in cells("%.4f %.3f", motion.time, fine(draw, motion.x, DEG))]
    end = draw.pick("", ",")
    write(path, rows, f'"Time (s)","Angle (deg)"{end}', end=f"{end}\n")
    return motion.right("angle", "deg")


@kind("quoted_commas", "decimal commas within quotes between commas")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    rows = [
        [f'"{c.replace(".", ",")}"' for c in row]
        for row in cells("%.4f %.3f", motion.time, fine(draw, motion.x, DEG))
    ]
    write(path, rows, '"Zeit (s)","Winkel (°)"')
    return motion.right("angle", "deg")


@kind("metadata", "many lines of notes with numbers and stops in them")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    notes = draw.pick(
        "Operator: n. n.\nDate: 12.03.2019\nLength: 1.18 m\nMass: 0.250 kg\n",
        "Instrument,XR-7\nSerial,0012\nGain,2.0\nRange,10\nPoints,2000\n",
        "# mass 0.2 kg\n# length, m: 0.41\n\n",
        "[Header]\nVersion=3\nChannels=2\nGain=1,1\n[Data]\n",
        "Sample,PDMS\nLoad,0.5,N\nRun,3\n\n",
    )
    write(path, cells("%.4f %.5f", motion.time, fine(draw, motion.x, 1.0)), f"{notes}Time (s),Angle (rad)")
    return motion.right("angle", "rad")


@kind("thousands", "signs of thousands, exponents, plus signs")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    x = fine(draw, motion.x, 3000.0)
    if draw.pick(True, False):
        write(
            path,
            [[f"{t:+.4E}", f"{v:+.6E}"] for t, v in zip(motion.time, x, strict=True)],
            "t [s]\tx [µm]",
            "\t",
        )
    else:
        write(
            path,
            [
                [f"{t:.3f}".replace(".", ","), f"{v:.2f}".replace(".", ",")]
                for t, v in zip(motion.time, x, strict=True)
            ],
            "t [s]\tx [µm]",
            "\t",
        )
    return motion.right("displacement", "µm", 3000.0)


@kind("run_pairs", "several runs side by side, in pairs of time and angle")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    count = draw.pick(2, 3)
    unit, scale = draw.pick(("rad", 1.0), ("deg", DEG))
    form = draw.pick("Run %d: %s", "Data Set %d: %s", "Run #%d: %s", "%s Run #%d")
    names = []
    for run in range(1, count + 1):
        for name in ("Time (s)", f"Angle ({unit})"):
            names.append(form % ((name, run) if form.startswith("%s") else (run, name)))
    columns = [c for _ in range(count) for c in (motion.time, fine(draw, motion.x, scale))]
    write(path, cells("%.4f %.4f " * count, *columns), ",".join(f'"{n}"' for n in names))
    return motion.right("angle", unit, decays=count)


@kind("two_swing", "two columns that swing with other periods: a choice")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    factor = draw.within(1.3, 1.7)
    other = np.interp(motion.time / factor, motion.time, motion.x)
    pair = draw.pick(
        ("Angle A (deg)", "Angle B (deg)"),
        ("Winkel links (°)", "Winkel rechts (°)"),
        ("theta1 (deg)", "theta2 (deg)"),
    )
    write(
        path,
        cells("%.4f %.3f %.3f", motion.time, fine(draw, motion.x, DEG), fine(draw, other, DEG)),
        f"Time (s),{pair[0]},{pair[1]}",
    )
    return Right(names=pair)


@kind("xy_no_origin", "x and y in px of a pendulum, the pivot elsewhere")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    reach = draw.within(150, 400)
    x = 400 + reach * np.sin(motion.x) + draw.noise(motion.x.size, 0.3)
    y = 60 + reach * np.cos(motion.x) + draw.noise(motion.x.size, 0.3)
    write(
        path,
        cells("%.4f %.1f %.1f", motion.time, x, y),
        draw.pick("t,x (px),y (px)", "frame_time (s),x [px],y [px]"),
    )
    return motion.right("displacement", "px", reach)


@kind("frames", "frame numbers as the clock, the rate in a note")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, samples=(25, 60))
    name = draw.pick("frame", "Frame", "frame number")
    head = f"# {draw.pick('fps', 'frame rate')}: {motion.rate:g}\n{name},x (px)"
    write(path, cells("%d %.2f", range(motion.x.size), 400 + fine(draw, motion.x, 300.0)), head)
    return motion.right("displacement", "px", 300.0)


@kind("ship", "roll among other degrees of freedom")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw, period=(1.5, 4.0), zeta=(0.02, 0.04), falls=15.0)
    roll = fine(draw, motion.x, DEG)
    beside = [0.02 * roll + draw.noise(roll.size, 0.02), draw.noise(roll.size, 0.05)]
    head = draw.pick(
        "Time [s],Pitch [deg],Roll [deg],Heave [m]",
        "t,pitch_deg,roll_deg,heave_m",
        "time;Pitch (°);Roll (°);Heave (m)".replace(";", ","),
    )
    write(path, cells("%.3f %.4f %.4f %.4f", motion.time, beside[0], roll, beside[1]), head)
    return motion.right("angle", "deg")


@kind("force_sensor", "a force sensor under the spring: a unit that is no length")
def _(path: Path, draw: Draw) -> Right:
    motion = swing(draw)
    unit, scale = draw.pick(
        ("N", 2.0), ("mN", 800.0), ("kg", 0.2), ("mbar", 30.0), ("Pa", 200.0), ("T", 0.01), ("mT", 5.0)
    )
    name = {"N": "Force", "mN": "Force", "kg": "Load", "mbar": "Pressure", "Pa": "Pressure"}.get(
        unit, "Magnetic field"
    )
    write(
        path,
        cells("%.4f %.6f", motion.time, 3 * scale + fine(draw, motion.x, scale)),
        f"Time (s),{name} ({unit})",
    )
    return motion.right("displacement", unit, scale)
