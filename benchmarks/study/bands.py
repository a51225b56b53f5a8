"""How often the 95 % bands of predictions 1, 3 and 10 periods ahead hold what is then measured.

Each model is identified from the first two thirds of a record. From instants in the last third, which it has
not seen, the record is predicted from the samples up to then; predictions of one horizon do not overlap.
Simulated: 60 periods from 0.3 rad at 60 samples a period, pushed until they have wandered by 1, 5 or 20 noise
levels. Beside coverage: the RMS error over the stated one, and how errors of neighbouring windows one period
ahead go together: those of a random force do not.

--measured: the records of random_force_kinds.py, with the p-value of a random force that depends on nothing
(where it is small, the model is not the record's, and its bands promise nothing); then what is predicted
wrongly one sample ahead, the ship at each sample, the steel pendulum at every tenth: largest autocorrelation
of lags 1 to 20, and the p-value that all of them are chance (Ljung and Box 1978). --across: of the film also
what of the innovations goes with the swing across, its third column.
"""

from argparse import Namespace
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import xarray as xr
from helpers import rms
from scipy.signal import lfilter

import sysid_trib as st
from benchmarks.measured import BOTH, records_folder
from benchmarks.random_force_kinds import FILM, RECORDS
from benchmarks.study.common import METHODS, Pushed, shown
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.likelihood.sensor_noise import sensor_noise_of
from sysid_trib.validation.holdout import first_held_out

CASES = [Pushed(wander, 2e-4, periods=60) for wander in (1.0, 5.0, 20.0)]
HORIZONS = (1, 3, 10)
STRIDES = {"Ship model": 1, "Steel pendulum": 10}
LAGS = 20


def errors_ahead(
    decay: xr.Dataset, library: st.forces.ForceLibrary, method
) -> tuple[list[np.ndarray], float]:
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
    if not random_force_of(result):
        return errors, float("nan")
    return errors, st.validation.random_force_dependence(part, result).p_value.item()


def row_of(title: str, decays: Iterable[xr.Dataset], library: st.forces.ForceLibrary, method) -> list[str]:
    """A kind of records in the table."""
    known, failed, p_values = [], 0, []
    for decay in decays:
        try:
            errors, p = errors_ahead(decay, library, method)
        except SysidTribError as error:
            print(f"{title}: {error}")
            failed += 1
            continue
        known.append(errors)
        p_values.append(p)
    row = [title, str(len(known)), str(failed)]
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
    """How large the film's swing across is, what of the innovations goes with it, and what is left."""
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
    """What is predicted wrongly one sample ahead in a measured record."""
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


def main(asked: Namespace) -> None:
    method = METHODS[asked.method or "direct"]
    coverages = (f"{h} ahead (%; RMS error/stated)" for h in HORIZONS)
    ends = ("neighbours' correlation", "p, depends on nothing")
    heads = ("95 % bands", "records", "failed", *coverages, *ends)
    if not asked.measured:
        chosen = (case for case in CASES if asked.only in case.title)
        rows = (
            row_of(f"simulated, {c.title}", c.records(range(asked.seeds), (5,)), c.model.library, method)
            for c in chosen
        )
        return shown("", heads, rows, 140)
    records = [record for record in RECORDS if asked.only in record.title]
    rows = (row_of(r.title, [r.decay()], BOTH.select(r.models.split()), method) for r in records)
    shown("", heads, rows, 140)
    heads = ("samples", "innovations (mrad)", "autocorrelation", "lag", "Ljung-Box p", "sqrt(q)/w^2", "found")
    shown("", ("record", *heads), (one_ahead(record, asked, method) for record in records), 160)
    return None
