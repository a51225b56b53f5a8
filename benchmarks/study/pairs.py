"""Pairs of simulated samples: how often equal ones are said to differ, and unequal ones are found."""

from argparse import Namespace
from collections import Counter

import numpy as np
import xarray as xr
from helpers import measured
from scipy.stats import chi2, ncx2

import sysid_trib as st
from sysid_trib.validation.samples import held_against

SIX = {"lambda": 2e-4, "zeta": 0.0097, "delta": 0.037, "nu": -0.4, "epsilon": 0.3}
TIME, NOISE, LEVEL = np.arange(0.0, 25.0, 0.01), 2e-4, 0.01
# By so many standard errors of the bound the second sample's zeta differs, all others being equal.
SHIFT = 4.0
# Kinds of pairs: forces that are fitted, and whether the samples differ.
KINDS = {
    "equal, model complete": (tuple(SIX), False),
    "unequal, model complete": (tuple(SIX), True),
    "equal, epsilon left out": (("lambda", "zeta", "delta", "nu"), False),
    "unequal, epsilon left out": (("lambda", "zeta", "delta", "nu"), True),
}


def decay_of(model: st.Model, seed: int) -> xr.Dataset:
    """A record of a model with noise."""
    return st.free_decay(measured(model, TIME, 0.26, noise=NOISE, seed=seed))


def main(asked: Namespace) -> None:
    library = st.load_library().select(list(SIX))
    model = st.Model(library, SIX, 9.91)
    bound = st.validation.cramer_rao_bound(model, TIME, 0.26, 0.0, NOISE, free=True)
    at, covariance = list(SIX).index("zeta"), bound.covariance.sel(force=list(SIX), other_force=list(SIX))
    step = SHIFT * np.sqrt(2.0) * np.linalg.inv(covariance.values)[at, at] ** -0.5
    shifted = st.Model(library, SIX | {"zeta": SIX["zeta"] + step}, 9.91)
    power = ncx2.sf(chi2.isf(LEVEL, len(SIX)), len(SIX), SHIFT**2)
    print(f"unequal: zeta by {step:.2e}; found by the bound's chi-square with probability {power:.3f}")
    for kind, (forces, differ) in KINDS.items():
        if asked.only not in kind:
            continue
        chosen, said = library.select(list(forces)), Counter()
        for seed in range(asked.seeds):
            first, second = decay_of(model, 2 * seed), decay_of(shifted if differ else model, 2 * seed + 1)
            said[held_against([first], [second], chosen, st.methods.Direct()).attrs["verdict"]] += 1
        counts = ", ".join(f"{name} {100.0 * n / asked.seeds:.1f} %" for name, n in said.items())
        print(f"{kind:28} {counts}", flush=True)
