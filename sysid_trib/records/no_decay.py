"""Reasons why a signal is not a free decay, with a sentence for each."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

from sysid_trib.errors import DecayError


class Cause(Enum):
    """Cause because of which a signal is not a free decay."""

    STILL = auto()
    FEW_SAMPLES = auto()
    NO_OSCILLATION = auto()
    PULSES = auto()
    CLIPPED = auto()
    COARSE_SAMPLING = auto()
    FEW_HALF_PERIODS = auto()
    GROWS = auto()
    DOES_NOT_DECAY = auto()
    BEATS = auto()
    RISES_AGAIN = auto()
    SEVERAL_MODES = auto()


# Causes that several modes may have, if the spectrum shows several. CLIPPED is not among them, because the
# spectrum of a clipped swing always shows several lines.
MAYBE_OF_MODES = frozenset(
    {
        Cause.COARSE_SAMPLING,
        Cause.FEW_HALF_PERIODS,
        Cause.GROWS,
        Cause.DOES_NOT_DECAY,
        Cause.BEATS,
        Cause.RISES_AGAIN,
    }
)
# Causes that are, or look like, a beat of modes.
LIKE_BEATS = frozenset({Cause.BEATS, Cause.RISES_AGAIN, Cause.SEVERAL_MODES})
# Advice for a record that is not a decay, and for one in which modes beat.
AS_IT_IS = "name the forces that act (--forces) to use it uncut"
ONE_DECAY = "record one alone, or choose the window of one decay"


@dataclass(frozen=True)
class NoDecay:
    """Reason why a signal is not a free decay.

    Attributes
    ----------
    cause : Cause
    what : str
        Short description of the problem.
    remedy : str
        Advice.
    needed : str
        Requirements of a free decay; may be empty.
    uncut : str
        How the record can be used all the same; may be empty.
    """

    cause: Cause
    what: str
    remedy: str
    needed: str = ""
    uncut: str = ""

    @property
    def text(self) -> str:
        """Reason in full, with what is needed."""
        return f"{self.what}, {self.needed}" if self.needed else self.what


class NoDecayError(DecayError):
    """A signal that is not a free decay.

    Parameters
    ----------
    source : str
        Name of the record.
    reason : NoDecay
        Reason why it is not a free decay.
    """

    def __init__(self, source: str, reason: NoDecay) -> None:
        uncut = f", or {reason.uncut}" if reason.uncut else ""
        super().__init__(f"{source}: {reason.text}; {reason.remedy}{uncut}.")
        self.source = source
        self.reason = reason

    def __reduce__(self) -> tuple[type["NoDecayError"], tuple[str, NoDecay]]:
        """Return the class and its arguments, for another process."""
        return NoDecayError, (self.source, self.reason)


def still() -> NoDecay:
    """Describe a signal that is constant."""
    return NoDecay(Cause.STILL, "it does not move", "choose another column or window")


def few_samples(count: int, fewest: int) -> NoDecay:
    """Describe a signal of too few samples."""
    what = f"only {count} sample{'s' * (count != 1)}"
    return NoDecay(Cause.FEW_SAMPLES, what, "record longer", f"at least {fewest} are needed")


def no_oscillation() -> NoDecay:
    """Describe a signal of noise alone."""
    what = "no oscillation is visible above the noise"
    return NoDecay(Cause.NO_OSCILLATION, what, "check column and window")


def pulses() -> NoDecay:
    """Describe the signal of a light barrier."""
    what = (
        "the signal rests at one level and leaves it in pulses, like that of a light barrier: it is no "
        "displacement, and has no decay"
    )
    return NoDecay(Cause.PULSES, what, "choose another column")


def clipped(limits: Sequence[str]) -> NoDecay:
    """Describe a signal that reaches the limits of the sensor's range until the end of the record."""
    what = f"its half periods are clipped at {' or '.join(limits)}, to the end"
    return NoDecay(Cause.CLIPPED, what, "record with a wider range")


def coarse_sampling(per_half_period: float) -> NoDecay:
    """Describe a signal with too few samples in a half period."""
    what = f"only {per_half_period:.2g} samples in a half period"
    return NoDecay(Cause.COARSE_SAMPLING, what, "sample faster")


def few_half_periods(count: int, period: float) -> NoDecay:
    """Describe a swing with too few whole half periods; `period` in s."""
    what = (
        f"only {count} whole half period{'s' * (count != 1)} of steady oscillation (period about "
        f"{period:.3g} s)"
    )
    needed = "at least five are needed, in a record of three periods"
    return NoDecay(Cause.FEW_HALF_PERIODS, what, "record longer or widen the window", needed, AS_IT_IS)


def grows(percent: float) -> NoDecay:
    """Describe an oscillation that grows by this percentage per period."""
    what = f"the oscillation grows by {percent:.2g} % a period"
    return NoDecay(Cause.GROWS, what, "a free decay is needed", uncut=AS_IT_IS)


def does_not_decay(amplitude: float, percent: float) -> NoDecay:
    """Describe an oscillation whose first amplitude changes by this percentage per period."""
    what = (
        f"the oscillation does not decay: its amplitude, {amplitude:.3g} at first, changes by "
        f"{percent:+.2g} % a period"
    )
    remedy = "is it driven? Name what drives it (--input), or give a free decay"
    return NoDecay(Cause.DOES_NOT_DECAY, what, remedy)


def falls_and_rises(before: float, trough: float, after: float) -> NoDecay:
    """Describe an amplitude that falls to a minimum and rises to its first value again."""
    what = (
        f"the amplitude falls from {before:.3g} to {trough:.3g} and rises again to {after:.3g}: "
        "two modes beat"
    )
    return NoDecay(Cause.BEATS, what, ONE_DECAY)


def beats(first: float, last: float, instant: float, top: float) -> NoDecay:
    """Describe an amplitude that falls until an instant (s) and then rises gradually to a maximum."""
    what = (
        f"the amplitude falls from {first:.3g} to {last:.3g} at {instant:.4g} s and rises again to "
        f"{top:.3g} as gradually: two modes beat"
    )
    return NoDecay(Cause.BEATS, what, ONE_DECAY)


def rises_again(instant: float, before: float, after: float) -> NoDecay:
    """Describe an amplitude that rises at an instant (s)."""
    what = f"the amplitude rises again at {instant:.4g} s, from {before:.3g} to {after:.3g}"
    remedy = (
        "a free decay does not: two modes beat, or it was pushed; end the window before, or start it after"
    )
    return NoDecay(Cause.RISES_AGAIN, what, remedy)


def several_modes(listed: str, first: NoDecay) -> NoDecay:
    """Describe a signal of several modes, with the reason for which it is not a free decay."""
    what = f"several modes swing at once, {listed} ({first.what})"
    remedy = "separate one of them (--mode 1, or one_mode in Python), or record only one"
    return NoDecay(Cause.SEVERAL_MODES, what, remedy)
