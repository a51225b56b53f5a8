"""`sysid-trib response`."""

from dataclasses import dataclass
from typing import ClassVar

from sysid_trib.commands.destination import Files
from sysid_trib.commands.options import RESULT_FILE, option, switch, with_options


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
    """Steady response of an identified model to a harmonic drive, with bands and its unstable branch."""
    from sysid_trib.commands.terminal import command_line, working

    with working() as tell:
        import numpy as np
        import xarray as xr

        from sysid_trib.commands.checks import check_positive, parse_window
        from sysid_trib.errors import UsageError
        from sysid_trib.printing.responded import response_blocks, response_csv, response_json
        from sysid_trib.results.files import load
        from sysid_trib.validation.findings import main_result
        from sysid_trib.validation.steady_response import forced_response

        check_positive(sweep.drive, "--drive")
        low, high = parse_window(sweep.frequencies, "--frequencies")
        if low is None or high is None or not 0.0 < low < high:
            raise UsageError(f"--frequencies '{sweep.frequencies}' must be LOW:HIGH, both positive: 0.9:1.1.")
        files.check([result])
        tell("reading")
        answer = main_result(load(result))
        if answer is None:
            raise UsageError(f"{result} holds no model that follows its record; give what identify wrote.")
        tell("response")
        w = answer.asymptotic_frequency.item() * np.linspace(low, high, sweep.points)
        made = forced_response(answer, sweep.drive, w, driven_by=sweep.driven_by, base=sweep.base)
        files.save(
            xr.DataTree(made.assign_attrs(command=command_line())), {files.csv: lambda _: response_csv(made)}
        )
        files.draw(lambda plots: [("response", lambda: plots.response(made))], tell)
    files.say(lambda: response_json(made), lambda: response_blocks(made))
