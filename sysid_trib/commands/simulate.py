"""`sysid-trib simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from sysid_trib.commands.options import DEFAULT_LIBRARY, WHERE_TO_WRITE
from sysid_trib.commands.terminal import progress


def simulate(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="RECORD.csv|.nc", help=WHERE_TO_WRITE),
    ],
    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="SYMBOL=VALUE", help="A coefficient or shape (dahl.s=0.02); repeat."),
    ] = [],  # noqa: B006 - typer copies it
    library: Annotated[str, typer.Option(metavar="NAME|FILE", help="Force library.")] = DEFAULT_LIBRARY,
    reference_frequency: Annotated[float, typer.Option(metavar="RAD/S", help="Reference frequency.")] = 9.91,
    duration: Annotated[float, typer.Option(metavar="S", help="Length of the record.")] = 25.0,
    sampling_rate: Annotated[float, typer.Option(metavar="HZ", help="Samples a second.")] = 100.0,
    angle0: Annotated[float, typer.Option(metavar="RAD", help="Angle at the start.")] = 0.3,
    rate0: Annotated[float, typer.Option(metavar="RAD/S", help="Angular rate at the start.")] = 0.0,
    noise: Annotated[float, typer.Option(metavar="RAD", help="Standard deviation of white noise.")] = 0.0,
    random_force: Annotated[
        float, typer.Option(metavar="DENSITY", help="Of a white acceleration, one-sided, (rad/s^2)^2/Hz.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the noise and of the random force.")] = 0,
) -> None:
    """Simulate the decay of a model; without --set, of the paper's PDMS/glass run."""
    with progress() as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.destination import check_output
        from sysid_trib.commands.simulated_record import simulated_record, write_record
        from sysid_trib.forces.library import load_library
        from sysid_trib.simulation.model import Model

        check_output(output, ".csv .nc", reads=[Path(library)])
        offered = load_library(library)
        coefficients, shapes = checks.settings(set_, offered, papers=library == DEFAULT_LIBRARY)
        checks.check_positive(reference_frequency, "--reference-frequency")
        checks.check_positive(duration, "--duration")
        checks.check_positive(sampling_rate, "--sampling-rate")
        model = Model(offered, coefficients, reference_frequency, shapes)
        start = (angle0, rate0)
        tell("simulation")
        record = simulated_record(
            model, duration, sampling_rate, start, noise=noise, random_force=random_force, seed=seed
        )
        write_record(record, output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    print(f"{output}: {record.sizes['time']} simulated samples{ending}.")
