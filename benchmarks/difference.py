"""Pairs of simulated samples: how often equal ones are said to differ, and unequal ones are found.

usage: python benchmarks/difference.py [--pairs 500]
"""

import argparse

import numpy as np
import xarray as xr
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
    angle = st.simulate(model, TIME, 0.26).angle.values
    noisy = angle + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))
    return st.free_decay(xr.Dataset({"angle": ("time", noisy, {"units": "rad"})}, {"time": TIME}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=500)
    pairs = parser.parse_args().pairs
    library = st.load_library().select(list(SIX))
    model = st.Model(library, SIX, 9.91)
    bound = st.validation.cramer_rao_bound(model, TIME, 0.26, 0.0, NOISE, free=True)
    at, covariance = list(SIX).index("zeta"), bound.covariance.sel(force=list(SIX), other_force=list(SIX))
    alone = np.linalg.inv(covariance.values)[at, at] ** -0.5
    step = SHIFT * np.sqrt(2.0) * alone
    shifted = st.Model(library, SIX | {"zeta": SIX["zeta"] + step}, 9.91)
    power = ncx2.sf(chi2.isf(LEVEL, len(SIX)), len(SIX), SHIFT**2)
    print(f"unequal: zeta by {step:.2e}; found by the bound's chi-square with probability {power:.3f}")
    for kind, (forces, differ) in KINDS.items():
        said = {"coefficients differ": 0, "together they differ": 0, "no difference": 0}
        chosen = library.select(list(forces))
        for seed in range(pairs):
            first, second = decay_of(model, 2 * seed), decay_of(shifted if differ else model, 2 * seed + 1)
            tree = held_against([first], [second], chosen, st.methods.Direct())
            said[tree.attrs["verdict"]] += 1
        counts = ", ".join(f"{name} {100.0 * count / pairs:.1f} %" for name, count in said.items())
        print(f"{kind:28} {counts}", flush=True)


if __name__ == "__main__":
    main()
