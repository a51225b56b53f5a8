"""What is predicted wrongly one sample ahead in the measured records, and how it is correlated.

python benchmarks/innovations.py [--method direct|trajectory] [--only TEXT] [--also SYMBOLS]

The records and models of random_force_kinds.py: the ship at each sample, the steel pendulum at every tenth.
Largest autocorrelation of lags 1 to 20, and the p-value that all of them are chance (Ljung and Box 1978).
"""

import argparse
from dataclasses import replace

import numpy as np
from random_force_kinds import BOTH, RECORDS
from rich.console import Console
from rich.table import Table

import sysid_trib as st
from sysid_trib.noise.random_force import random_force_of

STRIDES = {"Ship model": 1, "Steel pendulum": 10}
LAGS = 20
METHODS = {
    "direct": st.methods.Direct(random_force="auto"),
    "trajectory": st.methods.Trajectory(random_force="auto"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--only", default="", help="records whose title has this text")
    parser.add_argument("--also", default="", metavar="SYMBOLS", help="candidate effects beside the models")
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
        ahead = st.innovations(decay, result)
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
