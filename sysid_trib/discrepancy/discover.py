"""Find where model and record differ, name the missing effect, add it: the gap shrinks."""

import json
from collections.abc import Callable
from dataclasses import replace

import xarray as xr

from sysid_trib.discrepancy.decimation import decimated
from sysid_trib.discrepancy.model_sequence import model_sequence
from sysid_trib.discrepancy.stepwise_search import LEVEL, first_baseline, search, verdict_of
from sysid_trib.discrepancy.to_xarray import groups_of
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.to_identify import forces_to_identify
from sysid_trib.records.runs import Decays, as_runs, one_or_all
from sysid_trib.results.schema import provenance


def discover(
    decay: Decays,
    model_forces: ForceLibrary,
    candidates: ForceLibrary,
    *,
    reference_frequency: float | None = None,
    max_effects: int = 4,
    holdout: Decays = (),
    level: float = LEVEL,
    seed: int = 0,
    tell: Callable[[str], None] = lambda text: None,
) -> xr.DataTree:
    """Find, name and add what a model lacks to explain a decay, or runs of one experiment.

    Parameters
    ----------
    decay : xr.Dataset or sequence of xr.Dataset
        `angle(time)` as `free_decay` returns it, or a list of runs.
    model_forces : ForceLibrary
        The forces of the model to start from.
    candidates : ForceLibrary
        What may be missing. Those that the model has are not offered, and named in the result.
    reference_frequency : float, rad/s, optional
        w, held; else it is fitted.
    max_effects : int
        Effects added at most.
    holdout : xr.Dataset or sequence of xr.Dataset
        Runs that take no part in fitting or naming, and are predicted by each model. Without any the last
        third of each run is predicted by models that are fitted again on the first two.
    level : float
        Family-wise significance level at which an effect is named.
    seed : int
        Of the drawing that counts independent tests.
    tell : callable
        Called with a few words as the work goes on.

    Returns
    -------
    xr.DataTree
        Of records decimated to some sixty samples a period (attrs `decimated`). attrs: `verdict`
        (`explained`, `unknown effect`, `nothing missing`), `left_out`, `failed_fits`. Groups: `record`
        (`record_1`, ... of several runs) with `simulated_angle(model)` before and after; `discrepancy` and
        `discrepancy_after`, where model and record differ (see `demodulation.demodulate`); `detectability`
        and `detectability_after`; `ranking` of the candidates at each selection step; `steps`, the effects
        added; `before` and `after`, the identifications; `omnibus`, the tests that know no candidate;
        `holdout` over the models; of several runs `homogeneity`, whether they differ.

    Raises
    ------
    UsageError
        No forces to start from, or no candidates.
    DecayError
        The decay cannot support the start model.
    """
    runs = [decimated(run) for run in as_runs(decay)]
    if not len(model_forces):
        raise UsageError("The start model has no force; give at least one, such as a viscous one.")
    model = forces_to_identify(model_forces, reference_frequency)
    offered, left_out = _offered(model_forces, candidates)
    if not len(offered):
        raise UsageError("No candidate is left beside the forces of the model; offer another library.")
    tell("fit of the start model")
    start = first_baseline(runs, model, reference_frequency)
    done = search(runs, start, offered, max_effects=max_effects, level=level, seed=seed, tell=tell)
    tell("hold-out")
    unseen = as_runs(holdout) if isinstance(holdout, xr.Dataset) or len(holdout) else []
    unseen = [decimated(part) for part in unseen]
    models, errors = model_sequence(done, runs, unseen)
    tell("where model and record differ")
    tree = xr.DataTree.from_dict(groups_of(runs, done, models, errors, offered, level))
    third = f"the last third{' of each run' * (len(runs) > 1)}"
    options = {"max_effects": max_effects, "level": level, "seed": seed}
    tree.attrs = {
        **provenance(None, one_or_all(runs), model),
        "method": "discover",
        "options": json.dumps(options | {"reference_frequency": reference_frequency}),
        "candidates": offered.to_toml(),
        "verdict": verdict_of(done, level),
        "max_effects": max_effects,
        "left_out": left_out,
        "failed_fits": list(done.failed),
        "held_out": f"{len(unseen)} run{'s' * (len(unseen) > 1)}" if unseen else third,
        "decimated": [run.attrs["decimated"] for run in runs if "decimated" in run.attrs],
    }
    return tree


def _offered(model: ForceLibrary, candidates: ForceLibrary) -> tuple[ForceLibrary, list[str]]:
    """The candidates that the model does not have, and the symbols of the others."""
    kept: list[Force] = []
    left_out = []
    for force in candidates:
        same = any(_same(force, other) for other in model)
        if same or any(force.symbol == other.symbol for other in (*model, *kept)):
            left_out.append(force.symbol)
        else:
            kept.append(force)
    return replace(candidates, forces=tuple(kept)), left_out


def _same(force: Force, other: Force) -> bool:
    """Whether two forces are the same function."""
    if force.kind != other.kind:
        return False
    if force.memoryless and not force.shape and force.kind == "force":
        return other.matches(force.formula.text)
    texts = [
        (f.formula.text, *(p.text for table in (f.state, f.memory) for p in table.values()))
        for f in (force, other)
    ]
    return texts[0] == texts[1]
