"""The start model and the final model of a search, judged as `identify` judges its models."""

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
    """Judge the models of a search; this judgement does not influence the search.

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
    The same forces get the same verdict from every command: Direct identifies each model again from the whole
    runs, with the noise that `identify` selects and with held shape parameters. Driven records, and models
    that Direct cannot identify, are judged with the fit of the search. A start model to which nothing was
    added is the final model: it is identified and judged once.
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
        tables: list[xr.Dataset] = []
        models: list[str] = []
        for name, of in of_search.items():
            model = _model_text(of.result)
            if models and model == models[-1]:
                table = tables[-1].assign_coords(model=[name]).assign_attrs(preferred=name)
            else:
                again = {name: _identified_again(of, whole)}
                records = with_motions(again)
                tested = residuals(again, again[name].result)
                table = judged(again, records, tested, preferred=name)
            models.append(model)
            tables.append(table)
        table = xr.concat(tables, "model", combine_attrs="override")
        table.attrs |= tables[-1].attrs
    held_out = groups["holdout"].rms.values[[0, -1]]
    return table.assign(described("judged", {"held_out_rms": held_out}))


def _model_text(result: xr.Dataset) -> str:
    """Return the forces, shapes and options of an identification: equal texts are identified equally."""
    return f"{library_of(result).to_toml()}\n{method_of(result)!r}"


def _identified_again(of_search: FollowedRuns, whole: Sequence[xr.Dataset]) -> FollowedRuns:
    """Return a model identified from the whole runs, or as the search fitted it if Direct fails."""
    result = of_search.result
    method = replace(method_of(result), random_force="auto")
    try:
        (again,) = verdict.decided(one_or_all(list(whole)), library_of(result), [method])
    except (SysidTribError, np.linalg.LinAlgError):
        return of_search
    return again
