"""A search as datasets: records, ranking, steps, generic tests, hold-out."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

from sysid_trib.discrepancy.collinearity import collinear_effects
from sysid_trib.discrepancy.competing_models import cost_of, tie_class
from sysid_trib.discrepancy.demodulation import disagreement
from sysid_trib.discrepancy.detectability import detectability
from sysid_trib.discrepancy.homogeneity_test import homogeneity
from sysid_trib.discrepancy.model_sequence import WORSE, ModelSequence, labelled, residual_rms
from sysid_trib.discrepancy.stepwise_search import Search
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.records.runs import group_names, root_mean_square

Array = NDArray[np.float64]

# What the columns of the steps are, and their units.
STEPS = {
    "symbol": ("symbol of the effect", ""),
    "name": ("name of the effect", ""),
    "formula": ("its formula", ""),
    "family": ("its family", ""),
    "kind": ("force or sensor", ""),
    "unit": ("unit of its coefficient", ""),
    "coefficient": ("coefficient in the final model", "see unit"),
    "standard_error": ("its standard error", "see unit"),
    "shapes": ("shape parameters, as JSON", ""),
    "z": ("coefficient over its error", "1"),
    "p_value": ("chance of as much by noise, corrected", "1"),
    "ties": ("the effect and those that may as well be the truth", ""),
    "tie_probabilities": ("how probable each of these is, all being as likely before, as JSON", ""),
    "tie_costs": ("-2 ln of the odds of each candidate in its place, as JSON", ""),
    "residual_before": ("RMS left before", "rad"),
    "residual_after": ("RMS left after", "rad"),
    "gap_before": ("RMS of the whitened residual before, in units of the noise", "1"),
    "gap_after": ("the same after", "1"),
    "leans": ("whether it leans on other effects, and may imitate what has no name", ""),
    "worsens_holdout": ("whether it makes the prediction worse", ""),
}


def groups_of(
    runs: Sequence[xr.Dataset], found: Search, stages: ModelSequence, offered: ForceLibrary
) -> dict[str, xr.Dataset]:
    """What `discover` returns, group by group."""
    first, last = found.scans[0], found.scans[-1]
    ends = (stages.models[0], stages.models[-1])
    groups: dict[str, xr.Dataset] = dict(
        zip(group_names("record", len(runs)), _records(runs, ends), strict=True)
    )
    groups["discrepancy"] = disagreement(first.before, first.references)
    groups["discrepancy_after"] = disagreement(last.before, last.references)
    groups["detectability"] = detectability(first.found)
    groups["detectability_after"] = detectability(last.found)
    groups["ranking"] = _ranking(found, offered)
    groups["steps"] = _steps(found, stages)
    groups["omnibus"] = _generic(found)
    groups["before"] = labelled(stages.models[0], runs)
    groups["after"] = labelled(stages.models[-1], runs)
    groups["holdout"] = _holdout(stages)
    if len(runs) > 1:
        groups["homogeneity"] = homogeneity(stages.models)
    return groups


def _records(runs: Sequence[xr.Dataset], ends: Sequence[Any]) -> list[xr.Dataset]:
    told = {"units": "rad", "long_name": "angle of the model"}
    moved = [model.problem.residuals(model.values) for model in ends]
    records = []
    for at, run in enumerate(runs):
        simulated = np.stack([run.angle.values + left[at] for left in moved])
        labelled_run = run.assign_coords(model=["before", "after"])
        records.append(labelled_run.assign(simulated_angle=(("model", "time"), simulated, told)))
    return records


def _ranking(found: Search, offered: ForceLibrary) -> xr.Dataset:
    """Score, p-value, coefficient and shapes of every candidate before each step, and after the last."""
    symbols = list(offered.symbols)
    shape = (len(found.scans), len(symbols))
    z, p_value, coefficient = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    shapes = np.full(shape, "", dtype=object)
    reasons = np.full(shape, "in the model", dtype=object)
    for i, scan in enumerate(found.scans):
        scores = scan.found
        best: dict[str, int] = {}
        for at in np.argsort(-np.abs(scores.z)).tolist():
            best.setdefault(scores.probes[at].force.symbol, at)
        for symbol, at in best.items():
            j = symbols.index(symbol)
            reasons[i, j] = scores.reasons[at]
            shapes[i, j] = json.dumps({k: float(f"{v:.4g}") for k, v in scores.probes[at].shapes.items()})
            if not scores.reasons[at]:
                z[i, j], p_value[i, j] = scores.z[at], scores.p_values[at]
                coefficient[i, j] = scores.z[at] / scores.size[at]
    dims = ("selection_step", "candidate")
    tests = [scan.found.tests for scan in found.scans]
    return xr.Dataset(
        {
            "z": (dims, z, {"units": "1", "long_name": "score"}),
            "p_value": (dims, p_value, {"units": "1", "long_name": "chance of a larger score, corrected"}),
            "coefficient": (
                dims,
                coefficient,
                {"units": "see unit", "long_name": "coefficient by the score"},
            ),
            "shapes": (dims, shapes.astype(str), {"long_name": "shape parameters"}),
            "reason": (dims, reasons.astype(str), {"long_name": "why it is not ranked"}),
            "independent_tests": (
                "selection_step",
                tests,
                {"units": "1", "long_name": "number of independent tests"},
            ),
        },
        {
            "candidate": symbols,
            "name": ("candidate", [f.name for f in offered]),
            "family": ("candidate", [f.family for f in offered]),
            "unit": ("candidate", [f.units for f in offered]),
        },
    )


def _steps(found: Search, stages: ModelSequence) -> xr.Dataset:
    """The effects added, in order, with their final coefficients and what each took from the gap."""
    rows: list[dict[str, Any]] = []
    errors = np.sqrt(np.diag(found.final.covariance))
    leans = collinear_effects(found.final, found.added)
    for at, symbol in enumerate(found.added):
        force = found.final.problem.parameters.library[symbol]
        place = found.final.problem.parameters.index(symbol)
        value, error = float(found.final.values[place]), float(errors[place])
        before, after = stages.models[at], stages.models[at + 1]
        tests = found.scans[min(at, len(found.scans) - 1)].found.tests
        gain = before.chi_square - after.chi_square
        tied = tie_class(found.final, symbol, found.ties[symbol])
        rows.append(
            {
                "symbol": symbol,
                "name": force.name,
                "formula": force.formula.text,
                "family": force.family,
                "kind": force.kind,
                "unit": force.units,
                "coefficient": value,
                "standard_error": error,
                "shapes": json.dumps(_shapes_of(found, force)),
                "z": value / error,
                "p_value": float(min(1.0, tests * chi2.sf(gain, 1 + len(force.shape)))),
                "ties": "; ".join(tied),
                "tie_probabilities": json.dumps({s: round(p, 4) for s, p in tied.items()}),
                "tie_costs": json.dumps(_costs(found, symbol)),
                "residual_before": residual_rms(before),
                "residual_after": residual_rms(after),
                "gap_before": float(np.sqrt(before.chi_square / len(before.residual))),
                "gap_after": float(np.sqrt(after.chi_square / len(after.residual))),
                "leans": symbol in leans,
                "worsens_holdout": bool(stages.holdout[at + 1] > WORSE * stages.holdout[at]),
            }
        )
    # netCDF has no empty axis: without a step there is but the count.
    names = list(rows[0]) if rows else []
    columns = {name: ("step", [row[name] for row in rows], _told(name)) for name in names}
    return xr.Dataset(columns, attrs={"count": len(rows)})


def _told(name: str) -> dict[str, str]:
    """Attributes of a column of the steps; words have no unit."""
    said, unit = STEPS[name]
    return {"long_name": said} | ({"units": unit} if unit else {})


def _costs(found: Search, symbol: str) -> dict[str, float | None]:
    """What each candidate costs above the effect; None of a fit that failed."""
    own = cost_of(found.final, symbol)
    return {one.force.symbol: _finite(one.cost - own) for one in found.ties[symbol]}


def _finite(value: float) -> float | None:
    return round(value, 2) if np.isfinite(value) else None


def _shapes_of(found: Search, force: Force) -> dict[str, float]:
    index = found.final.problem.parameters.index
    return {k: float(found.final.values[index(f"{force.symbol}.{k}")]) for k in force.shape}


def _generic(found: Search) -> xr.Dataset:
    """Tests of every scan that know no candidate."""
    generic = [scan.generic for scan in found.scans]
    return xr.Dataset(
        {
            "z": (
                ("selection_step", "trial_force"),
                np.stack([g.z for g in generic]),
                {"units": "1", "long_name": "score"},
            ),
            "p_value": (
                "selection_step",
                [g.p_value for g in generic],
                {"units": "1", "long_name": "chance of more"},
            ),
        },
        {"trial_force": list(generic[0].names)},
    )


def _holdout(stages: ModelSequence) -> xr.Dataset:
    noise = root_mean_square([n.standard_deviation for n in stages.models[-1].noises])
    above = stages.holdout**2 - noise**2
    return xr.Dataset(
        {
            "rms": ("model", stages.holdout, {"units": "rad", "long_name": "RMS of what is predicted"}),
            "noise": ((), noise, {"units": "rad", "long_name": "noise of a sample"}),
            "gap_above_noise": (
                "model",
                above / above[0] if above[0] > 0.0 else np.full(len(above), np.nan),
                {"units": "1", "long_name": "squared gap above the noise, over the start model's"},
            ),
        }
    )
