"""The workflow under test: it sees files, the base model's symbols and what to leave out, nothing else."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib import free_decay, load_library, read_record
from sysid_trib.discovery.discover import discover
from sysid_trib.likelihood.settings import Settings
from sysid_trib.results.effects import credible_set

from .seen import CONTACT, offered


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


def named_blind(
    paths: Sequence[Path], base: Sequence[str], left_out: Sequence[str], settings: Settings
) -> dict[str, Any]:
    """Verdict, effects and base coefficients of the runs in these files, the last third of each held out."""
    runs = [free_decay(read_record(path)) for path in paths]
    tree = discover(runs, CONTACT.select(list(base)), offered(base, left_out), settings=settings)
    steps, after = tree["steps"].dataset, tree["after"].dataset
    by_symbol = after.sel(force=list(base))
    return {
        "verdict": tree.attrs["verdict"],
        "converged": tree.attrs["converged"],
        "failed_fits": tree.attrs["failed_fits"],
        "steps": [_blind_step(steps.isel(step=i)) for i in range(steps.sizes.get("step", 0))],
        "base": dict(zip(base, by_symbol.coefficient.values.tolist(), strict=True)),
        "base_errors": dict(zip(base, by_symbol.standard_error.values.tolist(), strict=True)),
        "random_force_p_value": np.atleast_1d(after.random_force_p_value.values).tolist(),
    }


def _blind_step(row: xr.Dataset) -> dict[str, Any]:
    flags = {name: bool(row[name]) for name in ("collinear", "worsens_holdout", "significant")}
    return _step(row) | flags | {"ties": credible_set(row), "chance": float(row.chance_probability)}
