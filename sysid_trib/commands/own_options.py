"""Options that one command has alone, in groups."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from sysid_trib.commands.options import (
    DEFAULT_LIBRARY,
    MODEL,
    MOST,
    OUTPUT,
    POSITIVE,
    WHERE_TO_WRITE,
    WRITTEN_BY,
    option,
    switch,
)

SURE = "How sure"


@dataclass(frozen=True)
class IdentifyOptions:
    """What gives coefficients SI units, what the answer is tried on, how sure it is, and its paragraph."""

    title: ClassVar[str] = MODEL

    inertia: str | None = option("KG*M^2[±ERROR]", "Moment of inertia: torques in SI units too.")
    mass: str | None = option("KG[±ERROR]", "Mass that is displaced: forces in SI units too.")
    load: str | None = option("N[±ERROR]", "Normal load of the contact: the coefficient of friction.")
    radius: str | None = option(
        "M[±ERROR]", "At which the contact rubs, of an angle: 2/3 of a disc that spins under even pressure."
    )
    test: Path | None = option("RECORD", "Another record, read alike, which the answer predicts.")
    warm_up: float | None = option(
        "S", "Beginning of driven records that does not count; to it the start of --test is fitted."
    )
    profile: str | None = option(
        "A,B,...",
        "Coefficients and shapes (dahl.s) with intervals of the profile likelihood; lambda:delta, contours.",
        title=SURE,
    )
    sensitivity: bool = switch(
        "--sensitivity", "Fit the same forces over windows, starts, sampling, noise models and methods.", SURE
    )
    methods: Path | None = option(
        "FILE.tex",
        "Where to write a paragraph on the methods, and FILE.bib with what it cites.",
        title=OUTPUT,
        ending=".tex",
    )


@dataclass(frozen=True)
class CampaignOptions:
    """What is done with all records, on how many processes, what they are held against, and the store."""

    title: ClassVar[str] = "Campaign"

    task: str = option("identify|compare|discover", "What is done with each record.", "identify")
    methods: str | None = option(
        "A,B,...", "Methods that identify, none held against another: averaging,direct,trajectory."
    )
    study: Path | None = option("FILE", "Simulated records, drawn from a description in TOML.")
    conditions: Path | None = option(
        "FILE", "Table (CSV) of conditions, a row a record: load, humidity, wear."
    )
    laboratories: str | None = option("COLUMN", "Column of the conditions: laboratories of ISO 5725.")
    workers: int = option("N", "Processes on this machine; 0: this one.", 2, least=0)
    scheduler: str | None = option("ADDRESS", "Scheduler of dask, such as tcp://host:8786.")
    memory: str = option("SIZE", "Most of each process, such as 2GB.", "auto")
    output: Path | None = option(
        "STORE",
        "Zarr store of the results; its page has the same name (.html) and replaces one that is there.",
        flags=WRITTEN_BY,
        title=OUTPUT,
    )
    as_json: bool = switch("--json", "Print the result as JSON, and nothing else.", OUTPUT)


@dataclass(frozen=True)
class SimulationOptions:
    """The model that moves, how it starts, how long it is recorded, and what disturbs it."""

    title: ClassVar[str] = "Record"

    set_: list[str] = option(
        "SYMBOL=VALUE", "A coefficient or shape (dahl.s=0.02); repeat.", [], flags=("--set",), title=MODEL
    )
    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY, title=MODEL)
    reference_frequency: float = option("RAD/S", "Reference frequency.", 9.91, within=POSITIVE, title=MODEL)
    duration: float = option("S", "Length of the record.", 25.0, within=POSITIVE)
    sampling_rate: float = option("HZ", "Samples a second.", 100.0, within=POSITIVE)
    # Beyond this angle a motion is said to diverge.
    angle0: float = option("RAD", "Angle at the start.", 0.3, within=(-1e3, 1e3, " rad"))
    rate0: float = option("RAD/S", "Angular rate at the start.", 0.0, within=(-MOST, MOST, " rad/s"))
    noise: float = option("RAD", "Standard deviation of white noise.", 0.0, within=(0.0, 1e3, " rad"))
    random_force: float = option(
        "DENSITY",
        "Of a white acceleration, one-sided, (rad/s^2)^2/Hz.",
        0.0,
        within=(0.0, MOST, " (rad/s^2)^2/Hz"),
    )
    seed: int = option(None, "Seed of the noise and of the random force.", 0)
    output: Path = option(
        "RECORD.csv|.nc", WHERE_TO_WRITE, ..., flags=WRITTEN_BY, title=OUTPUT, ending=".csv .nc"
    )


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


@dataclass(frozen=True)
class SweepOptions:
    """How a model is driven, and in which range of frequencies."""

    title: ClassVar[str] = "Drive"

    drive: float = option(
        "AMPLITUDE",
        "Amplitude of the input in its unit; of a model without one the deflection it has at rest.",
        ...,
        within=POSITIVE,
    )
    frequencies: str = option("LOW:HIGH", "Range, over the frequency at small amplitudes.", "0.9:1.1")
    driven_by: str = option("NAME", "Input that drives, of a model with several.", "")
    base: bool = switch(
        "--base",
        "Of a model without inputs: the drive is the displacement of a base, from which the signal counts.",
    )
    points: int = option("N", "Frequencies.", 201, least=2)
