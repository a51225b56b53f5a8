"""Noises of a record as identified, and predictions with them.

verdicts: is "explained with a random force" said where it is true, and not where a force was left out? First
motions with nothing beside the sensor's noise: they are explained. Then motions that are pushed by a white
force alone: p-values of `random_force_dependence` are uniform. Then motions without a random force in which
one effect of the library acts that the model has not: its coefficient is 60 to 200 standard errors of a fit
that offers it (Cramér-Rao bound in white noise as strong as that of the sensor at the frequency of the
swing).
bands: how often 95 % bands of predictions 1, 3 and 10 periods ahead hold what is then measured. Each model is
identified from the first two thirds of a record. From instants in the last third, which it has not seen, the
record is predicted from the samples up to then; predictions of one horizon do not overlap. Simulated: 60
periods from 0.3 rad at 60 samples a period, pushed until they have wandered by 1, 5 or 20 noise levels.
Beside coverage: the RMS error over the stated one, and how errors of neighbouring windows one period ahead go
together: those of a random force do not.
bands --measured: the records of random_force_kinds.py, with the p-value of a random force that depends on
nothing (where it is small, the model is not the record's, and its bands promise nothing); then what is
predicted wrongly one sample ahead, the ship at each sample, the steel pendulum at every tenth: largest
autocorrelation of lags 1 to 20, and the p-value that all of them are chance (Ljung and Box 1978). --across:
of the film also what of the innovations goes with the swing across, its third column.
"""

from argparse import Namespace
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import xarray as xr
from helpers import correlated_noise, rms
from scipy.signal import lfilter

import sysid_trib as st
from benchmarks.measured import BOTH, records_folder
from benchmarks.random_force_kinds import FILM, RECORDS
from benchmarks.study.common import METHODS, NOISE, Pushed, W, density_of, over_seeds, shown, time_of, tried
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.sensor_noise import sensor_noise_of
from sysid_trib.results.random_force import random_force_of
from sysid_trib.validation.holdout import first_held_out

PER_PERIOD, ANGLE = 60, 0.3
TRUTH = {"zeta": 5e-3, "delta": 2e-3, "epsilon": -0.1}
OFFERED = st.load_library("contact_forces").select(TRUTH)
MODEL = st.Model(OFFERED, TRUTH, W)
EFFECTS = st.load_library("candidate_effects")
LEFT_OUT = [force for force in EFFECTS if force.kind == "force"]
TIME = time_of(20, PER_PERIOD)
# Autocorrelation of the sensor's noise from sample to sample.
NOISES = {"white": 0.0, "AR(0.8)": 0.8}


def decay_of(model: st.Model, noise: str, seed: int, wander: float = 0.0) -> xr.Dataset:
    """A simulated record with the sensor's noise."""
    angle = st.simulate(model, TIME, ANGLE, random_force=density_of(wander, TIME), seed=seed).angle
    return xr.Dataset({"angle": angle + correlated_noise(len(TIME), seed, NOISES[noise], NOISE)})


def noise_at_swing(noise: str) -> float:
    """Standard deviation of white noise that is as strong as the sensor's at the swing's frequency, rad."""
    correlation, turn = NOISES[noise], np.exp(-2j * np.pi / PER_PERIOD)
    return float(NOISE * np.sqrt(1.0 - correlation**2) / np.abs(1.0 - correlation * turn))


def p_value(decay: xr.Dataset, result: xr.Dataset) -> float:
    """Return the p-value that a random force is independent of the motion; nan without a random force."""
    known = bool(random_force_of(result))
    return st.validation.random_force_dependence(decay, result).p_value.item() if known else np.nan


def verdict_of(decay: xr.Dataset, method) -> dict:
    """Return the verdict on a record, and the p-value of a random force independent of the motion."""
    result = st.identify(decay, OFFERED, method)
    tree = st.cross_check(decay, result, result)
    p = tree["random_force"].p_value.item() if "random_force" in tree.children else np.nan
    return {"verdict": tree["judged"].attrs["verdict"], "p": p}


