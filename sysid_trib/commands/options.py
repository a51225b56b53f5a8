"""Options of the commands with their types and defaults; `commands.toml` has their help."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Self

# Start model of the embedded example, from which a search can find two elastic forces.
EXAMPLE_FORCES = "lambda,zeta,delta"
# No oscillator is outside of this range in rad/s, Hz or s; far outside of it, arithmetic overflows.
LEAST = 1e-9
MOST = 1e9
POSITIVE = (LEAST, MOST, "")

# Rows of the table, by the names of options, completed with defaults.
OptionRows = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class CommandOptions:
    """Options of a command with their given values."""

    def but(self, **values: Any) -> Self:
        """Return the options with some values replaced."""
        return replace(self, **values)

    def changed(self, names: Iterable[str]) -> list[str]:
        """Return the flags of the given options whose values differ from their defaults."""
        rows = all_rows()
        defaults = defaults_of(type(self))
        return [rows[name]["flag"] for name in names if getattr(self, name) != defaults[name]]


@dataclass(frozen=True, kw_only=True)
class ModeOptions(CommandOptions):
    """One of several modes in a decay, and how the record is read."""

    time: str | None = None
    angle: str | None = None
    units: str | None = None
    sampling_rate: float | None = None
    window: str = ":"
    mode: int | None = None
    band: str | None = None


@dataclass(frozen=True, kw_only=True)
class RecordOptions(ModeOptions):
    """Records and how they are read."""

    records: list[Path] = field(default_factory=list)
    signal: str | None = None
    time_units: str | None = None
    equilibrium: str = "auto"
    decay: int | None = None
    keep_outliers: bool = False
    system: str | None = None
    input_: str | None = None
    constant: list[str] = field(default_factory=list)
    between: str | None = None
    scale: str = "1"
    length: float | None = None
    distance: float | None = None


@dataclass(frozen=True, kw_only=True)
class ForcesOptions(RecordOptions):
    """Offered forces, and the frequency to which their coefficients refer."""

    library: str = "contact_forces"
    forces: str | None = None
    reference_frequency: float | None = None


@dataclass(frozen=True, kw_only=True)
class ConstraintOptions(CommandOptions):
    """Constraints on coefficients and shape parameters."""

    fix: list[str] = field(default_factory=list)
    bound: list[str] = field(default_factory=list)
    tie: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class ModelOptions(ForcesOptions, ConstraintOptions):
    """Forces to identify, with their constraints."""

    omega0: str | None = None
    random_force: str = "auto"
    set_: list[str] = field(default_factory=list)
    own: str | None = None


@dataclass(frozen=True, kw_only=True)
class StartOptions(ForcesOptions):
    """The start model of a search, and the part of the record that it predicts."""

    holdout: str | None = None


@dataclass(frozen=True, kw_only=True)
class SearchOptions(ForcesOptions):
    """Limits of a search."""

    candidates: str | None = None
    max_effects: int = 4
    refit: bool = False
    level: float = 0.01
    time_limit: float | None = None


@dataclass(frozen=True, kw_only=True)
class SIOptions(CommandOptions):
    """Measured quantities for SI units."""

    inertia: str | None = None
    mass: str | None = None
    load: str | None = None
    radius: str | None = None


@dataclass(frozen=True, kw_only=True)
class MeasuredOptions(SIOptions):
    """Measured quantities for SI units, and another record to predict."""

    test: Path | None = None
    warm_up: float | None = None


@dataclass(frozen=True, kw_only=True)
class ShownOptions(CommandOptions):
    """Forms in which a result is shown."""

    as_json: bool = False
    plot: Path | None = None
    width: float = 180.0


@dataclass(frozen=True, kw_only=True)
class FileOptions(CommandOptions):
    """Files of a result."""

    output: Path | None = None
    csv: Path | None = None


@dataclass(frozen=True, kw_only=True)
class DestinationOptions(FileOptions, ShownOptions):
    """Amount of printed text, and tables for LaTeX."""

    latex: Path | None = None
    explain: bool = False
    quiet: bool = False


@dataclass(frozen=True, kw_only=True)
class LookOptions(RecordOptions, ShownOptions):
    """Options of `look`."""


@dataclass(frozen=True, kw_only=True)
class BackboneOptions(RecordOptions, ShownOptions, FileOptions):
    """Options of `backbone`."""


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(ModelOptions, MeasuredOptions, DestinationOptions):
    """Options of `identify`."""

    starts: str = "fitted"
    profile: str | None = None
    sensitivity: bool = False
    methods_text: Path | None = None


@dataclass(frozen=True, kw_only=True)
class DiscoverOptions(StartOptions, SearchOptions, DestinationOptions):
    """Options of `discover`."""


@dataclass(frozen=True, kw_only=True)
class LawsOptions(RecordOptions, ConstraintOptions, MeasuredOptions, DestinationOptions):
    """Options of `laws`."""

    library: str = "contact_forces"
    random_force: str = "off"
    passive: bool = False
    own: str | None = None
    width: float = 88.0


@dataclass(frozen=True, kw_only=True)
class CompareOptions(ModelOptions, DestinationOptions):
    """Options of `compare`."""


@dataclass(frozen=True, kw_only=True)
class DifferenceOptions(ModelOptions, DestinationOptions):
    """Options of `difference`."""

    laws: bool = False


@dataclass(frozen=True, kw_only=True)
class PlanOptions(ModelOptions, ShownOptions):
    """Options of `plan`."""

    amplitude: str = ":"
    duration: str = ":"
    rate: float | None = None
    repeats: int = 1
    want: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class ResponseOptions(ModeOptions, ShownOptions, FileOptions):
    """Options of `response`."""

    result: Path
    drive: float
    frequencies: str = "0.9:1.1"
    driven_by: str = ""
    base: bool = False
    points: int = 201
    modal_mass: float | None = None


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(ModelOptions, SearchOptions, SIOptions):
    """Options of `campaign`."""

    task: str = "identify"
    methods: str | None = None
    speeds: str | None = None
    conditions: Path | None = None
    laboratories: str | None = None
    workers: int = 2
    scheduler: str | None = None
    memory: str = "auto"
    output: Path | None = None
    as_json: bool = False


@dataclass(frozen=True, kw_only=True)
class SimulateOptions(CommandOptions):
    """Options of `simulate`."""

    set_: list[str] = field(default_factory=list)
    library: str = "contact_forces"
    reference_frequency: float = 9.91
    duration: float = 25.0
    sampling_rate: float = 100.0
    angle0: float = 0.3
    rate0: float = 0.0
    noise: float = 0.0
    random_force: float = 0.0
    seed: int = 0
    output: Path


@dataclass(frozen=True, kw_only=True)
class ReportOptions(CommandOptions):
    """Options of `report`."""

    result: Path
    output: Path


@dataclass(frozen=True, kw_only=True)
class ExportOptions(CommandOptions):
    """Options of `export`."""

    result: Path
    language: str = "python"
    output: Path | None = None


@dataclass(frozen=True, kw_only=True)
class AppOptions(CommandOptions):
    """Options of `app`."""

    record: Path | None = None
    port: int = 8723
    no_browser: bool = False


@dataclass(frozen=True, kw_only=True)
class LibraryOptions(CommandOptions):
    """Options of `forces`."""

    library: str = "contact_forces"
    latex: Path | None = None


@dataclass(frozen=True, kw_only=True)
class DatasetsOptions(CommandOptions):
    """Options of `datasets`."""

    as_json: bool = False


# Class of the options of each command in the table.
OPTIONS_OF: dict[str, type[CommandOptions]] = {
    "look": LookOptions,
    "backbone": BackboneOptions,
    "identify": IdentifyOptions,
    "discover": DiscoverOptions,
    "laws": LawsOptions,
    "compare": CompareOptions,
    "difference": DifferenceOptions,
    "plan": PlanOptions,
    "response": ResponseOptions,
    "campaign": CampaignOptions,
    "simulate": SimulateOptions,
    "report": ReportOptions,
    "export": ExportOptions,
    "forces": LibraryOptions,
    "datasets": DatasetsOptions,
    "app": AppOptions,
}


def defaults_of(options: type[CommandOptions]) -> dict[str, Any]:
    """Return the defaults of the options of a class by name; `...` for a required option."""
    defaults = dict[str, Any]()
    for option in fields(options):
        if option.default_factory is not MISSING:
            defaults[option.name] = option.default_factory()
        else:
            defaults[option.name] = ... if option.default is MISSING else option.default
    return defaults


TABLE = tomllib.loads(Path(__file__).with_name("commands.toml").read_text(encoding="utf-8"))
# OptionRows of the commands by name.
COMMANDS: dict[str, Any] = TABLE.pop("commands")


def _whole(name: str, title: str, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row of an option, completed with defaults."""
    whole: dict[str, Any] = {"title": title, "flag": f"--{name.replace('_', '-')}", **row}
    if whole.get("within") == "positive":
        whole["within"] = POSITIVE
    return whole | {"help": whole["help"].format(example=EXAMPLE_FORCES)}


# OptionRows of the options by name, in groups by the name of the group.
GROUPS: dict[str, OptionRows] = {
    group: {
        name: _whole(name, rows["title"], TABLE[row][name] if isinstance(row, str) else row)
        for name, row in rows.items()
        if name != "title"
    }
    for group, rows in TABLE.items()
}


def rows_of(*groups: str) -> OptionRows:
    """Return the rows of groups by the names of their options."""
    return {name: row for group in groups for name, row in GROUPS[group].items()}


def rows_of_command(command: str) -> OptionRows:
    """Return the rows of a command in the order of its help."""
    return rows_of(*COMMANDS[command]["options"])


@cache
def all_rows() -> OptionRows:
    """Return one row for every option; an option has the same flag in all commands."""
    return rows_of(*GROUPS)
