"""Posteriors by importance sampling beside random-walk Metropolis on the same likelihood, of three records.

The seeds are the steps of a chain. The records are cases of `profile.py`: presliding length, Stribeck speed,
dry friction bounded at zero. In the noise of that study, and in a quarter of it, the posterior of the
Stribeck speed has a plateau to the limit of the library, into which no walk of such a length finds its way.
"""

from argparse import Namespace
from time import process_time

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks.stopwatch import timed
from benchmarks.study.common import shown
from benchmarks.study.profile import fitted_record
from sysid_trib.motion_fit.least_squares import FreeLikelihood
from sysid_trib.validation.profiles import free_likelihood

# Seeds, and by how much the noise is smaller than there.
RECORDS = {"dahl.s": (0, 1.0), "stribeck.s": (4, 8.0), "lambda": (1, 1.0)}


def walk(
    likelihood: FreeLikelihood, start: np.ndarray, covariance: np.ndarray, steps: int, seed: int
) -> np.ndarray:
    """Free parameters by random-walk Metropolis, (step, free), a tenth of the steps left out as burn-in.

    Gelman, Roberts and Gilks (1996) for the length of the steps.
    """
    parameters, rng = likelihood.parameters, np.random.default_rng(seed)
    low, high = (limit[parameters.free] for limit in parameters.limits)
    size = np.sqrt(np.diag(covariance))
    root = size[:, None] * np.linalg.cholesky(covariance / np.outer(size, size)) * 2.38 / np.sqrt(len(size))
    here, deviance, chain = start, likelihood.deviance(parameters.expand(start)), []
    for _ in range(steps):
        there = here + root @ rng.standard_normal(len(size))
        if np.all((there >= low) & (there <= high)):
            other = likelihood.deviance(parameters.expand(there))
            if np.log(rng.uniform()) < 0.5 * (deviance - other):
                here, deviance = there, other
        chain.append(here)
    return np.array(chain[steps // 10 :])


def effective(chains: np.ndarray) -> float:
    """Effective sample size of chains, (chain, step), by the means of 40 batches of each."""
    means = [batch.mean() for chain in chains for batch in np.array_split(chain, 40)]
    return float(chains.size * chains.var() / (chains.shape[1] / 40 * np.var(means, ddof=1)))


def r_hat(chains: np.ndarray) -> float:
    """Gelman and Rubin's ratio of halves of chains, (chain, step): 1 where they have converged."""
    halves = chains.reshape(2 * len(chains), -1)
    within = halves.var(axis=1, ddof=1).mean()
    return float(np.sqrt(1.0 + halves.mean(axis=1).var(ddof=1) / within))


def columns(draws: xr.Dataset) -> dict[str, np.ndarray]:
    """Draws of each coefficient, shape and the frequency."""
    found = {symbol: draws.coefficient.sel(force=symbol) for symbol in draws.force.values.tolist()}
    for name in draws.shape_parameter.values.tolist() if "shape" in draws else ():
        found[name] = draws["shape"].sel(shape_parameter=name)
    return {name: d.values.ravel() for name, d in (found | {"w": draws.reference_frequency}).items()}


def main(asked: Namespace) -> None:
    for name, (seed, quieter) in RECORDS.items():
        if asked.only not in name:
            continue
        decay, fit = fitted_record(name, seed, quieter)
        tree, spent = timed(lambda d=decay, f=fit: st.validation.posterior(d, f, draws=1000), process_time)
        draws, likelihood = tree["posterior"].to_dataset(), free_likelihood(decay, fit)
        symbols, free = columns(draws), likelihood.parameters.free
        runs = [draws[each].values.reshape(-1) for each in ("start_angle", "start_rate", "offset")]
        every = np.array([*symbols.values(), *runs])
        pairs = ((every[:, seed], seed) for seed in (1, 2))
        chains = np.array([walk(likelihood, at, np.cov(every), asked.seeds, seed) for at, seed in pairs])
        size, k, rows = draws.attrs["effective_sample_size"], draws.attrs["pareto_k"], []
        for at, (parameter, values) in enumerate(symbols.items()):
            assert likelihood.parameters.names[free[at]] in (parameter, "reference frequency")
            other = chains[..., at]
            off, wide = (values.mean() - other.mean()) / other.std(), values.std() / other.std()
            rows.append(
                (parameter, f"{off:+.3f}", f"{wide:.3f}", f"{effective(other):.0f}", f"{r_hat(other):.3f}")
            )
        title = f"{name}: effective {size:.0f} of 4000, Pareto k {k:.2f}, {spent:.1f} s; Metropolis:"
        shown(title, ("parameter", "mean off (errors)", "error x", "effective", "R-hat"), rows)