def with_effect(force: st.forces.Force, random: np.random.Generator, noise: float) -> st.Model | None:
    """The model with an effect of 60 to 200 standard errors; None where no such motion exists."""
    zero, coefficient = EFFECTS["bias"], 1e-4
    if force.symbol == zero.symbol:
        return None
    library = st.forces.ForceLibrary("with one that is left out", (*OFFERED, force))
    # The bound takes the sensor's zero as known; a constant force is the same as one that is fitted.
    whole, shapes = st.forces.ForceLibrary("with a free zero", (*library, zero)), library.shape_values()
    # The error hardly depends on the coefficient, but where the force makes switchings.
    for _ in range(3):
        model = st.Model(whole, TRUTH | {force.symbol: coefficient, zero.symbol: 0.0}, W, shapes)
        bound = st.validation.cramer_rao_bound(model, TIME, ANGLE, 0.0, noise, free=True)
        coefficient = 60.0 * bound.standard_error.sel(force=force.symbol).item()
    if not np.isfinite(coefficient) or coefficient > 1.0:
        return None
    factor = float(np.exp(random.uniform(0.0, np.log(200.0 / 60.0))))
    return st.Model(library, TRUTH | {force.symbol: factor * coefficient}, W, shapes)


def verdicts(asked: Namespace) -> None:
    noise = asked.noise
    for name in [asked.method] if asked.method else ("trajectory", "direct"):
        method = METHODS[name]

        def alone(seed: int, method=method) -> dict:
            return verdict_of(decay_of(MODEL, noise, asked.first + seed), method)

        def moved(seed: int, wander: float, method=method) -> dict:
            decay = decay_of(MODEL, noise, asked.first + seed, wander)
            return {"p": p_value(decay, st.identify(decay, OFFERED, method))}

        def left_out(seed: int, method=method) -> dict:
            seed += asked.first
            force = LEFT_OUT[seed % len(LEFT_OUT)]
            model = None
            with suppress(SysidTribError):
                model = with_effect(force, np.random.default_rng(seed), noise_at_swing(noise))
            said = verdict_of(decay_of(model, noise, seed), method) if model else {}
            return {"symbol": force.symbol} | said

        print(f"{name}, {noise} noise")
        names = {"method": name, "noise": noise}
        if not asked.left_out:
            rows = over_seeds(asked, alone, case="alone", **names)
            said = Counter(row.get("verdict", "failed") for row in rows)
            print(f"noise alone: {', '.join(f'{word} {count}' for word, count in said.items())}", flush=True)
            for wander in (1, 5, 20):
                rows = over_seeds(asked, lambda seed, of=wander: moved(seed, of), case=f"{wander}", **names)
                values = np.array([row["p"] for row in rows if "p" in row])
                known = values[np.isfinite(values)]
                rates = ", ".join(f"{100.0 * np.mean(known < level):.1f} %" for level in (0.01, 0.1, 0.5))
                print(
                    f"pushed, wander {wander:2}: p below 1, 10, 50 %: {rates} of {len(known)} records; no "
                    f"random force found {len(values) - len(known)}, failed {len(rows) - len(values)}",
                    flush=True,
                )
        rows = over_seeds(asked, left_out, case="left out", **names)
        failed = sum("failed" in row for row in rows)
        judged = [row for row in rows if "verdict" in row]
        counts = ", ".join(f"{word} {n}" for word, n in Counter(row["verdict"] for row in judged).items())
        wrong = [row for row in judged if row["verdict"] != "not explained"]
        missed = ", ".join(f"{row['symbol']} ({row['verdict']}, p {row['p']:.2g})" for row in wrong)
        print(f"left out: {counts}; wrong: {missed or 'none'}; no identification: {failed}", flush=True)


CASES = [Pushed(wander, 2e-4, periods=60) for wander in (1.0, 5.0, 20.0)]
HORIZONS = (1, 3, 10)
STRIDES = {"Ship model": 1, "Steel pendulum": 10}
LAGS = 20


def errors_ahead(decay: xr.Dataset, library: st.forces.ForceLibrary, method) -> dict:
    """Errors over the stated ones of each horizon; p-value of a random force that depends on nothing."""
    time = decay.time.values.astype(float)
    first = first_held_out(time)
    part = decay.isel(time=slice(0, first))
    result = st.identify(part, library, method)
    period, errors = 2.0 * np.pi / float(result.reference_frequency), []
    for ahead in HORIZONS:
        origins = np.arange(time[first], time[-1] - ahead * period, ahead * period)
        z = np.empty(0)
        if len(origins):
            bands = st.validation.prediction_bands(decay, result, [ahead], origins=list(origins))
            z = ((bands.measured - bands.predicted) / bands.predicted_standard_error).values.ravel()
        errors.append(z[np.isfinite(z)])
    return {"errors": errors, "p": p_value(part, result)}


