"""Task of a campaign for each record, and its row of numbers."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import scipy
import xarray as xr

from sysid_trib import forces
from sysid_trib._version import __version__
from sysid_trib.campaigns import rows as stored
from sysid_trib.discovery.discover import discover
from sysid_trib.errors import SysidTribError, UsageError, readable
from sysid_trib.forces.constraints import Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.offered import further_forces
from sysid_trib.methods import Averaging, Direct, Trajectory, scope
from sysid_trib.methods.options import constrained
from sysid_trib.physics.si_laws import laws_in_si
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.in_memory import one_record
from sysid_trib.records.read import read_records
from sysid_trib.records.runs import RecordLike, one_or_all
from sysid_trib.results import effects, judged, variables
from sysid_trib.results.kinds import MU
from sysid_trib.results.references import with_contactless_frequency
from sysid_trib.results.schema import force_labels
from sysid_trib.results.store import EFFECT_P_VALUE, PREDICTS_BEST, TIED, Status
from sysid_trib.smooth_laws.bands import interpolation
from sysid_trib.smooth_laws.laws import laws
from sysid_trib.validation import compare, cross_check, verdict

Name: TypeAlias = Literal["identify", "compare", "discover", "laws"]
Read: TypeAlias = Callable[[str], Sequence[xr.Dataset]]
# Files, names that the task can read, or decays in memory.
CampaignRecords: TypeAlias = Sequence[str | os.PathLike[str] | RecordLike]

TASKS = get_args(Name)
# Format number of a store; other versions may have other formats.
STORE_FORMAT = 4
# Groups of a discovery with identifications: the start model and the final one.
MODELS = ("before", "after")
# For laws: both methods, and the preferred one.
PREFERRED = "preferred"
LAW_LABELS = ("averaging", "direct", PREFERRED)


def names_of(records: CampaignRecords) -> list[str]:
    """Return the names of records in a store."""
    return [readable(_name_of(item, at)) for at, item in enumerate(records)]


def _name_of(record: Any, at: int) -> str:
    """Return the name of a record by its position."""
    if isinstance(record, str | os.PathLike):
        return str(record)
    return str(getattr(record, "attrs", {}).get("source", f"record {at}"))


def record_at(records: CampaignRecords, at: int) -> str | xr.Dataset:
    """Return a record in the form for `rows_of`."""
    item = records[at]
    return os.fspath(item) if isinstance(item, str | os.PathLike) else one_record(item, "campaign")


def decays_of_file(path: str) -> list[xr.Dataset]:
    """Return the free decays of a file, read without options."""
    return [decay for record in read_records(path) for decay in free_decays(record)]


@dataclass(frozen=True)
class Task:
    """Task of a campaign for each record.

    Parameters
    ----------
    name : {"identify", "compare", "discover", "laws"}
    library : ForceLibrary, str, or what `library` takes, optional
        The offered forces, by default those of `contact_forces`; for `discover` those of the start model, by
        default viscous friction; for `laws` those that may be named and used in formulas.
    methods : mapping of str to method, optional
        Methods by label. By default, `identify` uses averaging and direct with an estimated random force, and
        `compare` uses every method.
    candidates : ForceLibrary, str, or what `library` takes, optional
        Candidates of `discover`; by default those of the command.
    judged : bool, optional
        Cross-check the two methods of `identify`. It gives a verdict and takes longer than the methods. The
        default is True if no methods are given.
    read : callable
        Function that returns the free decays of a file: runs of one experiment.
    constraints : mapping of str to float, (float, float) or str
        Fixed values, bounds and ties, as in `identify`.
    contactless : (float, float), rad/s, optional
    options : mapping
        Further arguments of `cross_check`, `discover` or `laws`.
    speeds : sequence of float
        For `laws`: speeds at which the friction of each record is stored, in the signal's unit per second, or
        in m/s with a mass. A speed that a record does not reach has the value nan.
    measured : mapping of str to (float, float)
        For `laws`: inertia or mass, load and radius with their errors, as in `laws_in_si`.

    Raises
    ------
    UsageError
        An unknown task, not a library, not two methods to cross-check, or laws without speeds.
    """

    name: Name
    library: ForceLibrary = field(default_factory=load_library)
    methods: Mapping[str, scope.Method] = field(default_factory=dict)
    candidates: ForceLibrary | None = None
    judged: bool | None = None
    read: Read = decays_of_file
    constraints: ConstraintTable = field(default_factory=dict)
    contactless: tuple[float, float] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    speeds: Sequence[float] = ()
    measured: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.name not in TASKS:
            raise UsageError(f"task {self.name!r} is unknown: give {', '.join(TASKS)}.")
        object.__setattr__(self, "library", forces.as_library(self.library, "Task"))
        if self.candidates is not None:
            object.__setattr__(self, "candidates", forces.as_library(self.candidates, "Task, candidates=,"))
        if (self.name == "laws") != bool(self.speeds):
            raise UsageError(
                "The task laws needs at least one speed, such as speeds=(0.1, 0.5); other tasks take none."
            )
        if not all(speed > 0.0 and np.isfinite(speed) for speed in self.speeds):
            raise UsageError("The speeds of laws are numbers above 0.")
        if self.name == "discover" and self.candidates is None:
            object.__setattr__(self, "candidates", further_forces(load_library(), self.library))
        judged = not self.methods if self.judged is None else self.judged
        object.__setattr__(self, "judged", judged and self.name == "identify")
        if not self.methods:
            usual = {"averaging": Averaging(), "direct": Direct()}
            object.__setattr__(self, "methods", compare.every_method() if self.name == "compare" else usual)
        if self.judged and len(self.methods) != 2:
            raise UsageError("A cross-check needs two methods; give two, or judged=False.")

    @property
    def labels(self) -> list[str]:
        """Labels of the identifications of a record."""
        if self.name == "laws":
            return list(LAW_LABELS)
        return list(MODELS) if self.name == "discover" else list(self.methods)

    @property
    def forces(self) -> ForceLibrary:
        """All forces that a result of the task may contain."""
        of = {force.symbol: force for library in (self.library, self.candidates or ()) for force in library}
        return ForceLibrary("all", tuple(of.values()))

    @property
    def quantities(self) -> dict[str, tuple[str, float]]:
        """Names of the force axis, each with its unit and the degree of a force in the rate.

        For laws, it is the friction at each speed, over the inertia or in SI units, and its coefficient.
        """
        if self.name != "laws":
            labels = force_labels(list(self.forces))
            units, degrees = labels["unit"][1], labels["speed_degree"][1]
            pairs = zip(units, degrees, strict=True)
            return dict(zip(self.forces.symbols, pairs, strict=True))
        unit = "signal/s^2"
        if self.measured:
            unit = "N" if "mass" in self.measured else "N m"
        named = {f"friction({speed:g})": (unit, np.nan) for speed in self.speeds}
        if "load" in self.measured:
            named |= {f"mu({speed:g})": ("1", np.nan) for speed in self.speeds}
        return named

    @property
    def axes(self) -> dict[str, list[str]]:
        """Labels of the dimensions of a row."""
        names = {"model": self.labels, "force": list(self.quantities), "edge": list(stored.EDGES)}
        shapes = [] if self.name == "laws" else list(self.forces.shape_values())
        return names | {"shape_parameter": shapes}

    def result(self, decays: Sequence[xr.Dataset]) -> xr.DataTree:
        """Return the result of the task's function for a record."""
        if self.name == "discover":
            assert self.candidates is not None
            return discover(decays, self.library, self.candidates, **self.options)
        if self.name == "laws":
            return laws(decays, library=self.library, constraints=dict(self.constraints), **self.options)
        if self.name == "compare":
            return compare.compare(
                decays, self.library, self.methods, contactless=self.contactless, constraints=self.constraints
            )
        methods = dict(self.methods)
        averaging, taken = methods.get("averaging"), [decay.attrs.get("taken_as_it_is") for decay in decays]
        if self.judged and isinstance(averaging, Averaging) and any(taken):
            # There is no envelope for averaging: the motion is fitted, as in `identify`.
            names = ("reference_frequency", "shapes", "random_force")
            trajectory = Trajectory(**{name: getattr(averaging, name) for name in names})
            methods = {"trajectory": trajectory} | {k: m for k, m in methods.items() if m is not averaging}
        table = Constraints(self.constraints)
        chosen = [constrained(method, table) for method in methods.values()]
        asked = one_or_all(list(decays)), self.library, chosen
        if self.judged:
            tree = cross_check.identified_and_checked(*asked, **self.options)
        else:
            tree = xr.DataTree.from_dict(dict(zip(methods, verdict.identifications(*asked), strict=True)))
        return tree if self.contactless is None else with_contactless_frequency(tree, *self.contactless)


