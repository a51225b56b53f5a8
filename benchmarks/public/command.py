"""The command `python -m benchmarks public`."""

import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks import DATA
from benchmarks.public import downloads, files, models, stand_ins
from benchmarks.public.report import Answer, Reporting, Score, score, write
from benchmarks.public.signals import Signals, Split, Test, Units
from sysid_trib.errors import RecordError, SysidTribError, UsageError, did_you_mean

# Samples of five realisations in multisine_1_to_6.csv.
FIVE_REALISATIONS = 43_500
TEMPLATES = "submission_examples of github.com/GerbenBeintema/nonlinear_benchmarks"


@dataclass(frozen=True, eq=False)
class Benchmark:
    """One public benchmark.

    Parameters
    ----------
    name, title : str
        On the command line, and in tables.
    loader : str
        Folder into which the official package downloads it.
    archive : str
        Archive with its files, and where it is.
    read : callable
        Returns the split of the files in a folder.
    write_stand_in : callable
        Writes simulated files into a folder, in the layout of the official ones.
    choose : callable
        Returns the model that is chosen and fitted on the training part.
    units : Units
    reporting : Reporting
    """

    name: str
    title: str
    loader: str
    archive: str
    read: Callable[..., Split]
    write_stand_in: Callable[[Path], None]
    choose: Callable[[Signals, Units], models.Chosen]
    units: Units
    reporting: Reporting


PAGES = "https://www.nonlinearbenchmark.org/benchmarks"
BENCHMARKS = (
    Benchmark(
        name="silverbox",
        title="Silverbox",
        loader="Silverbox",
        archive=f"SilverboxFiles.zip of {PAGES}/silverbox",
        read=files.read_silverbox,
        write_stand_in=stand_ins.write_silverbox,
        choose=models.choose_silverbox,
        units=Units("V", "V", "smooth"),
        reporting=Reporting("mV", 1e3, ".3", f"mV, three digits: {TEMPLATES}/silverbox.py"),
    ),
    Benchmark(
        name="emps",
        title="EMPS",
        loader="EMPS",
        archive=f"EMPS.zip of {PAGES}/emps",
        read=files.read_emps,
        write_stand_in=stand_ins.write_emps,
        choose=models.choose_emps,
        units=Units("N", "m", "linear"),
        reporting=Reporting(
            "mm",
            1e3,
            ".2f",
            f"mm, two decimals: {TEMPLATES}/EMPS.py (the README's ticks/s are those of another one)",
        ),
    ),
    Benchmark(
        name="bouc_wen",
        title="Bouc-Wen",
        loader="BoucWen",
        archive=f"BoucWenFiles.zip of {PAGES}/bouc-wen",
        read=files.read_bouc_wen,
        write_stand_in=stand_ins.write_bouc_wen,
        choose=models.choose_bouc_wen,
        units=Units("N", "m", "smooth"),
        reporting=Reporting("m", 1.0, ".3", "m: no official template exists"),
    ),
)


def answered(benchmark: Benchmark, split: Split, title: str) -> Answer:
    """Choose and fit a model on the training part, and run it on the tests."""
    chosen = benchmark.choose(split.training, benchmark.units)
    scores: list[Score] = []
    for test in split.tests:
        run_of_test = models.free_run(chosen.result, test, benchmark.units, zero=chosen.zero)
        scores.append(score(test, run_of_test, benchmark.reporting))
    return Answer(title, split, chosen, tuple(scores), benchmark.reporting)


def official(benchmark: Benchmark, folder: Path | None, *, verify: bool) -> Split:
    """Return the split of the official files, of a folder or downloaded.

    Raises
    ------
    RecordError
        A file is missing and cannot be downloaded, or is another one; the message says what to do.
    """
    if folder is None:
        return downloaded(benchmark, verify=verify)
    try:
        return benchmark.read(folder, verify=verify)
    except files.MissingFileError as error:
        raise RecordError(
            f"{benchmark.title}: {error.names} is not in {folder}; it is in {benchmark.archive}; put it into "
            f"{folder / error.place}."
        ) from None
    except SysidTribError as error:
        raise RecordError(f"{benchmark.title}: {error}") from None


def downloaded(benchmark: Benchmark, *, verify: bool) -> Split:
    """Return the split of the files that the official package downloads; see `official`."""
    try:
        folder = downloads.download(benchmark.loader)
    except RecordError as error:
        raise RecordError(
            f"{benchmark.title}: {error}; get {benchmark.archive}, unpack it, and name its folder: --folder."
        ) from None
    try:
        return benchmark.read(folder, verify=verify)
    except SysidTribError as error:
        remedy = f"Delete {folder / benchmark.loader} to download it anew."
        raise RecordError(f"{benchmark.title}, as downloaded: {error} {remedy}") from None


