"""`identify`: a decay identified by one method, or by two methods that are compared."""

from collections.abc import Mapping, Sequence
from typing import Any, overload

import numpy as np
import scipy
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib import records
from sysid_trib.arrays import Array
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, ConstraintTable
from sysid_trib.forces.force import ForceLibrary, LibraryLike
from sysid_trib.methods import Averaging, Direct, Trajectory, as_method, method_of
from sysid_trib.methods.options import constrained, with_stated
from sysid_trib.methods.scope import Method
from sysid_trib.methods.trajectory import StartsOption
from sysid_trib.records.runs import Decays, RecordsLike, as_runs, one_or_all
from sysid_trib.results import models, references, signal_scale
from sysid_trib.results.judged import last_of
from sysid_trib.results.random_force import random_force_of
from sysid_trib.results.variables import described
from sysid_trib.simulation.measured_motion import MEASURED
from sysid_trib.validation import common_reference, driven, random_effects, refits, verdict
from sysid_trib.validation.cross_check import agreement_of, identified_and_checked
from sysid_trib.validation.residuals import residuals, with_motions
from sysid_trib.validation.separability import averages_decide


@overload
def identify(
    decay: RecordsLike,
    library: LibraryLike | None,
    method: Method | str,
    *,
    constraints: ConstraintTable = ...,
    contactless: tuple[float, float] | None = ...,
    tell: Tell = ...,
) -> xr.Dataset: ...


@overload
def identify(
    decay: RecordsLike,
    library: LibraryLike | None = ...,
    method: list[Method | str] | list[Method] | tuple[Method | str, ...] | None = ...,
    *,
    constraints: ConstraintTable = ...,
    contactless: tuple[float, float] | None = ...,
    tell: Tell = ...,
) -> xr.DataTree: ...


def identify(
    decay: RecordsLike,
    library: LibraryLike | None = None,
    method: Method | str | Sequence[Method | str] | None = None,
    *,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    contactless: tuple[float, float] | None = None,
    tell: Tell = silent,
) -> xr.Dataset | xr.DataTree:
    """Identify the forces of a library from a decay, or from runs of one experiment.

    Parameters
    ----------
    decay : record, or several of them
        `angle(time)` in rad, as `free_decay` returns it, `(t, angle)`, or an equivalent object of pandas,
        xarray or NumPy; or a list of runs, which have common forces and a common reference frequency, but
        separate starts, zeros of the sensor and noises.
    library : ForceLibrary, str, or what `library` takes, optional
        The offered forces, or the name of their library; by default those of `contact_forces`, and the first
        force of each input (`gain`).
    method : method, or two methods, optional
        One method, such as `methods.Direct()` or its name, `direct`; or two methods that are compared, by
        default those of the command `identify` (`usual_methods`). If a method's `random_force` is `auto`, the
        default, the record decides on a random force (see `identifications`).
    constraints : mapping of str to float, (float, float) or str
        Fixed values, bounds and ties, `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`. A coefficient
        that a user's library states is held unless another constraint is given; `(None, None)` frees it.
    contactless : (float, float), rad/s
        Frequency without contact and its standard error; with it, alpha is identified too.
    tell : callable
        Called with a few words on the progress of the work.

    Returns
    -------
    Dataset or DataTree
        For one method: `coefficient(force)` (dimensionless unless its `unit` states otherwise),
        `standard_error(force)`, `covariance(force, other_force)`, `active(force)`, `refers_to(force)`
        (rad/s), scalars `reference_frequency`, `asymptotic_frequency` (rad/s), `noise` (rad, RMS over the
        runs); the provenance is in its attributes. If the residual is more than noise also
        `error_of_noise(force)`, `error_of_model(force)`, `held_out_rms`. For two methods: the result of
        `cross_check`; for several runs with the group `runs`, the test of their agreement
        (`validation.run_agreement`).

    Raises
    ------
    DecayError
        The decay cannot support the request.
    UsageError
        An argument is not a library, or not a method.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), "lambda,zeta,delta,nu,epsilon")
    >>> result["agreement"].attrs["verdict"]
    'agree'
    >>> zeta = st.best(result).sel(force="zeta")
    >>> print(f"{zeta.coefficient.item():.5f} ± {zeta.standard_error.item():.5f}")
    0.00970 ± 0.00004
    """
    runs = records.as_decays(decay, "identify")
    single = method is not None and not isinstance(method, list | tuple)
    named: Sequence[Any] = method if isinstance(method, list | tuple) else [method] if single else []
    asked = [as_method(kind, "identify") for kind in named]
    offered = verdict.checked_library("identify", library, runs)
    chosen = [
        constrained(kind, with_stated(constraints, offered, kind))
        for kind in asked or usual_methods(runs, offered)
    ]
    if single:
        (result,) = verdict.identifications(runs, offered, chosen)
        return result if contactless is None else references.with_contactless_frequency(result, *contactless)
    tree = _held_against_each_other(runs, offered, chosen, tell)
    return tree if contactless is None else references.with_contactless_frequency(tree, *contactless)


