"""How laboratories spell units, clocks and names."""

import numpy as np

from benchmarks.contact.writing import DEG

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
RATES = {
    "rad/s": (1.0, ("(rad/s)", "[rad/s]", "(rad s^-1)", "[rad·s⁻¹]", "(rad/sec)", "in rad/s")),
    "deg/s": (DEG, ("(°/s)", "[deg/s]", "(dps)", "(deg s⁻¹)", "(degrees/s)", "(deg/sec)")),
}
CLOCKS = (
    (1.0, ("Time [sec]", "t / s", "time (seconds)", "Zeit in Sekunden", "elapsed_s", "Time(s)")),
    (1e3, ("Time [ms]", "t_ms", "time (msec)", "Zeit in ms", "time (milliseconds)", "millis")),
    (1e6, ("Time [µs]", "t_us", "time (us)", "t/μs", "micros")),
    (1.0 / 60.0, ("Time [min]", "time (minutes)")),
)
# Time, its unit, name, its unit.
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
# Quantity, name, unit, scale, unit as it is read.
MIXTURES = (
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
# Whether it was pushed or two modes beat cannot always be told: what was seen, and what to do, may be said.
PUSHED = ("pushed; end the window before, or start it after",)


def known(unit: str) -> str:
    """The unit of an angle as it is read."""
    of_degrees = ("deg", "°", "Grad", "degrés", "grados", "gradi", "graus", "graden", "grader")
    return "deg" if unit in of_degrees else unit


def clock_times(seconds: np.ndarray, form: str) -> list[str]:
    """Times of the day, to the ms: minutes m, seconds s, their whole part and thousandths ms."""
    times = [divmod(round(1000 * t), 60_000) for t in seconds]
    return [form.format(m=m, s=rest / 1000, whole=rest // 1000, ms=rest % 1000) for m, rest in times]


def iso_stamps(seconds: np.ndarray, form: str) -> list[str]:
    """Dates and times; `{0}` the date, `{2}` with strokes, `{1}` the time."""
    at = np.datetime64("2019-03-12T23:59:40.000") + np.round(1000 * seconds).astype("m8[ms]")
    return [form.format(day, clock, day.replace("-", "/")) for day, clock in (str(t).split("T") for t in at)]


def dates(seconds: np.ndarray) -> list[object]:
    """Dates of a spreadsheet."""
    return (np.datetime64("2019-03-12T14:02:33.000") + np.round(1000 * seconds).astype("m8[ms]")).tolist()


def decimal_commas(values: np.ndarray) -> list[str]:
    return [f"{value:.3f}".replace(".", ",") for value in values]


def grouped(values: np.ndarray, marks: str) -> list[str]:
    """Signs of thousands and of decimals."""
    return [f"{value:,.3f}".translate(str.maketrans(",.", marks)) for value in values]


def lvm(samples: int, rate: float, sign: str, columns: str) -> str:
    """The head of a LabVIEW measurement file."""
    step = f"{1.0 / rate:.6f}".replace(".", sign)
    date = "Date\t2019/03/12{0}\nTime\t14:02:33,1234567{0}\n"
    return (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t{sign}\nMulti_Headings\tYes\nX_Columns\t{columns}\nTime_Pref\tRelative\n"
        f"Operator\tlab\n{date.format('')}***End_of_Header***\t\n\t\nChannels\t1\t\nSamples\t{samples}\t\n"
        f"{date.format(chr(9))}Y_Unit_Label\tVolts\t\nX_Dimension\tTime\t\nX0\t0{sign}0000000000000000E+0\t\n"
        f"Delta_X\t{step}\t\n***End_of_Header***\t\t\nX_Value\tVoltage\tComment"
    )
