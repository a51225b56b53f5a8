"""Command `campaign`, and its options as the task of each record."""

import json
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from glob import glob, has_magic
from pathlib import Path
from typing import Any, cast

import xarray as xr

from sysid_trib.campaigns import task
from sysid_trib.campaigns.between_records import between_runs, without_collinear
from sysid_trib.campaigns.campaign import campaign as filled, check_extra
from sysid_trib.campaigns.conditions import estimates_of, read_conditions
from sysid_trib.campaigns.task import names_of
from sysid_trib.commands.asked import asked_constraints, asked_model, asked_search, parse_random_force
from sysid_trib.commands.fits import measured_given, methods_asked
from sysid_trib.commands.options import GROUPS, CampaignOptions, ModelOptions
from sysid_trib.commands.record_inputs import read_decays
from sysid_trib.commands.terminal import check_output, command_line, print_blocks, print_json
from sysid_trib.errors import RecordError, Tell, UsageError
from sysid_trib.forces.library import load_library
from sysid_trib.forces.systems import load_system
from sysid_trib.printing.campaign import campaign_blocks, campaign_json
from sysid_trib.results.store import counts_of, reported_model
from sysid_trib.smooth_laws.method import law_methods

# Options for the task laws only.
OF_LAWS = ["speeds", "inertia", "mass", "load", "radius"]


def campaign(tell: Tell, given: CampaignOptions) -> Callable[[], None]:
    """Run a task on each record, and write the variation between the records on a page."""
    check_extra()
    records = _records(given.records, given.conditions)
    if given.output is None:
        raise UsageError("A campaign needs a store: -o RESULTS.zarr.")
    if given.output.suffix != ".zarr":
        raise UsageError(f"{given.output}: the ending must be .zarr.")
    page = given.output.with_suffix(".html")
    reads = [*records, given.conditions]
    reads += [given.library, given.candidates, given.system]
    check_output(page, page.suffix, reads=[Path(name) for name in reads if name is not None])
    table = _conditions(given, names_of(records))
    store = filled(
        records,
        _task(given),
        output=given.output,
        workers=given.workers if given.scheduler is None else given.scheduler,
        memory=given.memory,
        tell=tell,
    )
    tell("variation between the records")
    compared = _compared(store, table, given.laboratories)
    tell("report")
    from sysid_trib.reporting.contents import campaign_contents
    from sysid_trib.reporting.page import rendered, write_page

    write_page(rendered(campaign_contents(store, compared, table, command_line())), page)
    counts = counts_of(store)

    def say() -> None:
        if given.as_json:
            print_json(campaign_json(store, counts, compared))
        else:
            print_blocks(campaign_blocks(store, counts, compared), written=(given.output, page))
        if not counts["done"]:
            raise RecordError(f"{given.output}: no record has a result; {page} gives the reasons.")

    return say


def decays_of(given: ModelOptions, path: str) -> Sequence[xr.Dataset]:
    """Read the decays of a file with the given options; raise an error for an impossible frequency."""
    return read_decays(given.but(records=[Path(path)]))[0]


def _task(given: CampaignOptions) -> task.Task:
    """Return the task of the options; raise an error for an option that does not belong to the task."""
    name = given.task
    if name not in task.TASKS:
        raise UsageError(f"--task '{name}' is unknown: give {', '.join(task.TASKS)}.")
    # The other files and the position of the row have no influence on how a file is read.
    of_reading = {option.name: getattr(given, option.name) for option in fields(ModelOptions)}
    read = partial(decays_of, ModelOptions(**of_reading | {"records": []}))
    # Options that the task would silently ignore.
    idle_options = {
        "discover": [*(option for option in GROUPS["model"] if option not in GROUPS["start"]), *OF_LAWS],
        "laws": [*GROUPS["search"], *(option for option in GROUPS["model"] if option not in GROUPS["laws"])],
    }.get(name, [*GROUPS["search"], *OF_LAWS])
    if idle := given.changed(idle_options):
        raise UsageError(f"{idle[0]} is not an option of --task {name}; omit it, or give another task.")
    if name == "laws":
        return _task_of_laws(given, read)
    if name == "discover":
        if given.methods is not None:
            raise UsageError("--methods is for identify and compare; discover has its own method.")
        start, offered, how = asked_search(given)
        return task.Task("discover", start, candidates=offered, read=read, options=how)
    asked = asked_model(given)
    methods = methods_asked(asked)
    # Without --methods `identify` takes the two of the command for each record.
    wanted = [] if name == "identify" else list(methods)
    if given.methods:
        wanted = [label.strip() for label in given.methods.split(",")]
    if name == "identify" and (curves := [label for label in wanted if label in law_methods()]):
        raise UsageError(f"--methods '{curves[0]}' has no coefficients: give --task laws --speeds 0.1,0.5.")
    if misspelt := [label for label in wanted if label not in methods]:
        raise UsageError(f"--methods '{misspelt[0]}' is unknown; there are {', '.join(methods)}.")
    of_usual_methods = {
        "reference_frequency": asked.reference_frequency,
        "shapes": asked.shapes,
        "random_force": asked.random_force,
    }
    return task.Task(
        cast(task.Name, name),
        asked.library,
        {label: methods[label] for label in wanted},
        read=read,
        constraints=asked.constraints,
        contactless=asked.contactless,
        options={} if wanted else of_usual_methods,
    )


