"""The start model and the final one of a search, judged as `identify` judges its models."""

from collections.abc import Mapping, Sequence

import xarray as xr

from sysid_trib.discovery.free_motion import FreeMotion
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.random_force import is_found, random_force_of
from sysid_trib.results.variables import described, group_names
from sysid_trib.validation import judge, verdict
from sysid_trib.validation.driven import judged_driven
from sysid_trib.validation.residuals import FollowedRuns, residuals


def judged_models(
    groups: Mapping[str, xr.Dataset], motions: Mapping[str, Sequence[FreeMotion]]
) -> xr.Dataset:
    """Judge the models of a search; the search does not read it.

    Parameters
    ----------
    groups : mapping of str to Dataset
        The records, the identifications and `holdout` of a result of `discover`.
    motions : mapping of str to sequence of FreeMotion
        Motion of each model in each run, by the name of its group.
    """
    count = len(next(iter(motions.values())))
    records = [groups[name] for name in group_names("record", count)]
    runs = dict(enumerate(records))
    followed = {
        name: FollowedRuns(runs, groups[name], {"motions": [run.motion for run in of_runs]})
        for name, of_runs in motions.items()
    }
    last = [*followed.values()][-1]
    if any(map(inputs_of, records)):
        table = judged_driven(followed, records)
    else:
        p_value = float("nan")
        if is_found(random_force_of(last.result)):
            p_value = verdict.p_value_of_dependence(verdict.tested_runs(last))
        results = {name: of.result for name, of in followed.items()}
        table = judge.judged(records, results, residuals(followed, last.result), random_force_p=p_value)
    evidence = verdict.evidence_of_models(table, followed)
    held_out = groups["holdout"].rms.values[[0, -1]]
    table = table.assign(described("judged", {"held_out_rms": held_out}))
    return judge.with_verdicts(table, evidence, [*followed][-1], "discover")
