"""Find where model and record differ, name the missing effect, add it: the gap shrinks."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.discrepancy.decimation import decimated
from sysid_trib.discrepancy.holdout import REFUTED, Prediction, improvements, predicted
from sysid_trib.discrepancy.model_fit import FittedModel, refitted
from sysid_trib.discrepancy.paths import RecordPath, path_of_run
from sysid_trib.discrepancy.search import Search, search
from sysid_trib.discrepancy.start_model import fit_start_model
from sysid_trib.discrepancy.to_xarray import groups_of
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.to_identify import forces_to_identify
from sysid_trib.records.runs import Decays, as_runs, one_or_all
from sysid_trib.results.schema import provenance
from sysid_trib.validation.holdout import split

# Family-wise level of error of a name.
FAMILY_LEVEL = 0.01


def discover(
    decay: Decays,
    model_forces: ForceLibrary,
    candidates: ForceLibrary,
    *,
    reference_frequency: float | None = None,
    max_effects: int = 4,
    holdout: Decays = (),
    refit: bool = False,
    level: float = FAMILY_LEVEL,
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
        third of each run takes no part.
    refit : bool
        Fit the models that were found again, to the whole runs.
    level : float
        Family-wise significance level of each test.
    seed : int
        Of the drawing that counts independent tests.
    tell : callable
        Called with a few words as the work goes on.

    Returns
    -------
    xr.DataTree
        Of records decimated to some sixty samples a period (attrs `decimated`). attrs: `verdict`
        (`explained`, `unknown effect`, `nothing missing`), `converged`, `left_out`, `failed_fits`. Groups:
        `record` (`record_1`, ... of several runs) with `simulated_angle(model)` before and after;
        `discrepancy` and `discrepancy_after`, where model and record differ (see `demodulation.demodulate`);
        `detectability`, `detectability_after`; `ranking` of candidates before each effect and at the end;
        `steps`, the effects added; `before` and `after`, the identifications; `omnibus`, the tests that know
        no candidate; `holdout` over the models; of several runs `homogeneity`, whether they differ.

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
    unseen = as_runs(holdout) if isinstance(holdout, xr.Dataset) or len(holdout) else []
    parts = [decimated(part) for part in unseen]
    seen = runs if unseen else [split(run)[0] for run in runs]
    tell("fit of the start model")
    start = fit_start_model(seen, model.forces, reference_frequency)
    done = search(start, offered.forces, max_effects=max_effects, level=level, seed=seed, tell=tell)
    tell("hold-out")
    predictions = _predictions(done, runs, parts)
    if refit and not unseen:
        tell("fit to the whole runs")
        done = replace(done, models=[_refitted(model, runs) for model in done.models])
        seen = runs
    tell("where model and record differ")
    groups = groups_of(runs, seen, done, predictions, offered, level, reference_frequency)
    tree = xr.DataTree.from_dict(groups)
    third = f"the last third{' of each run' * (len(runs) > 1)}"
    options = {"max_effects": max_effects, "level": level, "seed": seed, "refit": refit}
    tree.attrs = {
        **provenance(None, one_or_all(runs), model),
        "method": "discover",
        "options": json.dumps(options | {"reference_frequency": reference_frequency}),
        "candidates": offered.to_toml(),
        "verdict": verdict_of(done, level, predictions),
        "converged": str(done.converged),
        "max_effects": max_effects,
        "left_out": left_out,
        "failed_fits": list(done.failed),
        "held_out": f"{len(unseen)} run{'s' * (len(unseen) > 1)}" if unseen else third,
        "decimated": [run.attrs["decimated"] for run in runs if "decimated" in run.attrs],
    }
    return tree


def _predictions(done: Search, runs: Sequence[xr.Dataset], parts: Sequence[xr.Dataset]) -> list[Prediction]:
    """How each model predicts runs that took no part, or the last third of each."""
    if parts:
        origins = [_origin(part, runs) for part in parts]
        noises = [min(at, len(runs) - 1) for at in range(len(parts))]
    else:
        parts = [split(run)[1] for run in runs]
        origins, noises = [float(run.time.values[0]) for run in runs], list(range(len(runs)))
    frequency = done.models[0].rows[0].path.frequency
    return [predicted(model, parts, origins, noises, frequency) for model in done.models]


def _origin(part: xr.Dataset, runs: Sequence[xr.Dataset]) -> float:
    """Time from which `t` counts: the first sample of the record that the part is from, else its first."""
    name = part.attrs.get("record_checksum")
    same = [run for run in runs if name and run.attrs.get("record_checksum") == name]
    return float((same or [part])[0].time.values[0])


def _refitted(model: FittedModel, runs: Sequence[xr.Dataset]) -> FittedModel:
    def whole(run: xr.Dataset, near: RecordPath) -> RecordPath:
        return path_of_run(run, near.frequency, near.sensor, near.origin)

    return refitted(model, [whole(run, rows.path) for run, rows in zip(runs, model.rows, strict=True)])


def verdict_of(done: Search, level: float = FAMILY_LEVEL, predictions: Sequence[Prediction] = ()) -> str:
    """`explained`, `unknown effect` or `nothing missing`.

    Parameters
    ----------
    done : Search
    level : float
        Of the test of what the final model leaves.
    predictions : sequence of Prediction
        Of what was held out, by each of its models.
    """
    # Names that nearly cancel each other, or that do not predict, may imitate one that is not in the library.
    refuted = np.any(improvements(predictions) < REFUTED)
    missing = done.outstanding or done.screenings[-1].omnibus.p_value < level
    if done.collinear or refuted or missing:
        return "unknown effect"
    return "explained" if done.effects else "nothing missing"


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