def simulated(benchmark: Benchmark) -> Split:
    """Return a split of simulated files, which are read like the official ones."""
    with tempfile.TemporaryDirectory() as folder:
        benchmark.write_stand_in(Path(folder))
        split = benchmark.read(Path(folder), verify=False)
    if benchmark.name == "bouc_wen":
        training, said = files.bouc_wen_training_record(DATA)
        return Split(training, split.tests, said, official=False)
    return Split(split.training, split.tests, "training and tests simulated", official=False)


def held_out_of_silverbox() -> Split:
    """Return five realisations of the multisine, and the sixth as a test; all are official training."""
    record = files.signals_of(
        DATA / "silverbox" / "multisine_1_to_6.csv", "V1", "V2", files.SILVERBOX_SAMPLING_TIME
    )
    # The file begins 150 samples before the official training part.
    training = record.part(files.MULTISINE.start - files.SILVERBOX_PRINT.first, FIVE_REALISATIONS)
    test = Test("sixth realisation", record.part(FIVE_REALISATIONS), files.SILVERBOX_START)
    said = f"training: {len(training)} samples of the official training part; test: later samples of it"
    return Split(training, (test,), said, official=False)


def held_out_of_emps() -> Split:
    """Return three quarters of the official training record, and its last quarter as a test."""
    record = files.emps_force(DATA / "emps" / "DATA_EMPS.mat")
    end = 3 * len(record) // 4
    test = Test("last quarter", record.part(end), files.EMPS_START)
    said = "training: three quarters of DATA_EMPS.mat, the official training record; test: its last quarter"
    return Split(record.part(0, end), (test,), said, official=False)


HELD_OUT = {"silverbox": held_out_of_silverbox, "emps": held_out_of_emps}


def stand_ins_of(benchmark: Benchmark) -> list[Answer]:
    """Return the answers on simulated tests, and on a held-out part of the measured training record."""
    answers = [answered(benchmark, simulated(benchmark), f"{benchmark.title}, simulated")]
    held_out = HELD_OUT.get(benchmark.name)
    if held_out is not None:
        try:
            answers.append(answered(benchmark, held_out(), f"{benchmark.title}, held-out part"))
        except UsageError as error:
            print(f"{benchmark.title}: the held-out part is left out: {error}", file=sys.stderr)
    return answers


def named(only: str) -> list[Benchmark]:
    """Return the benchmarks of this name, all for an empty one.

    Raises
    ------
    UsageError
        There is none of this name.
    """
    found = [benchmark for benchmark in BENCHMARKS if only in ("", benchmark.name)]
    if not found:
        names = [benchmark.name for benchmark in BENCHMARKS]
        raise UsageError(f"--only {only}: the benchmarks are {', '.join(names)}.{did_you_mean(only, names)}")
    return found


def checked_folder(folder: Path | None) -> Path | None:
    """Return the folder of the files.

    Raises
    ------
    UsageError
        It is no folder.
    """
    if folder is not None and not folder.is_dir():
        raise UsageError(f"--folder {folder}: there is no such folder.")
    return folder


def checked_out(path: Path | None) -> Path | None:
    """Return the file to write, before the long computation.

    Raises
    ------
    UsageError
        Its folder does not exist, or it is a folder itself.
    """
    if path is not None and (path.is_dir() or not path.parent.is_dir()):
        raise UsageError(f"--out {path}: name a file in a folder that exists.")
    return path


def run(asked: Namespace) -> int:
    """Print the answers and return the exit status: 1 if a benchmark could not be run.

    Raises
    ------
    SysidTribError
        An option is wrong, or the official package is not installed.
    """
    benchmarks = named(asked.only)
    folder = checked_folder(asked.folder)
    out = checked_out(asked.out)
    downloads.error_metrics()
    answers: list[Answer] = []
    status = 0
    for benchmark in benchmarks:
        try:
            if asked.stand_ins:
                new = stand_ins_of(benchmark)
            else:
                split = official(benchmark, folder, verify=not asked.unverified)
                new = [answered(benchmark, split, benchmark.title)]
        except SysidTribError as error:
            text = str(error)
            print(text if text.startswith(benchmark.title) else f"{benchmark.title}: {text}", file=sys.stderr)
            status = 1
            continue
        for answer in new:
            answer.show()
        answers.extend(new)
    if out is not None and answers:
        write(answers, out)
    return status


def public(asked: Namespace) -> None:
    """Run the public benchmarks; end the process with the exit status unless it is zero."""
    try:
        status = run(asked)
    except SysidTribError as error:
        print(error, file=sys.stderr)
        status = error.exit_status
    if status:
        sys.exit(status)