def empty_row(task: Task) -> stored.Row:
    """Return a row without a result: nan, and empty texts."""
    sizes = {dim: len(names) for dim, names in task.axes.items()} | {"part": stored.OUTLINE_PARTS}
    without = set() if task.name == "discover" else stored.OF_SEARCH
    return {name: stored.empty(name, sizes) for name in stored.VARIABLES if name not in without}


def rows_of(task: Task, records: Sequence[Any]) -> list[stored.Row]:
    """Compute the rows of some records in turn; a failed record has the reason instead of numbers.

    Parameters
    ----------
    task : Task
    records : sequence of str or Dataset
        Files, or decays.
    """
    return [_row_of(task, record) for record in records]


def _row_of(task: Task, record: Any) -> stored.Row:
    start, row = perf_counter(), empty_row(task)
    try:
        row["record_checksum"] = checksum_of(record)
        decays = [record] if isinstance(record, xr.Dataset) else task.read(record)
        row |= {"signal_units": variables.signal_units(decays[0]), "outline": _outline(decays[0])}
        row |= _numbers(task, task.result(decays)) | {"status": Status.DONE}
    except SysidTribError as error:
        row |= {"status": Status.REFUSED, "message": str(error)}
    except Exception as error:
        # An invalid record does not end a campaign; its error is stored with it.
        row |= {"status": Status.FAILED, "message": f"{type(error).__name__}: {error}"}
    return row | {"seconds": perf_counter() - start}


