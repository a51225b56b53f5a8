"""The workflow under test: it sees files, the base model's symbols and what to leave out, nothing else."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import xarray as xr

from sysid_trib import free_decay, load_library, read_record
from sysid_trib.discrepancy.discover import discover
from sysid_trib.results.discoveries import credible_set


def named(paths: Sequence[Path], base: Sequence[str], left_out: Sequence[str]) -> dict[str, Any]:
    """Verdict, steps and hold-out RMS before and after, of the runs in these files, the last one held out."""
    *runs, unseen = [free_decay(read_record(path)) for path in paths]
    contact, others = load_library(), load_library("candidate_effects")
    offered = tuple(force for force in (*contact, *others) if force.symbol not in {*base, *left_out})
    model = contact.select(list(base))
    tree = discover(runs, model, replace(others, forces=offered), holdout=[unseen])
    steps, holdout = tree["steps"].dataset, tree["holdout"].dataset
    return {
        "verdict": tree.attrs["verdict"],
        "steps": [_step(steps.isel(step=i)) for i in range(steps.sizes.get("step", 0))],
        "holdout": [float(holdout.rms[0]), float(holdout.rms[-1])],
    }


def _step(row: xr.Dataset) -> dict[str, Any]:
    words = {name: str(row[name].item()) for name in ("symbol", "family")}
    numbers = {name: float(row[name]) for name in ("coefficient", "standard_error", "p_value")}
    deviance = row.penalised_deviance.dropna("candidate").to_series().round(2).to_dict()
    return words | numbers | {"ties": list(credible_set(row)), "costs": json.dumps(deviance)}
