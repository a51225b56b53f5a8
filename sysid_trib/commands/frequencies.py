"""Frequencies that an option gives, held against those at which the records swing."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sysid_trib.errors import DecayError, UsageError

if TYPE_CHECKING:
    import xarray as xr

OMEGA0, REFERENCE = "--omega0", "--reference-frequency"
# A frequency within this part of the record's own in Hz is meant in Hz.
HERTZ_TOLERANCE = 0.3
# Hz and rad/s differ by more; a contact of 24 times the stiffness of the oscillator does not.
MOST_RATIO = 5.0
# What is left to do without the option.
INSTEAD = {
    OMEGA0: "correct it, or leave it out: (w_inf / omega0)^2 - 1 gives alpha from the w_inf of the result",
    REFERENCE: "correct it, or leave it out: w is then fitted",
}


def check_frequencies(
    decays: "Sequence[xr.Dataset]", reference: float | None, contactless: tuple[float, float] | None = None
) -> None:
    """Refuse a frequency that cannot be that of the records.

    Parameters
    ----------
    decays : sequence of Dataset
        The decays.
    reference : float, rad/s, optional
        Of `--reference-frequency`.
    contactless : (float, float), rad/s, optional
        Of `--omega0`, with its error.

    Raises
    ------
    UsageError
        It is the record's own in Hz, or more than a factor of five off; with the record's.
    """
    asked = {REFERENCE: reference, OMEGA0: contactless[0] if contactless else None}
    for flag, frequency in asked.items():
        if frequency is not None:
            for decay in decays:
                _check_frequency(frequency, flag, decay)


def _check_frequency(frequency: float, flag: str, decay: "xr.Dataset") -> None:
    from sysid_trib.noise.level import swing_frequency

    try:
        swing = swing_frequency(decay)
    except DecayError:
        # Of too few half periods the methods have their own word to say.
        return
    in_hertz = swing / (2.0 * np.pi)
    beginning = f"{flag} '{frequency:g}': the record swings at {swing:.4g} rad/s, "
    if abs(frequency / in_hertz - 1.0) < HERTZ_TOLERANCE:
        raise UsageError(f"{beginning}which is {in_hertz:.4g} Hz; give it in rad/s.")
    if frequency > MOST_RATIO * swing:
        raise UsageError(f"{beginning}less than a fifth of that; {INSTEAD[flag]}.")
    if frequency < swing / MOST_RATIO:
        raise UsageError(f"{beginning}more than five times that; {INSTEAD[flag]}.")
