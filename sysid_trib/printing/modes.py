"""Texts about the modes in a decay, and about the steady response of one of them."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing import Block, layout

# A sensor shows a mode if its amplitude there is at least this fraction of the largest.
SHOWN_AT = 0.1
# Number of printed frequencies of a sweep.
PRINTED_FREQUENCIES = 9
IN_DECAY = (
    "Frequency and damping ratio are those at small amplitude; the amplitude is the first one, at the sensor "
    "where it is largest."
)


def modes_blocks(modes: xr.Dataset, sources: Sequence[str] = (), next_command: str = "") -> Iterator[Block]:
    """Print a decay with several modes, for the command `look`.

    Parameters
    ----------
    modes : Dataset
        Result of `modes`.
    sources : sequence of str
        Descriptions of the record.
    next_command : str
        The next command; empty without one.
    """
    yield Block(list(sources))
    yield Block([*_sentences(modes)], table=layout.text_table(_mode_rows(modes), ("sensors",)))
    remarks = [*modes.attrs["close_modes"], *modes.attrs["influences"]]
    yield Block([IN_DECAY, *map(_sentence, remarks)])
    if next_command:
        yield Block([f"Next: {next_command}"])


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _sentences(modes: xr.Dataset) -> Iterator[str]:
    """Describe the modes, and harmonics and steady lines in the record."""
    count = modes.sizes["mode"]
    noise = ", ".join(f"{value:.2g}" for value in modes.noise.values)
    yield (
        f"{count} mode{'s' * (count > 1)} ring{'s' * (count == 1)} from {modes.attrs['start']:.4g} s on; the "
        f"white noise of the sensors is {noise} {modes.noise.attrs['units']}."
    )
    said = []
    if modes.attrs["harmonics"]:
        said.append(f"harmonics of a mode at {modes.attrs['harmonics']} Hz")
    if modes.attrs["lines"]:
        said.append(f"steady lines at {modes.attrs['lines']} Hz, which do not decay")
    if said:
        yield _sentence(f"The record also contains {' and '.join(said)}")
    if modes.attrs["second_blow"]:
        yield _sentence(str(modes.attrs["second_blow"]))


def _mode_rows(modes: xr.Dataset) -> list[dict[str, str]]:
    """Return a row for each mode."""
    unit, rows = modes.first_amplitude.attrs["units"], []
    for number, mode in layout.by_label(modes, "mode").items():
        first = mode.first_amplitude.to_series()
        shown = first[first > SHOWN_AT * first.max()].sort_values(ascending=False)
        rows.append(
            {
                "mode": str(number),
                "frequency (Hz)": f"{mode.frequency.item():.6g}",
                "damping ratio": f"{mode.damping_ratio.item():.3g}",
                f"amplitude ({unit})": f"{first.max():.3g}",
                "seen for (s)": f"{mode.duration.item():.3g}",
                "sensors": ", ".join(str(name) for name in shown.index),
            }
        )
    return rows


def modes_json(modes: xr.Dataset, next_command: str) -> dict[str, Any]:
    """Return the modes of a decay as plain data."""
    return layout.mapped(modes, "modes", {"next": next_command})


def mode_response_blocks(response: xr.Dataset, sources: Sequence[str] = ()) -> Iterator[Block]:
    """Print the result of `response_of_mode`, for the command `response`."""
    yield Block(list(sources))
    rows = []
    for sweep, curve in layout.by_label(response, "sweep").items():
        motions = curve.dropna("frequency", subset=["amplitude"])
        if count := motions.sizes["frequency"]:
            apart = np.linspace(0, count - 1, PRINTED_FREQUENCIES).round().astype(int)
            places = {*apart.tolist(), int(np.argmax(motions.amplitude.values))}
            rows += [_response_row(motions.isel(frequency=at), sweep) for at in sorted(places)]
    if rows:
        yield Block(table=layout.text_table(rows, ("sweep",)))
    else:
        yield Block(["No motion of this drive is within the range of the decay; change the drive, --drive."])
    drive = f"{response.drive.item():.4g} {response.drive.attrs['units']}"
    mass = (
        ""
        if response.drive.attrs["units"] == "N"
        else " (force over modal mass; with --modal-mass it is a force in N)"
    )
    largest = f"{response.attrs['largest_amplitude']:.3g} {response.amplitude.attrs['units']}"
    yield Block(
        [
            f"Drive of {drive}{mass}. Motions larger than {largest} are beyond the range of the decay and "
            "are left out.",
            "The bands include those of the backbone. They also include the difference between the damping "
            "of a steady motion and that of a decay where the stiffness changes with the amplitude.",
        ]
    )


def _response_row(motion: xr.Dataset, sweep: str) -> dict[str, str]:
    return {
        "sweep": sweep,
        "frequency (Hz)": f"{motion.frequency.item() / (2.0 * np.pi):.6g}",
        f"amplitude ({motion.amplitude.attrs['units']})": f"{motion.amplitude.item():.4g}",
        "band": f"{motion.amplitude_low.item():.4g} to {motion.amplitude_high.item():.4g}",
        "phase (rad)": f"{motion.phase.item():.3f}",
    }
