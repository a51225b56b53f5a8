"""`sysid-trib simulate`, `plan` and `response`: motions that a model predicts before they are measured."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from sysid_trib.commands.destination import Files, Shown
from sysid_trib.commands.options import (
    DEFAULT_LIBRARY,
    MODEL,
    OUTPUT,
    RESULT_FILE,
    WHERE_TO_WRITE,
    ConstraintOptions,
    DecayOptions,
    ModelOptions,
    option,
    switch,
    with_options,
)
from sysid_trib.errors import UsageError

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.forces.force import ForceLibrary
    from sysid_trib.simulation.model import Model

MAX_SAMPLES, MAX_PERIODS, MAX_NOISE = 20_000_000, 1_000_000, 1e3


@dataclass(frozen=True)
class SimulationOptions:
    """The model that moves."""

    title: ClassVar[str] = MODEL

    set_: list[str] = option(
        "SYMBOL=VALUE", "A coefficient or shape (dahl.s=0.02); repeat.", [], flags=("--set",)
    )
    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY)
    reference_frequency: float = option("RAD/S", "Reference frequency.", 9.91)


@dataclass(frozen=True)
class MotionOptions:
    """How it starts, how long it is recorded, and what disturbs it."""

    title: ClassVar[str] = "Record"

    duration: float = option("S", "Length of the record.", 25.0)
    sampling_rate: float = option("HZ", "Samples a second.", 100.0)
    angle0: float = option("RAD", "Angle at the start.", 0.3)
    rate0: float = option("RAD/S", "Angular rate at the start.", 0.0)
    noise: float = option("RAD", "Standard deviation of white noise.", 0.0)
    random_force: float = option("DENSITY", "Of a white acceleration, one-sided, (rad/s^2)^2/Hz.", 0.0)
    seed: int = option(None, "Seed of the noise and of the random force.", 0)


@with_options
def simulate(
    *,
    asked: SimulationOptions,
    motion: MotionOptions,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="RECORD.csv|.nc", help=WHERE_TO_WRITE, rich_help_panel=OUTPUT),
    ],
) -> None:
    """Simulate the decay of a model; without --set, of the paper's PDMS/glass run.

    Examples
    --------
    sysid-trib simulate --noise 1e-4 -o swing.csv
    sysid-trib simulate --set zeta=0.01 --set nu=-0.2 --duration 30 --noise 1e-4 -o soft.csv
    """
    from sysid_trib.commands.terminal import progress

    with progress() as tell:
        from sysid_trib.commands.checks import check_positive
        from sysid_trib.commands.destination import check_output
        from sysid_trib.forces.library import load_library
        from sysid_trib.forces.selection import with_shipped
        from sysid_trib.simulation.model import Model

        check_output(output, ".csv .nc", reads=[Path(asked.library)])
        named = [text.partition("=")[0].partition(".")[0].strip() for text in asked.set_]
        offered = with_shipped(load_library(asked.library), named)
        coefficients, shapes = _settings(asked.set_, offered, papers=asked.library == DEFAULT_LIBRARY)
        check_positive(asked.reference_frequency, "--reference-frequency")
        check_positive(motion.duration, "--duration")
        check_positive(motion.sampling_rate, "--sampling-rate")
        tell("simulation")
        record = _simulated(Model(offered, coefficients, asked.reference_frequency, shapes), motion)
        write_record(record, output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    print(f"{output}: {record.sizes['time']} simulated samples{ending}.")


def _settings(
    texts: list[str], library: "ForceLibrary", *, papers: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Coefficients and shape parameters from `lambda=1e-3`, `dahl.s=0.02`; the paper's if none is set."""
    from sysid_trib.commands.checks import MOST, assigned
    from sysid_trib.simulation.model import check_shapes
    from sysid_trib.simulation.simulate import PAPER_COEFFICIENTS

    values = assigned(texts, "--set '{}' must be SYMBOL=VALUE, such as lambda=1e-3.")
    for name, value in values.items():
        if abs(value) > MOST:
            raise UsageError(f"--set {name}: {value:g} is larger than {MOST:g}.")
    shapes = {name: value for name, value in values.items() if "." in name}
    coefficients = {name: value for name, value in values.items() if "." not in name}
    check_shapes(shapes, library)
    if not coefficients and (texts or not papers):
        raise UsageError("No force is given a coefficient: add one, such as --set zeta=0.01.")
    return coefficients or PAPER_COEFFICIENTS, shapes