def usual_methods(
    decay: Decays,
    library: ForceLibrary,
    reference_frequency: float | None = None,
    shapes: dict[str, float] | None = None,
    own: tuple[str, ...] = (),
    warm_up: float = 0.0,
    starts: StartsOption = "fitted",
) -> list[Method]:
    """Return the two methods of the cross-check.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One decay, or several runs.
    library : ForceLibrary
        The offered forces.
    reference_frequency : float, rad/s, optional
        Reference frequency, which is then held; otherwise it is fitted.
    shapes : dict of str to float, optional
        Shape parameters, which are fixed.
    own : tuple of str
        Forces with a separate coefficient in each run, for driven records.
    warm_up : float, s
        Duration of the beginning of each driven record that is left out of the fit of its motion.
    starts : {"fitted", "measured"}
        Whether the start and the sensor's zero of each driven record are fitted (see `Trajectory`).

    Raises
    ------
    UsageError
        A separate coefficient in each run was requested for free decays.
    """
    asked = {"reference_frequency": reference_frequency, "shapes": shapes or {}}
    averaging, direct, trajectory = (kind(**asked) for kind in (Averaging, Direct, Trajectory))  # type: ignore
    runs = as_runs(decay, driven=True)
    if driven.is_driven(runs):
        motion = Trajectory(**asked, own=own, warm_up=warm_up, starts=starts)  # type: ignore
        return [Direct(**asked, own=own), motion]  # type: ignore
    if own:
        raise UsageError(
            "Individual coefficients of runs need driven records (--input); identify free decays one by one."
        )
    # Amplitudes and frequencies do not separate a sensor term from a force, or all forces from each other.
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)
    averaged = all(force.kind == "force" for force in library) and averages_decide(
        library, size, frequency_free=reference_frequency is None, shapes=shapes
    )
    if any(MEASURED in run for run in runs):
        # Trajectory is last, because it compares the measured quantity itself.
        return [averaging if averaged else direct, trajectory]
    # A record that is too short or grows has no envelope for averaging.
    if not averaged or any(run.attrs.get("taken_as_it_is") for run in runs):
        return [trajectory, direct]
    return [averaging, direct]


def _held_against_each_other(
    decay: Decays, library: ForceLibrary, methods: Sequence[Method], tell: Tell
) -> xr.DataTree:
    """Cross-check two methods; for several runs, test whether the runs agree."""
    if len(methods) != 2:
        raise UsageError(f"identify takes one method, or two to compare, not {len(methods)}.")
    runs = as_runs(decay, driven=True)
    if driven.is_driven(runs):
        direct, trajectory = methods
        if not (isinstance(direct, Direct) and isinstance(trajectory, Trajectory)):
            raise UsageError("A driven record is identified by methods.Direct and methods.Trajectory.")
        return driven.identified_driven(decay, library, direct, trajectory, tell=tell)
    tree = identified_and_checked(one_or_all(list(runs)), library, methods, tell=tell)
    if len(runs) > 1:
        tell("each run by itself")
        tree["runs"] = xr.DataTree(run_agreement(runs, last_of(tree)))
    return tree


@signal_scale.in_units_of_the_motion
def identified_and_judged(
    decay: Decays, library: ForceLibrary, methods: Mapping[str, Method], *, made_by: str
) -> xr.DataTree:
    """Identify the forces of a decay by methods that are judged but not compared with each other.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One decay, or several runs.
    library : ForceLibrary
        The forces offered.
    methods : mapping of str to method
        By the names that their identifications get.
    made_by : str
        Name of the caller.

    Returns
    -------
    DataTree
        The `identifications`, and `judged`, whose preferred model is that of the last method.
    """
    followed = dict(zip(methods, verdict.decided(decay, library, list(methods.values())), strict=True))
    last = [*followed][-1]
    with_models = with_motions(followed)
    if driven.is_driven(with_models):
        tested = driven.tested_driven(followed)
    else:
        tested = residuals(followed, followed[last].result)
    table = verdict.judged_models(followed, with_models, tested, preferred=last, made_by=made_by)
    return xr.DataTree.from_dict({**{name: of.result for name, of in followed.items()}, "judged": table})