def _outline(decay: xr.Dataset) -> np.ndarray:
    """Return the lowest and highest value in each part of a decay's time: (edge, part), in its unit.

    A part without a sample is nan.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    edges = np.linspace(time[0], time[-1], stored.OUTLINE_PARTS + 1)
    return np.array(
        [scipy.stats.binned_statistic(time, angle, of, bins=edges).statistic for of in ("min", "max")]
    )


def checksum_of(record: Any) -> str:
    """Return the SHA-256 of a record's file; empty if the file cannot be read."""
    # Opening a pipe would block.
    if not isinstance(record, str) or not os.path.isfile(record):
        return ""
    try:
        with open(record, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def _numbers(task: Task, tree: xr.DataTree) -> stored.Row:
    """Write the numbers of a result to the arrays of a row."""
    row = {name: of for name, of in empty_row(task).items() if "model" in stored.VARIABLES[name][0]}
    axes = task.axes
    for at, label in enumerate(task.labels):
        # Numbers that are not shown in the text of a record are not stored either.
        if label == PREFERRED:
            label = judged.preferred_of(tree)
        given = label in tree.children and "covariance" in tree[label]
        if given and not (task.judged and label in judged.failures(tree)):
            result = tree[label].to_dataset()
            for name in (name for name, empty in row.items() if name in result and empty.size):
                # Forces and shape parameters that are not in the result stay nan.
                of_store = {dim: axes[dim] for dim in stored.VARIABLES[name][0][1:]}
                row[name][at] = result[name].reindex(of_store) if of_store else np.mean(result[name])
            if task.name == "laws":
                row["coefficient"][at], row["standard_error"][at] = _frictions(task, result)
    if "agreement" in tree.children and "p_value" in tree["agreement"]:
        row |= {"p_value": float(tree["agreement"].p_value), "verdict": judged.verdict_of(tree)}
    if task.name == "laws":
        row |= {"verdict": f"{judged.verdict_of(tree)}, by {judged.preferred_of(tree)}"}
    if task.name == "compare":
        row |= {"verdict": f"{PREDICTS_BEST}{tree['comparison'].attrs['best']}"}
    if task.name == "discover":
        # For a discovery, appended to its verdict.
        early = "" if tree["converged"] else " (its search ended before it had converged)"
        row |= {"verdict": f"{tree.attrs['verdict']}{early}"} | _named(tree, task.forces.symbols)
    return row


def _frictions(task: Task, result: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return friction and its coefficient at the task's speeds, with standard errors."""
    data = laws_in_si(result, **task.measured) if task.measured else result
    speeds = np.array(task.speeds)
    largest = float(np.max(data.speed.values[data.speed_visited.values]))
    weights = interpolation(data.speed.values, speeds)
    weights[speeds > largest * (1.0 + 1e-9)] = np.nan
    names = ["friction", *([MU] if "load" in task.measured else [])]
    values = [weights @ data[name].values for name in names]
    variances = [np.diag(weights @ data[f"{name}_covariance"].values @ weights.T) for name in names]
    return np.concatenate(values), np.sqrt(np.concatenate(variances))


def _named(tree: xr.DataTree, symbols: Sequence[str]) -> stored.Row:
    """Return the effects that a discovery named, each with its p-value and its competing effects."""
    steps = effects.steps_taken(tree)
    p_values = {step.symbol.item(): step.p_value.item() for step in steps}
    # Competing effects that are stored by name: the most probable of each effect.
    tied = [effects.tied_name(step, 10) for step in steps if effects.alternatives_of(step)]
    return {
        "named": ", ".join(p_values),
        TIED: "; ".join(tied),
        EFFECT_P_VALUE: np.array([p_values.get(symbol, np.nan) for symbol in symbols]),
    }


def fingerprint(records: CampaignRecords, task: Task) -> str:
    """Return the text that identifies a campaign; further records may be added."""
    libraries = [library.to_toml() for library in (task.library, task.candidates) if library is not None]
    methods = {label: repr(method) for label, method in task.methods.items()}
    asked: list[Any] = [task.name, task.judged, methods, repr(task.constraints), repr(task.contactless)]
    options = sorted((name, repr(value)) for name, value in task.options.items())
    if task.name == "laws":
        asked += [list(task.speeds), sorted(task.measured.items())]
    # Changes of files are recognised separately.
    held = [item for item in records if isinstance(item, xr.Dataset)]
    in_memory = [hashlib.sha256(item["angle"].values.tobytes()).hexdigest() for item in held]
    # Text of the function without its address in memory.
    inner = getattr(task.read, "func", task.read)
    given = (getattr(task.read, "args", ()), getattr(task.read, "keywords", {}))
    read = f"{inner.__module__}.{inner.__qualname__} {given!r}"
    content = [__version__, STORE_FORMAT, in_memory, libraries, asked, options, read]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
