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
from sysid_trib.forces.constraints import ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.offered import further_forces
from sysid_trib.methods import Averaging, Direct, scope
from sysid_trib.methods.options import constrained, with_random_force, with_stated
from sysid_trib.physics.si_laws import laws_in_si
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.in_memory import one_record
from sysid_trib.records.read import read_records
from sysid_trib.records.runs import Decays, RecordLike, one_or_all
from sysid_trib.results import effects, judged, variables
from sysid_trib.results.judged import SEARCH_OUTCOME
from sysid_trib.results.kinds import MU
from sysid_trib.results.references import with_contactless_frequency
from sysid_trib.results.schema import force_labels
from sysid_trib.results.store import EFFECT_P_VALUE, JUDGED_NAMES, STORE_FORMAT, TIED, Status
from sysid_trib.smooth_laws.bands import interpolation
from sysid_trib.smooth_laws.laws import laws
from sysid_trib.validation import compare
from sysid_trib.validation.identify import identified_and_judged, identify, usual_methods
from sysid_trib.validation.method_labels import by_unique_label

Name: TypeAlias = Literal["identify", "compare", "discover", "laws"]
Read: TypeAlias = Callable[[str], Sequence[xr.Dataset]]
# Files, names that the task can read, or decays in memory.
CampaignRecords: TypeAlias = Sequence[str | os.PathLike[str] | RecordLike]