@signal_scale.in_units_of_the_motion
def run_agreement(decays: Sequence[xr.Dataset], together: xr.Dataset) -> xr.Dataset:
    """Test whether the runs of one experiment have the same forces.

    Parameters
    ----------
    decays : sequence of Dataset
        The runs, each with `angle(time)` in rad.
    together : Dataset
        The common identification, whose method is applied to each run alone.

    Returns
    -------
    Dataset
        Over `run` and `quantity` (each force, and the asymptotic frequency in rad/s if it was fitted): the
        `value` from that run alone at the common reference frequency, with its `standard_error`. Over
        `quantity`: `chi_square` of the values about their weighted mean, `degrees_of_freedom`, `p_value`; and
        the same for all quantities together with their covariances (`total_...`). Values are nan for a run
        that alone does not determine them, with `reason(run)`. Attribute `verdict`: agree, disagree or
        unknown. With a random force in the common identification, also over `run` its
        `random_force_density` with its error ((rad/s^2)^2/Hz), nan if a run does not determine it;
        `density_chi_square`, `density_degrees_of_freedom`, `density_p_value`, and the attribute
        `density_verdict`.

    Notes
    -----
    A random force is estimated in each run alone, so that its errors are those of that run.

    The statistic is Cochran's Q. It is large if a force changes from run to run (wear), or differs in form
    from the model's force: its coefficient then changes with amplitude.

    Examples
    --------
    >>> import sysid_trib as st
    >>> runs = [st.free_decay(st.records.paper_twin(seed=seed)) for seed in (1, 2)]
    >>> together = st.identify(runs, method="direct")
    >>> agreement = st.validation.run_agreement(runs, together)
    >>> agreement.attrs["verdict"]
    'agree'
    >>> agreement.value.sel(quantity="zeta").round(4).values.tolist()
    [0.0096, 0.0097]
    """
    method, library = method_of(together), models.library_of(together, whole=True)
    kept, frequency = common_reference.comparable(together), together.reference_frequency.item()
    # `discovery.parts.homogeneity` is the score test for the same question: it fits no run alone, and so
    # suits every model of a search, but gives no values of the runs.
    results, reasons = zip(*(refits.refit(method, [decay], library) for decay in decays), strict=True)
    free = together.reference_frequency_standard_error.item() > 0.0
    names = [*kept, *[common_reference.ASYMPTOTIC_FREQUENCY] * free]
    count = len(names)
    values, covariances = refits.at_reference(results, kept, frequency)
    if not random_force_of(together):
        # The frequency of a free motion is so precise that it must not affect the coefficients' errors.
        for at in np.flatnonzero(np.isfinite(values[:, -1])):
            covariances[at] = references.stated_covariance(results[at], kept)
    values, covariances = values[:, :count], covariances[:, :count, :count]
    usable = np.isfinite(values).all(axis=1)
    v, c = values[usable], covariances[usable]
    one_by_one = [_homogeneity(v[:, [j]], c[:, [j]][:, :, [j]]) for j in range(count)]
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    variables: dict[str, Any] = {"value": values, "standard_error": errors, "reason": list(reasons)}
    variables |= _tested("", *np.array(one_by_one).T) | _tested("total_", *_homogeneity(v, c))
    attrs = {"verdict": agreement_of(float(variables["total_p_value"]))}
    if random_force_of(together):
        variables |= _density_agreement(results, together)
        attrs["density_verdict"] = agreement_of(float(variables["density_p_value"]))
    return xr.Dataset(described("run_agreement", variables), {"quantity": names}, attrs)


def _tested(of: str, chi_square: ArrayLike, degrees_of_freedom: ArrayLike) -> dict[str, ArrayLike]:
    """Return a chi-square with its p-value, with names that have this prefix."""
    tested = {"chi_square": chi_square, "degrees_of_freedom": degrees_of_freedom}
    tested["p_value"] = scipy.stats.chi2.sf(chi_square, degrees_of_freedom)
    return {f"{of}{name}": value for name, value in tested.items()}


def _homogeneity(values: Array, covariances: Array) -> tuple[float, float]:
    """Return the chi-square of (run, quantity) about their weighted mean, and degrees of freedom."""
    if len(values) < 2:
        return np.nan, 0.0
    return random_effects.weighted_mean(values, covariances)[2], float((len(values) - 1) * values.shape[1])


def _density_agreement(results: Sequence[xr.Dataset | None], together: xr.Dataset) -> dict[str, Any]:
    """Test for `run_agreement` whether the random force has the same density in all runs.

    A ratio of variances is tested by its logarithm: for a density with the relative error e, its logarithm
    has the standard error e. If the most likely density S is zero, the deviance rises from there by S/u, that
    is by one at the standard error u of the common identification, because such a run contains no more
    information. The statistic is the least sum of the runs' deviances at one common density.
    """
    densities, errors = np.full((2, len(results)), np.nan)
    for at, result in enumerate(results):
        if result is not None:
            force = random_force_of(result)
            densities[at] = force.density
            errors[at] = (force if force else random_force_of(together, at)).standard_error
    known = np.isfinite(densities) & np.isfinite(errors) & (errors > 0.0)
    zero, some = known & (densities == 0.0), known & (densities > 0.0)
    statistic, count = np.nan, max(0, int(known.sum()) - 1)
    if count and some.any():
        logs, relative = np.log(densities[some]), errors[some] / densities[some]

        def deviance(log_density: float) -> float:
            of_some = np.sum(((log_density - logs) / relative) ** 2)
            return float(of_some + np.sum(np.exp(log_density) / errors[zero]))

        statistic = scipy.optimize.minimize_scalar(deviance, bracket=(logs.min() - 1.0, logs.max())).fun
    return {"random_force_density": (densities, errors), **_tested("density_", statistic, count)}
