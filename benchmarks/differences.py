"""Rate of false disagreement between two correct methods, and calibration of the error of their difference.

python -m benchmarks differences [--seeds 50] [--only WORDS]

Of each kind of record, simulated by a model that is offered whole: the part of the seeds with a p-value of
the cross-check below 1 % (bar: 0.3 to 2 % over all kinds), 10 and 50 %; how often errors come from the
influence of the samples; and the scatter of each difference over its stated error, by quantity (known to
1/sqrt(2 seeds); bar: 0.9 to 1.1). The stated error holds a tenth of the first method's for what first order
leaves out: where the methods differ by less than a third of their errors, the scatter is below it by design.
"""

from argparse import Namespace
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

import sysid_trib as st
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.methods.scope import Method
from sysid_trib.validation.cross_check import HOMOGENEITY_LEVEL, comparison
from sysid_trib.validation.verdict import decided

FREQUENCY, PER_PERIOD = 9.91, 32


class Kind(NamedTuple):
    """A model, and how it is recorded: periods, noise (rad), start (rad), random force, and the methods."""

    coefficients: dict[str, float]
    periods: float = 38.0
    noise: float = 5e-4
    angle: float = 0.3
    random_force: float = 0.0
    methods: tuple[Method, Method] = (Averaging(), Direct())
    library: str = "contact_forces"


FIVE = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.4, "epsilon": 0.3}
KINDS = {
    "the paper's forces": Kind(FIVE),
    "dry friction": Kind({"lambda": 1e-3, "zeta": 2e-3, "delta": 0.01, "nu": -0.1, "epsilon": 0.1}),
    "viscous, hardening": Kind({"zeta": 4e-3, "epsilon": 0.3}, 48.0, 3e-4),
    "drag": Kind({"zeta": 1e-3, "delta": 0.03}, 60.0, 1e-3),
    "pendulum": Kind({"zeta": 2e-3, "gravity": 1.0}, 48.0, 1e-3, 1.0, library="candidate_effects"),
    "random force": Kind({"zeta": 5e-3, "delta": 0.03}, 40.0, random_force=2e-3),
    "two fits of the motion": Kind(FIVE, methods=(Trajectory(), Direct())),
}


def record_of(kind: Kind, seed: int) -> tuple[xr.Dataset, st.ForceLibrary]:
    """A simulated record, and the library of its forces."""
    library = st.load_library(kind.library)
    if kind.library != "contact_forces":
        offered = (*st.load_library("contact_forces"), *library)
        library = st.ForceLibrary(kind.library, offered)
    library = library.select(kind.coefficients)
    time = np.arange(round(kind.periods * PER_PERIOD)) * 2.0 * np.pi / FREQUENCY / PER_PERIOD
    model = st.Model(library, kind.coefficients, FREQUENCY)
    motion = st.simulate(model, time, kind.angle, random_force=kind.random_force, seed=seed)
    noise = kind.noise * np.random.default_rng([seed, 7]).standard_normal(len(time))
    return xr.Dataset({"angle": ("time", motion.angle.values + noise)}, {"time": time}), library


def of_kind(name: str, kind: Kind, seeds: int) -> dict[str, object]:
    """A row of the table."""
    differences, errors, p_values, by = [], [], [], []
    for seed in range(seeds):
        record, library = record_of(kind, seed)
        compared = comparison(decided(record, library, kind.methods))
        differences.append(compared.difference.values)
        errors.append(compared.standard_error.values)
        p_values.append(compared.p_value.item())
        by.append(compared.attrs["errors"] == "influence")
    scatter = np.std(differences, axis=0, ddof=1) / np.mean(errors, axis=0)
    p = np.array(p_values)
    return {
        "kind": name,
        "seeds": seeds,
        "below 1 %": f"{100 * np.mean(p < HOMOGENEITY_LEVEL):.1f} %",
        "below 10 %": f"{100 * np.mean(p < 0.1):.0f} %",
        "below 50 %": f"{100 * np.mean(p < 0.5):.0f} %",
        "by influence": f"{100 * np.mean(by):.0f} %",
        "scatter over error": " ".join(f"{ratio:.2f}" for ratio in scatter),
    }


def differences(asked: Namespace) -> None:
    """Print the table, a row as it is known."""
    rows = []
    for name, kind in KINDS.items():
        if asked.only in name:
            rows.append(of_kind(name, kind, asked.seeds))
            print(rows[-1], flush=True)
    print(pd.DataFrame(rows).to_string(index=False))
