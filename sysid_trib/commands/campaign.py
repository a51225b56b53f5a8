"""`sysid-trib campaign`, and what it does with each record, as its options have it."""

import json
from dataclasses import dataclass, fields, replace
from functools import partial
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from sysid_trib.commands.discover import StartOptions
from sysid_trib.commands.options import (
    OUTPUT,
    ConstraintOptions,
    DecayOptions,
    ModelOptions,
    SearchOptions,
    changed_flags,
    flag_of,
    option,
    switch,
    with_options,
)
from sysid_trib.errors import RecordError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr

    from sysid_trib.campaigns.task import Task

PAGE_ENDING, STORE_ENDING = ".html", ".zarr"


@dataclass(frozen=True)
class CampaignOptions:
    """What is done with all records, on how many processes, and what they are held against."""

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


@dataclass(frozen=True)
class CampaignStore:
    """Where the results of all records go."""

    title: ClassVar[str] = OUTPUT

    output: Path | None = option(
        "STORE",
        "Zarr store of the results; its page has the same name (.html) and replaces one that is there.",
        flags=("-o", "--output"),
    )
    as_json: bool = switch("--json", "Print the result as JSON, and nothing else.")


@with_options
def campaign(
    *,
    given: DecayOptions,
    model: ModelOptions,
    constraint: ConstraintOptions,
    search: SearchOptions,
    asked: CampaignOptions,
    into: CampaignStore,
) -> None:
    """Do one task with many records, on several processes, into a store that can be gone on with.

    Examples
    --------
    sysid-trib campaign 'swing*.csv' -o results.zarr
    sysid-trib campaign 'swing*.csv' --methods direct --workers 0 -o direct.zarr
    """
    from sysid_trib.commands.terminal import command_line, working

    with working() as tell:
        from sysid_trib.campaigns.campaign import campaign, check_extra
        from sysid_trib.campaigns.new_store import CampaignRecords
        from sysid_trib.campaigns.store import counts_of
        from sysid_trib.commands.destination import print_result
        from sysid_trib.printing.campaign import campaign_blocks, campaign_json

        check_extra()
        records = _records(given.records, asked.study, asked.conditions)
        reads = [*([] if asked.study else records), asked.study, asked.conditions]
        output = _checked_output(into.output, [*reads, model.library, search.candidates, given.system])
        table = _conditions(asked, CampaignRecords(records).names)
        store = campaign(
            records,
            _task(given, model, constraint, search, asked),
            output=output,
            workers=asked.workers if asked.scheduler is None else asked.scheduler,
            memory=asked.memory,
            tell=tell,
        )
        tell("what varies between the records")
        compared = _compared(store, table, asked.laboratories)
        tell("report")
        page, counts = output.with_suffix(PAGE_ENDING), counts_of(store)
        from sysid_trib.reporting.campaign import write_campaign

        write_campaign(store, compared, table, page, command_line())
    print_result(
        lambda: campaign_json(store, counts, compared),
        lambda: campaign_blocks(store, counts, compared),
        (output, page),
        as_json=into.as_json,
    )
    if not counts["done"]:
        raise RecordError(f"{output}: no record has a result; why each has none is in {page}.")


def decays_of(given: DecayOptions, model: ModelOptions, path: str) -> "Sequence[xr.Dataset]":
    """The decays of a file, read as the options say; frequencies that cannot be theirs are refused."""
    from sysid_trib.commands.record_inputs import read_decays

    return read_decays(replace(given, records=[Path(path)]), model)[0]


def _task(
    given: DecayOptions,
    model: ModelOptions,
    constraint: ConstraintOptions,
    search: SearchOptions,
    asked: CampaignOptions,
) -> "Task":
    """The task that the options ask for; an option that it does not have is refused."""
    from sysid_trib.campaigns.task import TASKS, Task
    from sysid_trib.commands.checks import asked_model, asked_search

    name = asked.task
    if name not in TASKS:
        raise UsageError(f"--task '{name}' is unknown: give {', '.join(TASKS)}.")
    # How a file is read does not depend on which others there are.
    read = partial(decays_of, replace(given, records=[]), model)
    if name == "discover":
        known = [flag_of(part) for part in fields(StartOptions)]
        others = [*changed_flags(model), *changed_flags(constraint)]
        _refuse(name, [flag for flag in others if flag not in known])
        if asked.methods is not None:
            raise UsageError("--methods are of identify and compare; discover has one of its own.")
        start, offered, options = asked_search(model, model.forces, search, given.system)
        return Task("discover", start, candidates=offered, read=read, options=options)
    _refuse(name, changed_flags(search))
    of_model = asked_model(model, constraint, given.system)
    methods = of_model.every_method
    # The two that `identify` holds against each other.
    wanted = ["averaging", "direct"] if name == "identify" else list(methods)
    if asked.methods:
        wanted = [label.strip() for label in asked.methods.split(",")]
    if misspelt := [label for label in wanted if label not in methods]:
        raise UsageError(f"--methods '{misspelt[0]}' is unknown; there are {', '.join(methods)}.")
    return Task(
        name,  # type: ignore[arg-type]
        of_model.library,
        {label: methods[label] for label in wanted},
        judged=name == "identify" and not asked.methods,
        read=read,
        constraints=of_model.constraints.table,
        contactless=of_model.contactless,
    )