def _task_of_laws(given: CampaignOptions, read: task.Read) -> task.Task:
    """Return the task laws: friction at speeds."""
    if given.methods is not None:
        raise UsageError("--methods is for identify and compare; laws uses its own two methods.")
    random_force = parse_random_force(given.random_force)
    return task.Task(
        "laws",
        load_library(given.library),
        read=read,
        constraints=asked_constraints(given.fix, given.bound, given.tie).table,
        options={
            "system": load_system(given.system),
            "random_force": "off" if random_force == "auto" else random_force,
        },
        speeds=_speeds(given.speeds),
        measured=measured_given(given),
    )


def _speeds(text: str | None) -> tuple[float, ...]:
    """Return the speeds of --speeds."""
    try:
        speeds = tuple(float(word) for word in (text or "").split(","))
    except ValueError:
        speeds = ()
    if not speeds or not all(speed > 0.0 for speed in speeds):
        raise UsageError(
            "--task laws needs --speeds, numbers above 0 separated by commas: --speeds 0.1,0.5,1."
        )
    return tuple(dict.fromkeys(speeds))


def _records(patterns: list[Path], conditions: Path | None) -> list[str]:
    """Return the files, including those that match patterns; the table of conditions is not a record."""
    files: list[str] = []
    for pattern in map(str, patterns):
        those = sorted(glob(pattern)) if has_magic(pattern) and not Path(pattern).exists() else [pattern]
        if not those:
            raise UsageError(f"No file matches {pattern}.")
        files += those
    if folders := [file for file in files if Path(file).is_dir()]:
        raise UsageError(f"{folders[0]}: this is a folder; give its files: '{Path(folders[0]) / '*.csv'}'.")
    if not files:
        raise UsageError("A campaign needs files: 'data/*.csv'.")
    return [file for file in dict.fromkeys(files) if conditions is None or Path(file) != conditions]


def _conditions(given: CampaignOptions, names: list[str]) -> Any:
    """Return the table of conditions, if there is one."""
    if given.conditions is None:
        if given.laboratories is not None:
            raise UsageError("--laboratories is a column of --conditions: give both.")
        return None
    table = read_conditions(given.conditions, names)
    if given.laboratories is not None and given.laboratories not in table:
        raise UsageError(f"--laboratories '{given.laboratories}': the conditions have {', '.join(table)}.")
    return table


def _compared(store: xr.Dataset, table: Any, laboratories: str | None) -> xr.Dataset | None:
    """Return the variation between records for the reported identification; None if there are too few."""
    estimates = estimates_of(store, reported_model(store))
    if min(estimates.sizes["run"], estimates.sizes["quantity"]) < 1 or estimates.sizes["run"] < 2:
        return None
    if table is None:
        return between_runs(estimates)
    rows = table.iloc[estimates["at"].values].reset_index(drop=True)
    rows = rows[[name for name in rows if len(set(rows[name])) > 1]]
    if laboratories is not None and laboratories not in rows:
        raise UsageError(
            f"--laboratories '{laboratories}': all records with a result are from one "
            f"laboratory; leave it out."
        )
    # The fits are done: collinear conditions are omitted instead of raising an error.
    conditions, collinear = without_collinear(rows.drop(columns=laboratories or []))
    if laboratories is not None:
        conditions[laboratories] = rows[laboratories]
    compared = between_runs(estimates, conditions, laboratories=laboratories)
    return compared.assign_attrs(collinear=json.dumps(collinear))
