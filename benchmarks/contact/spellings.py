"""How laboratories spell units, clocks and names."""

import numpy as np


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