def _refuse(name: str, flags: "Sequence[str]") -> None:
    """Refuse options that a task would pass over in silence."""
    if flags:
        raise UsageError(f"{flags[0]} is no option of --task {name}; leave it out, or give another task.")


def _checked_output(output: Path | None, reads: list[str | Path | None]) -> Path:
    """The store; a place that cannot be written, or is read, is refused before the work is done."""
    if output is None:
        raise UsageError("A campaign wants a store: -o RESULTS.zarr.")
    if output.suffix != STORE_ENDING:
        raise UsageError(f"{output}: the ending must be {STORE_ENDING}.")
    from sysid_trib.commands.destination import check_output

    files = [Path(name) for name in reads if name is not None]
    check_output(output.with_suffix(PAGE_ENDING), PAGE_ENDING, reads=files)
    return output


def _records(patterns: list[Path], study: Path | None, conditions: Path | None) -> Any:
    """Files, those of patterns among them, or a study; the table of conditions is no record."""
    if study is not None:
        if patterns:
            raise UsageError("A campaign is over files or over a study: give one of them.")
        from sysid_trib.campaigns.study import load_study

        return load_study(study)
    files: list[str] = []
    for pattern in map(str, patterns):
        those = sorted(glob(pattern)) if has_magic(pattern) and not Path(pattern).exists() else [pattern]
        if not those:
            raise UsageError(f"No file is named like {pattern}.")
        files += those
    if folders := [file for file in files if Path(file).is_dir()]:
        raise UsageError(f"{folders[0]}: this is a folder; give its files: '{Path(folders[0]) / '*.csv'}'.")
    if not files:
        raise UsageError("A campaign wants files ('data/*.csv') or --study FILE.")
    return [file for file in dict.fromkeys(files) if conditions is None or Path(file) != conditions]


def _conditions(asked: CampaignOptions, names: list[str]) -> Any:
    """The table of conditions, if there is one."""
    if asked.conditions is None:
        if asked.laboratories is not None:
            raise UsageError("--laboratories is a column of --conditions: give both.")
        return None
    from sysid_trib.campaigns.conditions import read_conditions

    table = read_conditions(asked.conditions, names)
    if asked.laboratories is not None and asked.laboratories not in table:
        raise UsageError(f"--laboratories '{asked.laboratories}': the conditions have {', '.join(table)}.")
    return table


def _compared(store: "xr.Dataset", table: Any, laboratories: str | None) -> "xr.Dataset | None":
    """What varies between the records, by the identification that is reported; None of too few."""
    from sysid_trib.campaigns.conditions import estimates_of, reported_method
    from sysid_trib.validation.between_runs import between_runs, without_collinear

    estimates = estimates_of(store, reported_method(store))
    if min(estimates.sizes["run"], estimates.sizes["quantity"]) < 1 or estimates.sizes["run"] < 2:
        return None
    if table is None:
        return between_runs(estimates)
    rows = table.iloc[estimates["at"].values].reset_index(drop=True)
    rows = rows[[name for name in rows if len(set(rows[name])) > 1]]
    if laboratories is not None and laboratories not in rows:
        raise UsageError(
            f"--laboratories '{laboratories}': all records that have a result are of one; leave it out."
        )
    # The work is done: what is left of the conditions is looked at.
    conditions, collinear = without_collinear(rows.drop(columns=laboratories or []))
    if laboratories is not None:
        conditions[laboratories] = rows[laboratories]
    compared = between_runs(estimates, conditions, laboratories=laboratories)
    return compared.assign_attrs(collinear=json.dumps(collinear))
