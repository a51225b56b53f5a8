"""Files of the public benchmarks: where they are in a folder, what they must hold, and the official split.

The splits are those of the package `nonlinear_benchmarks`; the tests compare them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.public.signals import Array, Signals, Split, Test
from benchmarks.public.stand_ins import bouc_wen_training
from sysid_trib.errors import RecordError
from sysid_trib.records.tables import FileTable, read_table

# Samples of the whole record of Silverbox, as nonlinear_benchmarks splits it.
ARROW = slice(100, 40575)
MULTISINE = slice(40650, 127400)
WITHOUT_EXTRAPOLATION = 32000
TRAINING_SHARE = 0.75
SILVERBOX_SAMPLING_TIME = 1.0 / 610.35
SILVERBOX_START = 50

EMPS_START = 20
# SHA-256 of the file that holds the pulses, its beginning.
PULSES_CHECKSUM = "0eab75bb"

BOUC_WEN_SAMPLING_TIME = 1.0 / 750.0
PERIOD = 8192
# N: RMS of the multisine, amplitude of the sweep (Noel and Schoukens 2016); and the relative tolerance.
MULTISINE_RMS = 50.0
SWEEP_AMPLITUDE = 40.0
AMPLITUDE_TOLERANCE = 0.05

# Below it the official metrics have no NRMSE.
LEAST_DEVIATION = 1e-10

UNVERIFIED = "give --unverified to use it anyway, as a record that is not official"


@dataclass(frozen=True)
class Fingerprint:
    """Numbers that tell an official record from others, whatever its format and rounding.

    Parameters
    ----------
    first, end : int
        Samples from which they are computed.
    input_rms, output_rms, mean_product : float
        Of input and output, in the units of the file.
    """

    first: int
    end: int
    input_rms: float
    output_rms: float
    mean_product: float

    def fits(self, record: Signals) -> bool:
        """Return whether a record has these numbers, each to 0.1 % of its size."""
        u = record.u[self.first : self.end]
        y = record.y[self.first : self.end]
        errors = (
            np.sqrt(np.mean(u**2)) / self.input_rms - 1.0,
            np.sqrt(np.mean(y**2)) / self.output_rms - 1.0,
            (np.mean(u * y) - self.mean_product) / (self.input_rms * self.output_rms),
        )
        return len(u) == self.end - self.first and max(map(abs, errors)) < 1e-3


# Of samples 40,500 to 92,619, and of the whole of DATA_EMPS.mat: the parts that the project was given.
SILVERBOX_PRINT = Fingerprint(40_500, 92_620, 0.0230537269, 0.0545649980, 1.01934434e-4)
EMPS_PRINT = Fingerprint(0, 24_841, 1.53918424, 0.148831033, -0.0357192698)


@dataclass(frozen=True)
class Wanted:
    """A file of a benchmark.

    Parameters
    ----------
    names : tuple of str
        Names under which it is looked for, the official one first.
    places : tuple of str
        Folders in which it is looked for, that of the package `nonlinear_benchmarks` first.
    """

    names: tuple[str, ...]
    places: tuple[str, ...]

    def find(self, folder: Path) -> Path | None:
        """Return the file in a folder, or None if it is not there."""
        paths = (folder / place / name for place in self.places for name in self.names)
        return next((path for path in paths if path.exists()), None)


class MissingFileError(RecordError):
    """A file of a benchmark that is not in the folder.

    Parameters
    ----------
    wanted : sequence of Wanted
        Files of which any is sufficient.
    folder : Path
    """

    def __init__(self, wanted: Sequence[Wanted], folder: Path) -> None:
        names = [name for one in wanted for name in one.names]
        self.names = " or ".join(names)
        self.place = wanted[0].places[-2]
        super().__init__(f"{folder}: {self.names} is not there.")


_SILVERBOX = ("Silverbox/SilverboxFiles", "SilverboxFiles", "silverbox", "")
_EMPS = ("EMPS", "emps", "")
_SIGNALS_OF_BOUC_WEN = "BoucWenFiles/Test signals/Validation signals"
_BOUC_WEN = (f"BoucWen/{_SIGNALS_OF_BOUC_WEN}", _SIGNALS_OF_BOUC_WEN, "bouc_wen", "")
SILVERBOX = Wanted(("SNLS80mV.mat", "SNLS80mV.csv"), _SILVERBOX)
EMPS_TRAINING = Wanted(("DATA_EMPS.mat",), _EMPS)
EMPS_PULSES = Wanted(("DATA_EMPS_PULSES.mat",), _EMPS)
BOUC_WEN_TRAINING = Wanted(("train.csv", "train_data.csv"), ("bouc_wen", ""))


def _found(wanted: Sequence[Wanted], folder: Path) -> Path:
    """Return the first of these files that is in a folder.

    Raises
    ------
    MissingFileError
        None is there.
    """
    for one in wanted:
        path = one.find(folder)
        if path is not None:
            return path
    raise MissingFileError(wanted, folder)


def signals_of(path: Path, input_name: str, output_name: str, sampling_time: float) -> Signals:
    """Return two columns of a file.

    Raises
    ------
    RecordError
        They have no numbers, or differ in length.
    UsageError
        There is no such column.
    """
    table = read_table(path)
    return _of_table(table, input_name, output_name, sampling_time)


def _of_table(table: FileTable, input_name: str, output_name: str, sampling_time: float) -> Signals:
    """Return two columns of a table; see `signals_of`."""
    u = table.find(input_name).numbers
    y = table.find(output_name).numbers
    return _checked(table.source, u, y, sampling_time)


def _checked(source: str, u: Array, y: Array, sampling_time: float) -> Signals:
    """Return the signals of a file.

    Raises
    ------
    RecordError
        They are not finite, differ in length, or the output does not move.
    """
    if len(u) != len(y):
        raise RecordError(
            f"{source}: the input has {len(u)} samples and the output {len(y)}; fetch the file anew."
        )
    if not (np.all(np.isfinite(u)) and np.all(np.isfinite(y))):
        raise RecordError(f"{source}: it has samples that are no finite number; fetch the file anew.")
    if np.std(y) < LEAST_DEVIATION:
        raise RecordError(f"{source}: the output does not move; fetch the file anew.")
    return Signals(u.astype(float), y.astype(float), sampling_time)


def read_silverbox(folder: Path, *, verify: bool = True) -> Split:
    """Read the record of Silverbox: the arrow and the multisines.

    Raises
    ------
    RecordError
        A file is missing, unreadable, too short, or is not the official one.
    """
    path = _found((SILVERBOX,), folder)
    record = signals_of(path, "V1", "V2", SILVERBOX_SAMPLING_TIME)
    if len(record) < MULTISINE.stop:
        raise RecordError(
            f"{path}: it has {len(record)} samples, and the official split needs {MULTISINE.stop}; this is "
            "a part of the record, or another one."
        )
    if verify and not SILVERBOX_PRINT.fits(record):
        raise RecordError(f"{path}: V1 and V2 are not those of the official record; {UNVERIFIED}.")
    multisines = record.part(MULTISINE.start, MULTISINE.stop)
    end = int(TRAINING_SHARE * len(multisines))
    arrow = record.part(ARROW.start, ARROW.stop)
    tests = (
        Test("multisine", multisines.part(end), SILVERBOX_START),
        Test("arrow (full)", arrow, SILVERBOX_START),
        Test("arrow (no extrapolation)", arrow.part(0, WITHOUT_EXTRAPOLATION), SILVERBOX_START),
    )
    said = f"training: {end} samples of multisines, the official part"
    return Split(multisines.part(0, end), tests, said, verify)


def read_emps(folder: Path, *, verify: bool = True) -> Split:
    """Read both records of EMPS; the input is the force, that is the voltage times `gtau`.

    Raises
    ------
    RecordError
        A file is missing, unreadable, or is not the official one.
    """
    training_path = _found((EMPS_TRAINING,), folder)
    pulses_path = _found((EMPS_PULSES,), folder)
    volts, _ = _emps_record(training_path)
    if verify and not EMPS_PRINT.fits(volts):
        raise RecordError(f"{training_path}: vir and qm are not those of the official record; {UNVERIFIED}.")
    table = read_table(pulses_path)
    if verify and not table.checksum.startswith(PULSES_CHECKSUM):
        raise RecordError(
            f"{pulses_path}: its SHA-256 begins with {table.checksum[:8]}, that of the official file with "
            f"{PULSES_CHECKSUM}; {UNVERIFIED}."
        )
    training = emps_force(training_path)
    pulses = emps_force(pulses_path)
    tests = [Test("pulses", pulses, EMPS_START)]
    added = table.match("pulses_N")
    if added is not None:
        # The official loader gives vir alone. Whether vir contains the pulses is not documented.
        total = _checked(table.source, pulses.u + added.numbers, pulses.y, pulses.sampling_time)
        tests.append(Test("pulses, pulses_N added to the force", total, EMPS_START, submitted=False))
    said = "training: DATA_EMPS.mat, the official record"
    return Split(training, tuple(tests), said, verify)


def _emps_record(path: Path) -> tuple[Signals, float]:
    """Return voltage and position of a file of EMPS, and the force per voltage (N/V).

    Raises
    ------
    RecordError
        The file is unreadable, its samples are not equally spaced, or it does not state `gtau`.
    """
    table = read_table(path)
    time = table.find("t").numbers
    steps = np.diff(time)
    if len(time) < 2 or not np.ptp(steps) < 0.01 * np.median(steps):
        raise RecordError(f"{path}: the times t are not equally spaced; fetch the file anew.")
    stated = [note.partition("=")[2] for note in table.notes if note.partition("=")[0].strip() == "gtau"]
    try:
        drive = float(stated[0])
    except (IndexError, ValueError):
        raise RecordError(
            f"{path}: it does not state gtau, the force per voltage; fetch the file anew."
        ) from None
    return _of_table(table, "vir", "qm", float(np.median(steps))), drive


def emps_force(path: Path) -> Signals:
    """Return force (N) and position (m) of a file of EMPS; see `_emps_record` for its errors."""
    volts, drive = _emps_record(path)
    return Signals(drive * volts.u, volts.y, volts.sampling_time)


def read_bouc_wen(folder: Path, *, verify: bool = True) -> Split:
    """Read the tests of Bouc-Wen, and its training record if the folder has one.

    Raises
    ------
    RecordError
        A file is missing or unreadable, or its signals are not those of the benchmark's description.
    """
    multisine = _bouc_wen_test(folder, "multisine")
    sweep = _bouc_wen_test(folder, "sinesweep")
    if verify:
        _check_bouc_wen(multisine, sweep, folder)
    training, said = bouc_wen_training_record(folder)
    said = (
        f"{said}; tests checked by length and amplitude, as no checksum of them is known here"
        if verify
        else said
    )
    tests = (Test("multisine", multisine, 0, periodic=True), Test("sine sweep", sweep, 0))
    return Split(training, tests, said, verify)


def bouc_wen_training_record(folder: Path) -> tuple[Signals, str]:
    """Return the training record of a folder, or a simulated one, and a sentence on which it is."""
    path = BOUC_WEN_TRAINING.find(folder)
    if path is None:
        return (
            bouc_wen_training(),
            "training: simulated by the published equations, as the benchmark's guide says",
        )
    record = signals_of(path, "u", "y", BOUC_WEN_SAMPLING_TIME)
    return (
        record,
        f"training: {path.name}, which others made by the benchmark's guide; no official one exists",
    )


def _bouc_wen_test(folder: Path, name: str) -> Signals:
    """Return a test: of one file with columns u and y, or of the two official files."""
    both = Wanted((f"test_{name}.csv", f"test_{name}.mat"), _BOUC_WEN)
    path = both.find(folder)
    if path is not None:
        return signals_of(path, "u", "y", BOUC_WEN_SAMPLING_TIME)
    official = (Wanted((f"{prefix}_{name}.mat",), _BOUC_WEN) for prefix in ("uval", "yval"))
    input_file, output_file = (_found((wanted, both), folder) for wanted in official)
    u = read_table(input_file).find(f"uval_{name}").numbers
    y = read_table(output_file).find(f"yval_{name}").numbers
    return _checked(f"{input_file} and {output_file}", u, y, BOUC_WEN_SAMPLING_TIME)


def _check_bouc_wen(multisine: Signals, sweep: Signals, folder: Path) -> None:
    """Raise an error if the inputs are not those that the benchmark describes."""
    if len(multisine) != PERIOD:
        raise RecordError(
            f"{folder}: the test multisine has {len(multisine)} samples, the official one {PERIOD}; "
            f"{UNVERIFIED}."
        )
    sizes = (
        ("test multisine", "RMS", float(np.sqrt(np.mean(multisine.u**2))), MULTISINE_RMS),
        ("sine sweep", "amplitude", float(np.abs(sweep.u).max()), SWEEP_AMPLITUDE),
    )
    for test, quantity, found, wanted in sizes:
        if abs(found - wanted) > AMPLITUDE_TOLERANCE * wanted:
            raise RecordError(
                f"{folder}: the input of the {test} has the {quantity} {found:.4g} N, the official one "
                f"{wanted:g} N; {UNVERIFIED}."
            )
