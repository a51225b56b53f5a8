"""`identify`: a decay by one method, or by two that are held against each other."""

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
import xarray as xr

from sysid_trib.cycles.signatures import averages_decide
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.methods.scope import Method, constrained
from sysid_trib.records.decay import Decays, as_runs, one_or_all
from sysid_trib.results.references import with_contactless_frequency
from sysid_trib.results.schema import map_identifications
from sysid_trib.simulation.initial_conditions import MEASURED
from sysid_trib.validation.agreement import run_agreement
from sysid_trib.validation.answer import checked_library, identifications
from sysid_trib.validation.cross_check import SIMULATED_RECORDS, identified_and_checked
from sysid_trib.validation.driven import identified_driven, is_driven
from sysid_trib.validation.simulated_pairs import fewest_records


@overload
def identify(
    decay: Decays,
    library: ForceLibrary | None,
    method: Method,
    *,
    constraints: ConstraintTable = ...,
    contactless: tuple[float, float] | None = ...,
    tell: Tell = ...,
) -> xr.Dataset: ...


@overload
def identify(
    decay: Decays,
    library: ForceLibrary | None = ...,
    method: Sequence[Method] | None = ...,
    *,
    constraints: ConstraintTable = ...,
    contactless: tuple[float, float] | None = ...,
    tell: Tell = ...,
) -> xr.DataTree: ...


def identify(
    decay: Decays,
    library: ForceLibrary | None = None,
    method: Method | Sequence[Method] | None = None,
    *,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    contactless: tuple[float, float] | None = None,
    tell: Tell = silent,
) -> xr.Dataset | xr.DataTree:
    """Identify the forces of a library from a decay, or from runs of one experiment.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        `angle(time)` in rad, as `free_decay` returns it; or a list of runs, which share their forces and
        reference frequency, but have a start, a sensor's zero and a noise of their own.
    library : ForceLibrary, optional
        The forces offered; by default those of `contact_forces`.
    method : method, or two methods, optional
        One, such as `methods.Direct()`; or two that are held against each other, by default those of the
        command `identify` (`usual_methods`). Whether there is a random force is decided where a method's
        `random_force` is `auto`, the default (see `identifications`).
    constraints : mapping of str to float, (float, float) or str
        What is held, bounded or tied, `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`.
    contactless : (float, float), rad/s
        Frequency without contact and its standard error, which adds alpha.
    tell : callable
        Called with a few words as the work goes on.

    Returns
    -------
    Dataset or DataTree
        Of one method `coefficient(force)` (dimensionless unless its `unit` says otherwise),
        `standard_error(force)`, `covariance(force, other_force)`, `active(force)`, `refers_to(force)`
        (rad/s), scalars `reference_frequency`, `asymptotic_frequency` (rad/s), `noise` (rad, RMS over the
        runs); provenance in its attrs. Where the model leaves more than noise also `error_of_noise(force)`,
        `error_of_model(force)`, `held_out_rms`. Of two methods the result of `cross_check`, of several runs
        with the group `runs`, whether these agree (`validation.run_agreement`).

    Raises
    ------
    DecayError
        The decay cannot support the request.
    UsageError
        Not a library, or not a method.
    """
    single = method is not None and not isinstance(method, Sequence)
    asked: Sequence[Any] = [method] if single else method or []  # type: ignore[assignment]
    library = checked_library("identify", library, asked)
    chosen = [constrained(kind, Constraints(constraints)) for kind in asked or usual_methods(decay, library)]
    if single:
        (result,) = identifications(decay, library, chosen)
        return result if contactless is None else with_contactless_frequency(result, *contactless)
    tree = _held_against_each_other(decay, library, chosen, tell)
    if contactless is None:
        return tree
    return map_identifications(tree, lambda result: with_contactless_frequency(result, *contactless))


def usual_methods(
    decay: Decays,
    library: ForceLibrary,
    reference_frequency: float | None = None,
    shapes: dict[str, float] | None = None,
    own: tuple[str, ...] = (),
    warm_up: float = 0.0,
) -> list[Method]:
    """The two methods that are held against each other.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One decay, or several runs.
    library : ForceLibrary
        The forces offered.
    reference_frequency : float, rad/s, optional
        Held; else it is fitted.
    shapes : dict of str to float, optional
        Shape parameters that are held.
    own : tuple of str
        Forces whose coefficient is each run's own, of driven records.
    warm_up : float, s
        Beginning of each driven record that does not count in the fit of its motion.

    Raises
    ------
    UsageError
        A coefficient of each run's own is asked for of free decays.
    """
    asked = {"reference_frequency": reference_frequency, "shapes": shapes or {}}
    averaging, direct, trajectory = (kind(**asked) for kind in (Averaging, Direct, Trajectory))  # type: ignore
    runs = as_runs(decay, driven=True)
    if is_driven(runs):
        return [Direct(**asked, own=own), Trajectory(**asked, own=own, warm_up=warm_up)]  # type: ignore
    if own:
        raise UsageError(
            "Coefficients of each run's own are of driven records (--input); identify each free decay alone."
        )
    # Amplitudes and frequencies tell no term of the sensor from a force, and not all forces from each other.
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)
    averaged = all(force.kind == "force" for force in library) and averages_decide(
        library, size, frequency_free=reference_frequency is None, shapes=shapes
    )
    if any(MEASURED in run for run in runs):
        # What is reported last is that in the quantity that was measured.
        return [averaging if averaged else direct, trajectory]
    # One that is too short or grows has no envelope to be averaged.
    if not averaged or any(run.attrs.get("taken_as_it_is") for run in runs):
        return [trajectory, direct]
    return [averaging, direct]


def _held_against_each_other(
    decay: Decays, library: ForceLibrary, methods: Sequence[Method], tell: Tell
) -> xr.DataTree:
    """The cross-check of two methods; of several runs, whether these agree."""
    if len(methods) != 2:
        raise UsageError(f"Two methods are held against each other, not {len(methods)}; or give one alone.")
    if is_driven(as_runs(decay, driven=True)):
        direct, trajectory = methods
        if not (isinstance(direct, Direct) and isinstance(trajectory, Trajectory)):
            raise UsageError("A driven record is identified by methods.Direct and methods.Trajectory.")
        return identified_driven(decay, library, direct, trajectory, tell=tell)
    slow = any(isinstance(method, Trajectory) for method in methods)
    # A fit of the motion takes seconds: no more simulated records than decide whether the two agree.
    draws = min(SIMULATED_RECORDS, fewest_records(len(library) + 1)) if slow else SIMULATED_RECORDS
    runs = as_runs(decay, driven=True)
    tree = identified_and_checked(one_or_all(list(runs)), library, methods, draws=draws, tell=tell)
    if len(runs) > 1:
        tell("each run by itself")
        second = tree[tree["comparison"].attrs["second"]].to_dataset()
        tree["runs"] = xr.DataTree(run_agreement(runs, second))
    return tree
