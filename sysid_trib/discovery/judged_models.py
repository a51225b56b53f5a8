"""The start model and the final one of a search, judged as `identify` judges its models."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr

from sysid_trib.discovery.free_motion import FreeMotion
from sysid_trib.errors import SysidTribError
from sysid_trib.methods import method_of
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.runs import one_or_all
from sysid_trib.results.models import library_of
from sysid_trib.results.variables import described, group_names
from sysid_trib.validation import verdict
from sysid_trib.validation.driven import tested_driven
from sysid_trib.validation.residuals import FollowedRuns, residuals, with_motions


def judged_models(
    groups: Mapping[str, xr.Dataset],
    motions: Mapping[str, Sequence[FreeMotion]],
    whole: Sequence[xr.Dataset],
) -> xr.Dataset:
    """Judge the models of a search; the search does not read it.

    Parameters
    ----------
    groups : mapping of str to Dataset
        The records, the identifications and `holdout` of a result of `discover`.
    motions : mapping of str to sequence of FreeMotion
        Motion of each model in each run, by the name of its group.
    whole : sequence of Dataset
        The run of each record with all its samples.

    Notes
    -----
    The same forces get one verdict, whichever command asks: Direct identifies each model again from the
    whole runs, with the noise that `identify` decides for. Its shape parameters are held. Driven records, and
    models that Direct cannot identify, are judged by the fit of the search.
    """
    names = group_names("record", len(next(iter(motions.values()))))
    seen = [groups[name] for name in names]
    judged = partial(verdict.judged_models, made_by="discover")
    of_search = {
        name: FollowedRuns(
            dict(enumerate(seen)),
            groups[name],
            {f"motion {at}": run.motion for at, run in enumerate(of_runs)},
        )
        for name, of_runs in motions.items()
    }
    last = [*of_search][-1]
    if any(map(inputs_of, whole)):
        # A random force is not tested for dependence in driven records.
        untested = float("nan")
        tested = tested_driven(of_search)
        table = judged(of_search, seen, tested, preferred=last, random_force_p=untested)
    else:
        tables = []
        for name, of in of_search.items():
            again = {name: _identified_again(of, whole)}
            records = with_motions(again)
            tested = residuals(again, again[name].result)
            tables.append(judged(again, records, tested, preferred=name))
        table = xr.concat(tables, "model", combine_attrs="override")
        table.attrs |= tables[-1].attrs
    held_out = groups["holdout"].rms.values[[0, -1]]
    return table.assign(described("judged", {"held_out_rms": held_out}))


def _identified_again(of_search: FollowedRuns, whole: Sequence[xr.Dataset]) -> FollowedRuns:
    """Return a model identified from the whole runs; where Direct cannot, as the search fitted it."""
    result = of_search.result
    method = replace(method_of(result), random_force="auto")
    try:
        (again,) = verdict.decided(one_or_all(list(whole)), library_of(result), [method])
    except (SysidTribError, np.linalg.LinAlgError):
        return of_search
    return again
