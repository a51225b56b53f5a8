"""How a file is to be read, as its user says."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real

from sysid_trib.errors import UsageError
from sysid_trib.records import units as lab
from sysid_trib.records.inputs import BETWEEN_SAMPLES

# Variables of a record that no input may be.
TAKEN_NAMES = ("time", "angle", "rate", "acceleration", "input", "x", "v", "t")


@dataclass(frozen=True)
class Reading:
    """How a file is to be read; what is not given is taken from the file.

    Parameters
    ----------
    time, angle : str or int, optional
        Columns of time and signal, by name or number from 0.
    signal : {"angle", "displacement", "rate", "acceleration", "accelerometer"}, optional
        What was measured; an accelerometer on a pendulum feels gravity's component along its path too.
    units : str, optional
        Unit of the signal.
    sampling_rate : float, Hz, optional
        Instead of a time column.
    time_units : {"s", "ms", "us", "ns", "min", "h", "d"}, optional
        Unit of the time column.
    length : float, m, optional
        Of a pendulum: turns a displacement in a unit of length into an angle.
    distance : float, m, optional
        Of an accelerometer from the axis of the pendulum that it is on.
    usual : str, optional
        What is usually measured of such a system: the signal's quantity where nothing says it.
    inputs : mapping of str to (str or int)
        Columns of inputs by the names that forces hold, `{"u": "V1"}`; of another file `base.mat:y`.
    between : {"smooth", "linear", "held", "cubic"}
        What inputs are between their samples (see `KnownInput`).
    """

    time: str | int | None = None
    angle: str | int | None = None
    signal: str | None = None
    units: str | None = None
    sampling_rate: float | None = None
    time_units: str | None = None
    length: float | None = None
    distance: float | None = None
    usual: str | None = None
    inputs: Mapping[str, str | int] = field(default_factory=dict)
    between: str = "smooth"

    def __post_init__(self) -> None:
        if self.signal is not None and self.signal not in lab.SIGNALS:
            raise UsageError(f"signal {self.signal!r} is unknown: give {', '.join(lab.SIGNALS)}.")
        if self.between not in BETWEEN_SAMPLES:
            raise UsageError(f"between {self.between!r} is unknown: give {', '.join(BETWEEN_SAMPLES)}.")
        for name in self.inputs:
            if not name.isidentifier() or name in TAKEN_NAMES:
                raise UsageError(f"{name!r} cannot name an input; write u=COLUMN, as forces hold it.")
        if self.time_units is not None and self.time_units not in lab.TIME_UNITS:
            raise UsageError(f"time units {self.time_units!r} are unknown: give {lab.OFFERED_TIME_UNITS}.")
        if self.units is not None and lab.signal_unit(self.units) is None:
            raise UsageError(f"units {self.units!r} are unknown: give {lab.OFFERED_UNITS}.")
        for name in ("sampling_rate", "length", "distance"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, Real):
                raise UsageError(f"{name.replace('_', ' ')} {value!r} is no number: give one.")
        if self.sampling_rate is not None and not 1e-9 <= self.sampling_rate <= 1e9:
            raise UsageError(
                f"sampling rate {self.sampling_rate:g}: give a positive number of samples a second."
            )
        if (self.signal == lab.ACCELEROMETER) != (self.distance is not None):
            raise UsageError(
                "An accelerometer on a pendulum is read by its distance from the axis in m: give both "
                "--signal accelerometer and --distance M (signal= and distance= in Python), or neither."
            )
        if self.distance is not None and not 0.0 <= self.distance < 1e6:
            raise UsageError(f"distance {self.distance:g}: give the distance from the axis in m.")
        if self.length is not None and not 0.0 < self.length < 1e6:
            raise UsageError(f"length {self.length:g}: give the pendulum's length in m.")

    @property
    def quantity(self) -> str | None:
        """What is measured, if it is given; what an accelerometer feels is in units of an acceleration."""
        return "acceleration" if self.signal == lab.ACCELEROMETER else self.signal