def row_of(title: str, decays: Iterable[xr.Dataset], library: st.forces.ForceLibrary, method) -> list[str]:
    """A kind of records in the table."""
    rows = [tried(errors_ahead, decay, library, method) for decay in decays]
    known = [row["errors"] for row in rows if "errors" in row]
    p_values = [row["p"] for row in rows if "p" in row]
    row = [title, str(len(known)), str(len(rows) - len(known))]
    for at in range(len(HORIZONS)):
        z = np.concatenate([errors[at] for errors in known]) if known else np.empty(0)
        inside, size = (100.0 * np.mean(np.abs(z) < 1.96), rms(z)) if len(z) else (np.nan, np.nan)
        row.append(f"{inside:.1f} of {len(z)}; {size:.2f}")
    pairs = [float(e[0][1:] @ e[0][:-1]) for e in known], [float(e[0] @ e[0]) for e in known]
    p = f"{p_values[0]:.2g}" if len(p_values) == 1 else f"{np.mean(np.array(p_values) < 0.01):.2f} < 0.01"
    return [*row, f"{sum(pairs[0]) / max(sum(pairs[1]), 1e-300):+.2f}", p]


def correlations(values: np.ndarray) -> np.ndarray:
    """Autocorrelation of lags 1 to 20."""
    return np.array([values[lag:] @ values[:-lag] for lag in range(1, LAGS + 1)]) / (values @ values)


def across(decay: xr.Dataset, innovations: np.ndarray, filter_: np.ndarray) -> str:
    """Report the film's swing across, the part of the innovations that it explains, and the rest."""
    x, y = decay.angle.values, np.loadtxt(records_folder() / FILM)[:, 2]
    y = y - np.mean(y)
    columns = np.stack([y, np.gradient(y), y**2, x * y, x * y**2, x**2 * y, np.gradient(x) * y], axis=1)
    columns = lfilter(filter_, [1.0], columns, axis=0)
    rest = innovations - columns @ np.linalg.lstsq(columns, innovations, rcond=None)[0]
    part = 100.0 * (1.0 - (rest @ rest) / (innovations @ innovations))
    # Half of the period of 33 frames.
    halves = [correlations(values)[13:19].max() for values in (innovations, rest)]
    return (
        f"across: {1e3 * y.std():.0f} mrad RMS beside {1e3 * x.std():.0f}; {part:.0f} % of the innovations' "
        f"variance; autocorrelation of lags 14 to 19 {halves[0]:+.3f}, then {halves[1]:+.3f}"
    )


def one_ahead(record, asked: Namespace, method) -> list[str]:
    """Report the one-step prediction errors of a measured record."""
    decay = replace(record, stride=STRIDES.get(record.title, record.stride)).decay()
    result = st.identify(decay, BOTH.select([*record.models.split(), *asked.also.split()]), method)
    ahead = st.validation.innovations(decay, result)
    if asked.across and record.file == FILM:
        scaled = (ahead.innovation / ahead.innovation_standard_deviation).values
        print(across(decay, scaled, sensor_noise_of(result).filter_))
    correlation = ahead.autocorrelation.values[:LAGS]
    most = int(np.argmax(np.abs(correlation)))
    size = np.sqrt(random_force_of(result).density) / float(result.reference_frequency) ** 2
    found = zip(result.force.values, result.coefficient.values, result.standard_error.values, strict=True)
    return [
        *(record.title, f"{decay.sizes['time']:,}", f"{1e3 * float(ahead.innovation_rms):.4f}"),
        *(f"{correlation[most]:+.3f}", str(most + 1), f"{float(ahead.ljung_box_p_value):.1g}", f"{size:.2e}"),
        ", ".join(f"{name} {value:.5f} ± {error:.5f}" for name, value, error in found),
    ]


def bands(asked: Namespace) -> None:
    method = METHODS[asked.method or "direct"]
    kinds = (
        ((r.title, [r.decay()], BOTH.select(r.models.split())) for r in RECORDS)
        if asked.measured
        else ((f"simulated, {c.title}", c.records(range(asked.seeds), (5,)), c.model.library) for c in CASES)
    )
    heads = ["95 % bands", "records", "failed", *(f"{h} ahead (%; RMS error/stated)" for h in HORIZONS)]
    heads += ["neighbours' correlation", "p, depends on nothing"]
    shown("", heads, (row_of(*kind, method) for kind in kinds if asked.only in kind[0]), 140)
    if asked.measured:
        heads = ["record", "samples", "innovations (mrad)", "autocorrelation", "lag", "Ljung-Box p"]
        rows = (one_ahead(record, asked, method) for record in RECORDS if asked.only in record.title)
        shown("", [*heads, "sqrt(q)/w^2", "found"], rows, 160)
