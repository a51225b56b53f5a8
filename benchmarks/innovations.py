"""What is predicted wrongly one sample ahead in the measured records, and how it is correlated.

python benchmarks/innovations.py [--method direct|trajectory] [--only TEXT] [--also SYMBOLS]

The records and models of random_force_kinds.py: the ship at each sample, the steel pendulum at every tenth.
Largest autocorrelation of lags 1 to 20, and the p-value that all of them are chance (Ljung and Box 1978).
--across: of the film also what of the innovations goes with the swing across, its third column y: least
squares of y, y', y^2, x y, x y^2, x^2 y and x' y, filtered as the innovations are.
"""

import argparse
from dataclasses import replace

import numpy as np
import xarray as xr
from measured import records_folder
from random_force_kinds import BOTH, FILM, RECORDS
from rich.console import Console
from rich.table import Table
from scipy.signal import lfilter

import sysid_trib as st
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.likelihood.sensor_noise import sensor_noise_of

STRIDES = {"Ship model": 1, "Steel pendulum": 10}
LAGS = 20
# Of the film: half of its period of 33 frames, by place of the lag.
HALF_PERIOD = slice(13, 19)
METHODS = {
    "direct": st.methods.Direct(random_force="estimated"),
    "trajectory": st.methods.Trajectory(random_force="estimated"),
}


def across(decay: xr.Dataset, innovations: np.ndarray, filter_: np.ndarray) -> str:
    """How large the swing across is, what of the innovations goes with it, and how the rest is correlated."""
    x, y = decay.angle.values, np.loadtxt(records_folder() / FILM)[:, 2]
    y = y - np.mean(y)
    columns = np.stack([y, np.gradient(y), y**2, x * y, x * y**2, x**2 * y, np.gradient(x) * y], axis=1)
    columns = lfilter(filter_, [1.0], columns, axis=0)
    rest = innovations - columns @ np.linalg.lstsq(columns, innovations, rcond=None)[0]
    part = 1.0 - (rest @ rest) / (innovations @ innovations)
    halves = [correlations(values)[HALF_PERIOD].max() for values in (innovations, rest)]
    return (
        f"across: {1e3 * y.std():.0f} mrad RMS beside {1e3 * x.std():.0f}; {100.0 * part:.0f} % of the "
        f"innovations' variance; autocorrelation of lags 14 to 19 {halves[0]:+.3f}, then {halves[1]:+.3f}"
    )


def correlations(values: np.ndarray) -> np.ndarray:
    """Autocorrelation of lags 1 to 20."""
    return np.array([values[lag:] @ values[:-lag] for lag in range(1, LAGS + 1)]) / (values @ values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--only", default="", help="records whose title has this text")
    parser.add_argument("--also", default="", metavar="SYMBOLS", help="candidate effects beside the models")
    parser.add_argument("--across", action="store_true", help="what goes with the film's swing across")
    asked = parser.parse_args()
    columns = (
        "samples",
        "innovations (mrad)",
        "autocorrelation",
        "lag",
        "Ljung-Box p",
        "sqrt(q)/w^2",
        "found",
    )
    table = Table("record", *columns)
    for record in RECORDS:
        if asked.only not in record.title:
            continue
        decay = replace(record, stride=STRIDES.get(record.title, record.stride)).decay()
        result = st.identify(
            decay, BOTH.select([*record.models.split(), *asked.also.split()]), METHODS[asked.method]
        )
        ahead = st.validation.innovations(decay, result)
        if asked.across and record.file == FILM:
            normalised = (ahead.innovation / ahead.innovation_standard_deviation).values
            print(across(decay, normalised, sensor_noise_of(result).filter_))
        correlation = ahead.autocorrelation.values[:LAGS]
        most = int(np.argmax(np.abs(correlation)))
        size = np.sqrt(random_force_of(result).density) / float(result.reference_frequency) ** 2
        values = zip(
            result.force.values, result.coefficient.values, result.standard_error.values, strict=True
        )
        table.add_row(
            record.title,
            f"{decay.sizes['time']:,}",
            f"{1e3 * float(ahead.innovation_rms):.4f}",
            f"{correlation[most]:+.3f}",
            str(most + 1),
            f"{float(ahead.ljung_box_p_value):.1g}",
            f"{size:.2e}",
            ", ".join(f"{name} {value:.5f} ± {error:.5f}" for name, value, error in values),
        )
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