def _simulated(model: "Model", motion: MotionOptions) -> "xr.Dataset":
    """What `simulate` returns, with the noise in `angle`; numbers from which no record comes are refused."""
    import numpy as np

    from sysid_trib.commands.checks import MOST, check_between
    from sysid_trib.likelihood.random_force import DENSITY_UNITS
    from sysid_trib.simulation.integrate import DIVERGED
    from sysid_trib.simulation.simulate import simulate

    duration, sampling_rate, noise = motion.duration, motion.sampling_rate, motion.noise
    samples = round(duration * sampling_rate)
    if not 2 <= samples <= MAX_SAMPLES:
        raise UsageError(
            f"{duration:g} s at {sampling_rate:g} Hz must be 2 to {MAX_SAMPLES:,} samples; "
            "change --duration or --sampling-rate."
        )
    if duration * model.reference_frequency > 2.0 * np.pi * MAX_PERIODS:
        raise UsageError(
            f"{duration:g} s at {model.reference_frequency:g} rad/s are more than {MAX_PERIODS:,} periods; "
            "shorten --duration, or lower --reference-frequency."
        )
    check_between(motion.angle0, "--angle0", -DIVERGED, DIVERGED, " rad")
    check_between(motion.rate0, "--rate0", -MOST, MOST, " rad/s")
    check_between(noise, "--noise", 0.0, MAX_NOISE, " rad")
    check_between(motion.random_force, "--random-force", 0.0, MOST, f" {DENSITY_UNITS}")
    if motion.seed < 0:
        raise UsageError(f"--seed '{motion.seed}' must be a whole number, 0 or more.")
    time = np.arange(samples) / sampling_rate
    density, seed = motion.random_force, motion.seed
    record = simulate(model, time, motion.angle0, motion.rate0, random_force=density, seed=seed)
    record["angle"] = record.angle + noise * np.random.default_rng(seed).standard_normal(samples)
    record.angle.attrs = {"units": "rad", "long_name": "angle"}
    disturbed = f", random force {density:g} {DENSITY_UNITS}" if density else ""
    source = f"simulated by sysid_trib, noise {noise:g} rad{disturbed}, seed {seed}"
    return record.assign_attrs(source=source, synthetic="yes")


def write_record(record: "xr.Dataset", target: Path) -> None:
    """Write a record as CSV (`time (s)`, `angle (rad)`) or netCDF, by the file's ending."""
    from sysid_trib.results.files import save, write_file

    if target.suffix.lower() == ".csv":
        table = record.angle.to_dataframe()[["angle"]].rename(columns={"angle": "angle (rad)"})
        write_file(target, table.to_csv(index_label="time (s)").encode())
    else:
        save(record, target)


@dataclass(frozen=True)
class PlanOptions:
    """Which runs can be made, and what is wanted."""

    title: ClassVar[str] = "Next run"

    amplitude: str = option(
        "LOW:HIGH", "Limits of the release; default: 0.3 and 1.5 times the record's.", ":"
    )
    duration: str = option("LOW:HIGH", "Limits of the duration in s; default: half of and twice its.", ":")
    rate: float | None = option("HZ", "Sampling rate of the next run; default: the record's.")
    repeats: int = option("N", "How often the run is made.", 1, least=1)
    want: list[str] = option("FORCE=ERROR", "Standard error that is wanted: delta=0.0005; repeat.", [])


