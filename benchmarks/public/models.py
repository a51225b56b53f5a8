"""Models of the public benchmarks: candidates, the choice among them on the training part, and free runs.

Nothing here sees the output of a test, except `free_run` the first samples that the benchmark grants.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks.public.signals import Array, Signals, Test, Units
from sysid_trib.errors import RecordError, SysidTribError
from sysid_trib.forces import ForceLibrary
from sysid_trib.records.inputs import KnownInput

LIBRARIES = ("inputs", "contact_forces", "candidate_effects", "hysteresis")
# Share of the training part, at its end, that is held out for the choice.
HELD_OUT = 0.25
# A model with more parameters must reduce the error of the held-out samples by 1 %.
WORTH = 0.99
# Periods of a periodic input that are simulated before the test, for its steady state.
PERIODS_BEFORE = 3
# Samples at the beginning of a held-out part to which its start is fitted.
START_OF_HELD_OUT = 50

# Silverbox: a stretch has some 57 periods; those with the smaller largest values train, the quarter with the
# largest is held out.
STRETCH = 512
SMALLER, LARGER = 0.5, 0.75
# Symbols without w, which is fitted too: FIVE and SIX have five and six parameters.
FIVE = ("gain", "zeta", "epsilon", "even_spring")
# `discover` adds the damping of the power 3/2 next, from the training part.
SIX = (*FIVE, "three_halves_damping")
SEVEN = (*SIX, "van_der_pol")
EIGHT = (*FIVE, "delta", "lambda", "quintic")
TWELVE = (*EIGHT, "nu", "van_der_pol", "tilted_damping", "gain_delay")
SILVERBOX = (FIVE, SIX, SEVEN, EIGHT, TWELVE)

# EMPS: a body without a restoring force; asymmetric friction is an even function of speed.
AXIS = ("free_axis", "gain", "zeta", "lambda", "bias")
ASYMMETRIC = ((), ("even_drag",), ("even_speed",))
WITHOUT_SPRING = {"free_axis": 1.0}

# Bouc-Wen, s: the motion still depends on the unknown states.
TRANSIENT = 1.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model that may be chosen.

    Parameters
    ----------
    name : str
        Its forces.
    parameters : int
        Parameters that are fitted, the reference frequency among them where the body has a spring.
    fit : callable
        Returns the identification of a list of records.
    """

    name: str
    parameters: int
    fit: Callable[[Sequence[xr.Dataset]], xr.Dataset]


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate, and how it predicts the held-out samples.

    Parameters
    ----------
    candidate : Candidate
    error : float
        RMS error of the held-out samples, in the unit of the output; infinite if it cannot be fitted.
    reason : str
        Why it cannot be fitted.
    """

    candidate: Candidate
    error: float
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Chosen:
    """The chosen model, fitted to the whole training part.

    Parameters
    ----------
    trials : tuple of Trial
    trial : Trial
        The chosen one.
    result : Dataset
        Its identification of the whole training part.
    said : str
        A sentence that states how it was chosen.
    seconds : float
        Processor time of the choice and the fit.
    zero : float
        Output of the sensor at rest, from the training part.
    """

    trials: tuple[Trial, ...]
    trial: Trial
    result: xr.Dataset
    said: str
    seconds: float
    zero: float = 0.0


def forces(symbols: Sequence[str]) -> ForceLibrary:
    """Return these forces of the libraries of the package."""
    known = {}
    for name in LIBRARIES:
        for force in st.load_library(name):
            known.setdefault(force.symbol, force)
    return replace(st.load_library("inputs"), forces=tuple(known[symbol] for symbol in symbols))


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _smallest_sufficient(trials: Sequence[Trial]) -> Trial:
    """Return the smallest model whose error is within 1 % of the least; of equally small ones the best."""
    least = min(trial.error for trial in trials)
    sufficient = (trial for trial in trials if WORTH * trial.error <= least)
    return min(sufficient, key=lambda trial: (trial.candidate.parameters, trial.error))


def _choose(
    candidates: Sequence[Candidate],
    error: Callable[[Candidate], float],
    whole: xr.Dataset,
    said: str,
) -> Chosen:
    """Return the candidate with the smallest held-out error, fitted to the whole training part.

    Raises
    ------
    SysidTribError
        No candidate can be fitted.
    """
    begin = time.process_time()
    trials: list[Trial] = []
    for candidate in candidates:
        try:
            trials.append(Trial(candidate, error(candidate)))
        except SysidTribError as reason:
            trials.append(Trial(candidate, np.inf, str(reason)))
    if all(trial.reason for trial in trials):
        raise SysidTribError(trials[0].reason)
    trial = _smallest_sufficient(trials)
    result = trial.candidate.fit([whole])
    return Chosen(tuple(trials), trial, result, said, time.process_time() - begin)


def choose_silverbox(training: Signals, units: Units) -> Chosen:
    """Choose the forces by how they extrapolate to larger amplitudes.

    The stretches of smaller amplitude train. The free run of the whole training part is compared in the
    stretches of the largest amplitude.
    """
    whole = training.record(units)
    firsts = range(0, len(training) - STRETCH + 1, STRETCH)
    largest = np.array([np.abs(training.y[first : first + STRETCH]).max() for first in firsts])
    calm = largest <= np.quantile(largest, SMALLER)
    calm_parts = [
        training.part(f, f + STRETCH).record(units)
        for f, is_calm in zip(firsts, calm, strict=True)
        if is_calm
    ]
    held_out = np.repeat(largest > np.quantile(largest, LARGER), STRETCH)
    of_training = Test("training part", training, START_OF_HELD_OUT)

    def candidate(symbols: tuple[str, ...]) -> Candidate:
        method = st.methods.Direct(random_force="off")
        return Candidate(
            " ".join(symbols),
            len(symbols) + 1,
            lambda records: method.identify(list(records), forces(symbols)),
        )

    def error(one: Candidate) -> float:
        run = free_run(one.fit(calm_parts), of_training, units)
        residual = (training.y - run)[: len(held_out)]
        return _root_mean_square(residual[held_out] - np.mean(residual[~held_out]))

    said = (
        f"chosen by stretches of {STRETCH} samples of the training part: fitted to the half with the smaller "
        "amplitudes, compared on the quarter with the largest"
    )
    chosen = _choose([candidate(symbols) for symbols in SILVERBOX], error, whole, said)
    zero = float(np.mean(training.y - free_run(chosen.result, of_training, units)))
    return replace(chosen, zero=zero)


def choose_emps(training: Signals, units: Units) -> Chosen:
    """Choose the friction of the carriage by the last quarter of the training part."""
    kept, held_out = _divided(training)

    def candidate(further: tuple[str, ...]) -> Candidate:
        symbols = (*AXIS, *further)
        method = st.methods.Trajectory(random_force="off", constraints=WITHOUT_SPRING)
        # The frequency only scales the coefficients, and free_axis is held.
        return Candidate(
            " ".join(symbols),
            len(symbols) - 1,
            lambda records: method.identify(list(records), forces(symbols)),
        )

    def error(one: Candidate) -> float:
        run = free_run(one.fit([kept.record(units)]), held_out, units)
        return _root_mean_square(held_out.counted - run[held_out.start_samples :])

    said = "chosen by the last quarter of the training part, fitted to the rest"
    return _choose([candidate(further) for further in ASYMMETRIC], error, training.record(units), said)


def choose_bouc_wen(training: Signals, units: Units) -> Chosen:
    """Choose between the linear model and what `discover` makes of it."""
    begin = time.process_time()
    end = int((1.0 - HELD_OUT) * len(training))
    first = training.part(0, end).record(units)
    # The start is forgotten long before the last quarter.
    from_rest = Test("training part", training, 0)
    tree = st.discover(first)
    candidates = [
        _fitted_from(st.physics.model_of(tree[name].to_dataset()))
        for name in ("before", "after")
        if name in tree
    ]

    def error(one: Candidate) -> float:
        run = free_run(one.fit([first]), from_rest, units)
        return _root_mean_square((training.y - run)[end:])

    said = (
        "forces found by discover in the first three quarters of the training part, from gain and viscous "
        "friction; compared with the linear model on the last quarter"
    )
    chosen = _choose(candidates, error, training.record(units), said)
    return replace(chosen, seconds=time.process_time() - begin)


def _fitted_from(model: st.Model) -> Candidate:
    """Return a candidate that is fitted by `Trajectory` from a model, with all its shape parameters."""
    shapes = tuple(model.shapes)
    method = st.methods.Trajectory(random_force="off", start=model, fit_shapes=shapes, warm_up=TRANSIENT)
    symbols = model.library.symbols
    return Candidate(
        " ".join(symbols),
        len(symbols) + 1 + len(shapes),
        lambda records: method.identify(list(records), model.library),
    )


def _divided(training: Signals) -> tuple[Signals, Test]:
    """Return the first three quarters, and the last quarter as a test."""
    end = int((1.0 - HELD_OUT) * len(training))
    return training.part(0, end), Test("", training.part(end), START_OF_HELD_OUT)


def free_run(result: xr.Dataset, test: Test, units: Units, *, zero: float = 0.0) -> Array:
    """Return the output of a model for the input of a test.

    With `start_samples` the start is fitted to the output of these samples (`st.predict`). Without, the
    motion starts from rest; that of a periodic test a few periods earlier.

    Parameters
    ----------
    result : Dataset
        Identification.
    test : Test
        Only its input and the first `start_samples` of its output are used.
    units : Units
    zero : float
        Output of the sensor at rest.

    Returns
    -------
    (sample,) array of float, in the unit of the output.

    Raises
    ------
    RecordError
        A sample of the beginning is an outlier, so that no start at the first sample is known.
    """
    if test.start_samples:
        return zero + _from_start_samples(result, test, units)
    repeated = PERIODS_BEFORE + 1 if test.periodic else 1
    u = np.tile(test.signals.u, repeated)
    elapsed = test.signals.sampling_time * np.arange(len(u))
    model = replace(st.physics.model_of(result), inputs={"u": KnownInput(elapsed, u, units.between)})
    return zero + st.simulate(model, elapsed, 0.0).angle.values[-len(test.signals) :]


def _from_start_samples(result: xr.Dataset, test: Test, units: Units) -> Array:
    """Return the free run, without the sensor's zero, whose start is fitted to the granted samples."""
    signals = test.signals
    # The other samples are hidden: not even a check of the record sees them.
    hidden = np.where(np.arange(len(signals)) < test.start_samples, signals.y, 0.0)
    record = replace(signals, y=hidden).record(units)
    warm_up = (test.start_samples - 0.5) * signals.sampling_time
    predicted = st.predict(result, record, warm_up=warm_up)
    # The few samples determine the zero worse than the training part does.
    run = (predicted.predicted_angle - predicted.offset).values
    if len(run) != len(signals):
        raise RecordError(
            f"{test.name}: {len(signals) - len(run)} samples at its ends are outliers; correct the record."
        )
    return run