TASKS = get_args(Name)
# Groups of a discovery with identifications: the start model and the final one.
MODELS = ("before", "after")
# `identify` and `laws` use two of these methods, depending on the record.
USUAL_LABELS = ("averaging", "trajectory", "direct")


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
        Function that is run on each record.
    library : ForceLibrary, str, or what `library` takes, optional
        The offered forces, by default those of `contact_forces`; for `discover` those of the start model, by
        default viscous friction; for `laws` those that may be named and used in formulas.
    methods : mapping of str to method, optional
        Methods by label. By default, `identify` uses the two methods of the command for each record
        (`usual_methods`), and `compare` every method.
    candidates : ForceLibrary, str, or what `library` takes, optional
        Candidates of `discover`; by default those of the command.
    cross_checked : bool, optional
        Compare the two methods of `identify` with each other, which takes longer than the methods. The
        default is True if no methods are given.
    read : callable
        Function that returns the free decays of a file: runs of one experiment.
    constraints : mapping of str to float, (float, float) or str
        Fixed values, bounds and ties, as in `identify`.
    contactless : (float, float), rad/s, optional
        Frequency without contact and its standard error; with it, alpha is identified too.
    options : mapping
        Further arguments of `discover` or `laws`; for `identify` without `methods`, the options
        `reference_frequency`, `shapes` and `random_force` of its two methods.
    speeds : sequence of float
        For `laws`: speeds at which the friction of each record is stored, in the signal's unit per second, or
        in m/s with a mass. A speed that a record does not reach has the value nan.
    measured : mapping of str to (float, float)
        For `laws`: inertia or mass, load and radius with their errors, as in `laws_in_si`.

    Raises
    ------
    UsageError
        An unknown task, not a library, not two methods to cross-check, or laws without speeds.

    Examples
    --------
    >>> import sysid_trib as st
    >>> methods = {"energy": st.methods.EnergyDecay(), "direct": st.methods.Direct()}
    >>> task = st.campaigns.Task("compare", "lambda,zeta", methods=methods)
    >>> task.labels, task.forces.symbols
    (['energy', 'direct'], ('lambda', 'zeta'))
    """

    name: Name
    library: ForceLibrary = field(default_factory=load_library)
    methods: Mapping[str, scope.Method] = field(default_factory=dict)
    candidates: ForceLibrary | None = None
    cross_checked: bool | None = None
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
        checked = not self.methods if self.cross_checked is None else self.cross_checked
        object.__setattr__(self, "cross_checked", checked and self.name == "identify")
        methods = dict(self.methods)
        if self.cross_checked and methods and len(methods) != 2:
            raise UsageError("A cross-check needs two methods; give two, or cross_checked=False.")
        if not methods and self.name == "compare":
            methods = compare.every_method()
        elif not methods and self.name == "identify" and not self.cross_checked:
            methods = {"averaging": Averaging(), "direct": Direct()}
        named = by_unique_label([*methods.items()], compare.RESERVED)
        object.__setattr__(self, "methods", named)

    @property
    def labels(self) -> list[str]:
        """Labels of the identifications of a record."""
        if self.name == "discover":
            return list(MODELS)
        return list(self.methods) or list(USUAL_LABELS)

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
        """Return the result of the task's function for a record.

        Examples
        --------
        >>> import sysid_trib as st
        >>> task = st.campaigns.Task("identify", methods={"direct": st.methods.Direct()})
        >>> list(task.result([st.free_decay(st.records.paper_twin())]).children)
        ['direct', 'judged']
        """
        if self.name == "discover":
            assert self.candidates is not None
            return discover(decays, self.library, self.candidates, **self.options)
        if self.name == "laws":
            return laws(decays, library=self.library, constraints=dict(self.constraints), **self.options)
        if self.name == "compare":
            return compare.compare(
                decays, self.library, self.methods, contactless=self.contactless, constraints=self.constraints
            )
        runs = one_or_all(list(decays))
        if self.cross_checked:
            chosen = [*self.methods.values()] or self._usual_methods(runs)
            return identify(
                runs, self.library, chosen, constraints=self.constraints, contactless=self.contactless
            )
        methods = {
            label: constrained(method, with_stated(self.constraints, self.library, method))
            for label, method in self.methods.items()
        }
        tree = identified_and_judged(runs, self.library, methods, made_by="campaign")
        return tree if self.contactless is None else with_contactless_frequency(tree, *self.contactless)

    def _usual_methods(self, runs: Decays) -> list[scope.Method]:
        """Return the two methods of the command `identify` for a record, with the options of the task."""
        options = dict(self.options)
        random_force = options.pop("random_force", "auto")
        return [
            with_random_force(method, random_force) for method in usual_methods(runs, self.library, **options)
        ]

    def labels_in(self, tree: xr.DataTree) -> dict[str, str]:
        """Return the label in a store of each identification of a result, by the name of its group."""
        if self.cross_checked and self.methods:
            # A cross-check names its groups by the methods.
            return dict(zip(judged.judged_of(tree).model.values.tolist(), self.methods, strict=True))
        return {label: label for label in self.labels}


def empty_row(task: Task) -> stored.Row:
    """Return a row without a result: nan, and empty texts."""
    sizes = {dim: len(names) for dim, names in task.axes.items()} | {"part": stored.OUTLINE_PARTS}
    without: set[str] = set()
    if task.name != "discover":
        without.update(stored.OF_SEARCH)
    if not task.cross_checked:
        without.update(stored.OF_CROSS_CHECK)
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
    """Return the numbers of a result as a row of the store."""
    row = empty_row(task)
    labels = task.labels_in(tree)
    numbers = [
        name
        for name, empty in row.items()
        if "model" in stored.VARIABLES[name][0] and name not in JUDGED_NAMES and empty.size
    ]
    row = {name: row[name] for name in numbers}
    axes = task.axes
    # Numbers that are not shown in the text of a record are not stored either.
    withheld = judged.failures(tree) if task.cross_checked else {}
    for group, label in labels.items():
        if group not in tree.children or "covariance" not in tree[group] or group in withheld:
            continue
        result = tree[group].to_dataset()
        at = task.labels.index(label)
        for name in (name for name in numbers if name in result):
            # Forces and shape parameters that are not in the result stay nan.
            of_store = {dim: axes[dim] for dim in stored.VARIABLES[name][0][1:]}
            row[name][at] = result[name].reindex(of_store) if of_store else np.mean(result[name])
        if task.name == "laws":
            row["coefficient"][at], row["standard_error"][at] = _frictions(task, result)
    row |= _judged(task, tree, labels)
    if task.cross_checked and "p_value" in tree["agreement"]:
        # There is no such test for driven records.
        row["agreement_p_value"] = float(tree["agreement"].p_value)
    if task.name == "discover":
        row |= _of_search(tree, task.forces.symbols)
    return row


def _judged(task: Task, tree: xr.DataTree, labels: Mapping[str, str]) -> stored.Row:
    """Return the variables of `judged` for each model of the store, and the preferred model."""
    table = judged.judged_of(tree)[list(JUDGED_NAMES)]
    table = table.assign_coords(model=[labels[name] for name in table.model.values.tolist()])
    texts = {name: "" for name, of in table.data_vars.items() if of.dtype.kind in "UO"}
    table = table.reindex(model=task.labels, fill_value=texts)
    values = {name: table[name].values for name in JUDGED_NAMES}
    return values | {"preferred": labels[judged.preferred_of(tree)]}


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


def _of_search(tree: xr.DataTree, symbols: Sequence[str]) -> stored.Row:
    """Return the outcome of a search, and its effects with their p-values and competing effects."""
    steps = effects.steps_taken(tree)
    p_values = {step.symbol.item(): step.p_value.item() for step in steps}
    # Competing effects that are stored by name: the most probable of each effect.
    tied = [effects.tied_name(step, 10) for step in steps if effects.alternatives_of(step)]
    return {
        SEARCH_OUTCOME: tree.attrs[SEARCH_OUTCOME],
        "converged": bool(tree["converged"]),
        "named": ", ".join(p_values),
        TIED: "; ".join(tied),
        EFFECT_P_VALUE: np.array([p_values.get(symbol, np.nan) for symbol in symbols]),
    }


def fingerprint(records: CampaignRecords, task: Task) -> str:
    """Return the text that identifies a campaign; further records may be added."""
    libraries = [library.to_toml() for library in (task.library, task.candidates) if library is not None]
    methods = {label: repr(method) for label, method in task.methods.items()}
    asked: list[Any] = [task.name, task.cross_checked, methods]
    asked += [repr(task.constraints), repr(task.contactless)]
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