@with_options
def plan(
    *,
    given: DecayOptions,
    model: ModelOptions,
    constraint: ConstraintOptions,
    asked: PlanOptions,
    shown: Shown,
) -> None:
    """Say which run to make next: RESULT.nc of identify or discover, or records.

    Examples
    --------
    sysid-trib plan forces.nc --amplitude 0.05:0.6 --duration :60
    sysid-trib plan swing.csv --want delta=0.0002 --repeats 2 --plot figures
    """
    from sysid_trib.commands.terminal import working

    with working(given.records) as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.printing.next_step import plan_blocks, plan_json
        from sysid_trib.results import files
        from sysid_trib.validation.identify import identify
        from sysid_trib.validation.next_run import plan

        limits = {
            "amplitude": checks.parse_window(asked.amplitude, "--amplitude", "LOW:HIGH, such as 0.05:0.8"),
            "duration": checks.parse_window(asked.duration, "--duration"),
        }
        wanted = checks.assigned(asked.want, "--want '{}' must be FORCE=ERROR, such as delta=0.0005.")
        shown.check(given.records)
        tell("reading")
        tree = files.load(given.records[0]) if [p.suffix for p in given.records] == [".nc"] else None
        # A record may be netCDF too.
        if tree is None or not files.kind_of(tree):
            of_model = checks.asked_model(model, constraint, given.system)
            decays, _ = read_decays(given, model)
            tree = identify(decays, of_model.library, constraints=of_model.constraints.table, tell=tell)
        source = given.records[0] if given.records else Path("the example")
        main = checks.model_of_file(source, tree)
        data = plan(tree, **limits, sampling_rate=asked.rate, repeats=asked.repeats, wanted=wanted, tell=tell)
        shown.draw(lambda plots: [("plan", lambda: plots.plan(data))], tell)
    shown.say(lambda: plan_json(data), lambda: plan_blocks(data, main))


@dataclass(frozen=True)
class SweepOptions:
    """How a model is driven, and in which range of frequencies."""

    title: ClassVar[str] = "Drive"

    drive: float = option(
        "AMPLITUDE",
        "Amplitude of the input in its unit; of a model without one the deflection it has at rest.",
        ...,
    )
    frequencies: str = option("LOW:HIGH", "Range, over the frequency at small amplitudes.", "0.9:1.1")
    driven_by: str = option("NAME", "Input that drives, of a model with several.", "")
    base: bool = switch(
        "--base",
        "Of a model without inputs: the drive is the displacement of a base, from which the signal counts.",
    )
    points: int = option("N", "Frequencies.", 201, least=2)


@with_options
def response(result: RESULT_FILE, *, sweep: SweepOptions, files: Files) -> None:
    """Steady response of an identified model to a harmonic drive, with bands and its unstable branch.

    Examples
    --------
    sysid-trib response forces.nc --drive 0.002
    sysid-trib response forces.nc --drive 0.002 --frequencies 0.9:1.1 --csv response.csv --plot figures
    """
    from sysid_trib.commands.terminal import working

    with working() as tell:
        import numpy as np
        import xarray as xr

        from sysid_trib.commands.checks import check_positive, model_of_file, parse_window
        from sysid_trib.printing.driven import response_blocks, response_csv, response_json
        from sysid_trib.results.files import load
        from sysid_trib.validation.steady_response import forced_response

        check_positive(sweep.drive, "--drive")
        low, high = parse_window(sweep.frequencies, "--frequencies")
        if low is None or high is None or not 0.0 < low < high:
            raise UsageError(f"--frequencies '{sweep.frequencies}' must be LOW:HIGH, both positive: 0.9:1.1.")
        files.check([result])
        tell("reading")
        answer = model_of_file(result, load(result))
        tell("response")
        w = answer.asymptotic_frequency.item() * np.linspace(low, high, sweep.points)
        data = forced_response(answer, sweep.drive, w, driven_by=sweep.driven_by, base=sweep.base)
        files.save(xr.DataTree(data), {files.csv: lambda: response_csv(data)})
        files.draw(lambda plots: [("response", lambda: plots.response(data))], tell)
    files.say(lambda: response_json(data), lambda: response_blocks(data))
