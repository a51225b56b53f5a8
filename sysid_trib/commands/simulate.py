"""`sysid-trib simulate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from sysid_trib.commands.options import DEFAULT_LIBRARY, MODEL, OUTPUT, WHERE_TO_WRITE, option, with_options


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
    """Simulate the decay of a model; without --set, of the paper's PDMS/glass run."""
    from sysid_trib.commands.terminal import progress

    with progress() as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.destination import check_output
        from sysid_trib.commands.simulated_record import simulated_record, write_record
        from sysid_trib.forces.library import load_library
        from sysid_trib.simulation.model import Model

        check_output(output, ".csv .nc", reads=[Path(asked.library)])
        offered = load_library(asked.library)
        coefficients, shapes = checks.settings(asked.set_, offered, papers=asked.library == DEFAULT_LIBRARY)
        checks.check_positive(asked.reference_frequency, "--reference-frequency")
        checks.check_positive(motion.duration, "--duration")
        checks.check_positive(motion.sampling_rate, "--sampling-rate")
        tell("simulation")
        record = simulated_record(Model(offered, coefficients, asked.reference_frequency, shapes), motion)
        write_record(record, output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    print(f"{output}: {record.sizes['time']} simulated samples{ending}.")
