"""`campaign`: many records by one task, into one store that can be gone on with."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.campaigns.run import finished_blocks
from sysid_trib.campaigns.store import Store, open_store
from sysid_trib.campaigns.study import Study
from sysid_trib.campaigns.task import NAMES, Name, Read, Task, decays_of_file
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Averaging, Direct
from sysid_trib.methods.scope import Method
from sysid_trib.validation.compare import every_method
from sysid_trib.validation.progress import Tell, silent

# Blocks of a store at least, and the most records that a block holds: what a kill may cost.
BLOCKS, LARGEST_BLOCK = 1000, 100
EXTRA = ("distributed", "zarr")


def campaign(
    records: Sequence[str | os.PathLike[str] | xr.Dataset] | Study,
    task: Name,
    library: ForceLibrary,
    *,
    output: str | os.PathLike[str],
    methods: Mapping[str, Method] | None = None,
    judged: bool | None = None,
    candidates: ForceLibrary | None = None,
    constraints: Constraints | None = None,
    contactless: tuple[float, float] | None = None,
    options: Mapping[str, Any] | None = None,
    read: Read = decays_of_file,
    workers: int = 2,
    scheduler: str | None = None,
    memory: str = "auto",
    tell: Tell = silent,
) -> xr.Dataset:
    """Do one task with many records, on several processes or machines, into one Zarr store.

    Parameters
    ----------
    records : sequence of path or Dataset, or Study
        Files, decays in memory, or simulated records drawn from a description (`load_study`).
    task : {"identify", "compare", "discover"}
    library : ForceLibrary
        The forces offered; of `discover` those of the start model.
    output : path-like
        The store. One that is there is gone on with: what is done in it is not done again.
    methods : mapping of str to method, optional
        By label. Without it `identify` takes averaging and direct with a random force that is estimated,
        and `compare` every method.
    judged : bool, optional
        Whether the two methods of `identify` are held against each other, which gives a verdict and takes
        longer than they do; by default where no methods are given.
    candidates : ForceLibrary, optional
        What may be missing, of `discover`.
    constraints, contactless
        As `compare` takes them.
    options : mapping, optional
        Further arguments of `cross_check` or `discover`.
    read : callable, optional
        Gives the free decays of a file: runs of one experiment.
    workers : int
        Processes on this machine; 0: this process alone, without dask.
    scheduler : str, optional
        Address of a scheduler of dask (tcp://...), whose workers see the files under the same names.
    memory : str
        Of each worker on this machine ("2GB"), by default its part of all; one that needs more is replaced.
    tell : Tell, optional
        Called with what is done and what failed.

    Returns
    -------
    Dataset
        Over `record`, `method`, `force`: `coefficient` with `standard_error`; over `record` and `method`
        reference and asymptotic frequency (rad/s), `noise`, density of the random force, with errors; over
        `record`: `status` (0 waiting, 1 done, 2 refused, 3 failed, 4 lost with its worker), `message` of a
        record without numbers, `verdict`, `named` effects, `p_value` of the agreement of both methods,
        `seconds`; of a study `true_coefficient`. Values are read when they are used.

    Raises
    ------
    UsageError
        No records, an unknown task, a store of another campaign, no scheduler, or no dask or zarr.
    RecordError
        The store cannot be written.

    Notes
    -----
    Records of a study have seeds of their own (`SeedSequence` by the record's number): results depend neither
    on the number of workers nor on the order. One bad record ends nothing; one whose worker died four times
    is given up, and tried again when the campaign is gone on with.
    """
    check_extra()
    asked = _task(task, library, methods, judged, candidates, constraints, contactless, options, read)
    names = names_of(records)
    path = Path(output)
    count = len(names)
    block = max(1, min(LARGEST_BLOCK, count // BLOCKS))
    store = Store(path, asked, names, _fingerprint(asked, records, names), block, isinstance(records, Study))
    blocks = store.unfinished()
    done, bad = count - sum(len(at) for at in blocks), store.without_result()

    def record_at(at: int) -> Any:
        record = (records, int(at)) if isinstance(records, Study) else records[at]
        return os.fspath(record) if isinstance(record, os.PathLike) else record

    tell("workers")
    for at, rows in finished_blocks(
        asked, blocks, record_at, workers=workers, scheduler=scheduler, memory=memory
    ):
        store.write(at, rows)
        done += len(at)
        bad += sum(row["status"] > 1 for row in rows)
        tell(f"{done:,} of {count:,} records, {bad:,} without a result", done / count)
    return open_store(path)


def check_extra() -> None:
    """Refuse a campaign where dask or zarr is not there.

    Raises
    ------
    UsageError
        With what installs them.
    """
    if lacking := [name for name in EXTRA if find_spec(name) is None]:
        raise UsageError(f"A campaign needs {' and '.join(lacking)}: pip install '.[campaigns]' in a clone.")


def _task(
    task: Name,
    library: ForceLibrary,
    methods: Mapping[str, Method] | None,
    judged: bool | None,
    candidates: ForceLibrary | None,
    constraints: Constraints | None,
    contactless: tuple[float, float] | None,
    options: Mapping[str, Any] | None,
    read: Read,
) -> Task:
    if task not in NAMES:
        raise UsageError(f"task {task!r} is unknown: give {', '.join(NAMES)}.")
    if not isinstance(library, ForceLibrary):
        raise UsageError(f"campaign wants a ForceLibrary, not {library!r}: load_library('contact_forces').")
    if task == "discover" and candidates is None:
        raise UsageError("A campaign of discover wants candidates: load_library('candidate_effects').")
    judged = task == "identify" and (methods is None if judged is None else judged)
    if judged and methods is not None and len(methods) != 2:
        raise UsageError("Two methods are held against each other; give two, or judged=False.")
    if methods is None:
        pair = {"averaging": Averaging(random_force="auto"), "direct": Direct(random_force="auto")}
        methods = every_method() if task == "compare" else pair
    return Task(
        task,
        library,
        dict(methods),
        candidates if task == "discover" else None,
        judged,
        read,
        constraints or Constraints(),
        contactless,
        dict(options or {}),
    )


def names_of(records: Sequence[Any] | Study) -> list[str]:
    """Names of the records in the store."""
    if isinstance(records, Study):
        return [str(at) for at in range(len(records))]
    if isinstance(records, str | os.PathLike | xr.Dataset) or not len(records):
        raise UsageError("A campaign wants a list of records, of one at least.")
    names = [
        str(record.attrs.get("source", f"record {at}"))
        if isinstance(record, xr.Dataset)
        else os.fspath(record)
        for at, record in enumerate(records)
    ]
    if not all(isinstance(name, str) for name in names):
        raise UsageError("Names of records must be texts.")
    return names


def _fingerprint(task: Task, records: Sequence[Any] | Study, names: Sequence[str]) -> str:
    """What a store must have been begun with to be gone on with."""
    in_memory = [] if isinstance(records, Study) else [r for r in records if isinstance(r, xr.Dataset)]
    sums = [hashlib.sha256(record["angle"].values.tobytes()).hexdigest() for record in in_memory]
    study = asdict(records) if isinstance(records, Study) else {}
    forces = [task.library.to_toml(), "" if task.candidates is None else task.candidates.to_toml()]
    told = [
        __version__,
        task.name,
        list(names),
        sums,
        study,
        forces,
        _methods_text(task),
        repr(task.constraints),
    ]
    told += [repr(task.contactless), repr(sorted(task.options.items())), _callable_text(task.read)]
    return hashlib.sha256(json.dumps(told, sort_keys=True, default=repr).encode()).hexdigest()


def _methods_text(task: Task) -> str:
    return repr(sorted((label, repr(method)) for label, method in task.methods.items()))


def _callable_text(read: Any) -> str:
    """What is called, without its address in memory."""
    inner = getattr(read, "func", read)
    given = (getattr(read, "args", ()), getattr(read, "keywords", {}))
    return f"{inner.__module__}.{inner.__qualname__} {given!r}"
