"""How often intervals and bands of 95 % hold the truth.

profile: profile intervals beside 1.96 standard errors of the same fit: presliding length, Stribeck speed, and
dry friction near zero that is bounded at zero, with a stop at the end.
posterior: importance sampling beside random-walk Metropolis on the same likelihood, of records of the cases
of profile; the seeds are the steps of a chain. In the noise of that study, and in a quarter of it, the
posterior of the Stribeck speed has a plateau to the limit of the library, into which no walk of such a length
finds its way.
curve_bands: simultaneous bands of an identified model, beside pointwise ones: the paper's five forces, 10 s
at 100 Hz, in weak and in strong noise, and dry friction that stops the motion. Bands know the error of the
noise
alone: two cases more show what they miss, a random force that the fit takes for none, and a force that the
model lacks.
"""

import time
from argparse import Namespace
from functools import partial

import numpy as np
import pandas as pd
import xarray as xr
from helpers import FIVE, decay

import sysid_trib as st
from benchmarks.study.common import columns, over_seeds, shown, timed
from sysid_trib.cycles.averaged_motion import averaged_rates, predict_envelope
from sysid_trib.forces import ForceLibrary
from sysid_trib.motion_fit.least_squares import Fit
from sysid_trib.questions.profiles import free_likelihood

W, RATE = 9.9, 50.0
CONTACT, CANDIDATES = st.load_library(), st.load_library("candidate_effects")
# Of each case: coefficients, shapes, release (rad), duration (s), noise (rad), constraints.
PARAMETERS = {
    "dahl.s": ({"zeta": 0.005, "dahl": 6e-4}, {"dahl.s": 0.03}, 0.3, 12.0, 3e-3, {}),
    "stribeck.s": ({"zeta": 0.005, "stribeck": 3e-3}, {"stribeck.s": 0.05}, 0.3, 12.0, 2e-3, {}),
    "lambda": ({"zeta": 0.02, "lambda": 5e-5}, {}, 0.1, 40.0, 6e-3, {"lambda": (0.0, None)}),
}


def fitted_record(name: str, seed: int, quieter: float = 1.0) -> tuple[xr.Dataset, xr.Dataset]:
    """A record of a case, its noise over a number, and its fit."""
    coefficients, shapes, release, duration, noise, constraints = PARAMETERS[name]
    forces = (*CONTACT, *CANDIDATES.select([s for s in coefficients if s in CANDIDATES.symbols]))
    library = ForceLibrary("of the case", forces).select(list(coefficients))
    model, clock = st.Model(library, coefficients, W, shapes), np.arange(0.0, duration, 1.0 / RATE)
    angle = st.simulate(model, clock, release).angle.values
    record = decay(clock, angle, [seed, 11], noise / quieter)
    method = st.methods.Trajectory(fit_shapes=tuple(shapes), random_force="off", constraints=constraints)
    return record, st.identify(record, library, method)


def interval(name: str, seed: int) -> dict:
    """Truth, the fit's value and standard error, both ends by the profile, processor time (s)."""
    coefficients, shapes, *_ = PARAMETERS[name]
    begin = time.process_time()
    record, fit = fitted_record(name, seed)
    row = st.validation.profile(record, fit, [name]).isel(parameter=0)
    stated = fit.sel(shape_parameter=name) if shapes else fit.sel(force=name)
    words = ("shape", "shape_standard_error") if shapes else ("coefficient", "standard_error")
    numbers = [stated[word].item() for word in words] + [row.low.item(), row.high.item()]
    return {"numbers": [(coefficients | shapes)[name], *numbers, time.process_time() - begin]}


def profile(asked: Namespace) -> None:
    rows = []
    for name in (name for name in PARAMETERS if asked.only in name):
        every = over_seeds(asked, partial(interval, name), case=name)
        (numbers,) = columns((row for row in every if "failed" not in row), "numbers")
        truth, value, error, low, high, spent = numbers.T
        below, above = (100.0 * np.mean(side) for side in (high < truth, low > truth))
        by_error = 100.0 * np.mean(np.abs(value - truth) <= 1.96 * error)
        shares = (f"{share:.1f}" for share in (100.0 - below - above, below, above, by_error))
        rows.append([name, str(len(every)), str(len(every) - len(truth)), *shares, f"{np.mean(spent):.2f}"])
    heads = ("case", "seeds", "failed", "profile (%)", "below", "above", "1.96 errors (%)", "s of one")
    shown("intervals of 95 % that hold", heads, rows)


# Seeds, and by how much the noise is smaller than there.
SAMPLED = {"dahl.s": (0, 1.0), "stribeck.s": (4, 8.0), "lambda": (1, 1.0)}


def walk(likelihood: Fit, start: np.ndarray, covariance: np.ndarray, steps: int, seed: int) -> np.ndarray:
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


def draws_of(draws: xr.Dataset) -> dict[str, np.ndarray]:
    """Draws of each coefficient, shape and the frequency."""
    found = {symbol: draws.coefficient.sel(force=symbol) for symbol in draws.force.values.tolist()}
    for name in draws.shape_parameter.values.tolist() if "shape" in draws else ():
        found[name] = draws["shape"].sel(shape_parameter=name)
    return {name: d.values.ravel() for name, d in (found | {"w": draws.reference_frequency}).items()}


def posterior(asked: Namespace) -> None:
    for name, (seed, quieter) in SAMPLED.items():
        if asked.only not in name:
            continue
        record, fit = fitted_record(name, seed, quieter)
        sample = partial(st.validation.posterior, record, fit, draws=1000)
        tree, spent = timed(sample, time.process_time)
        draws, likelihood = tree["posterior"].to_dataset(), free_likelihood(record, fit)
        symbols, free = draws_of(draws), likelihood.parameters.free
        runs = [draws[each].values.reshape(-1) for each in ("start_angle", "start_rate", "offset")]
        every = np.array([*symbols.values(), *runs])
        pairs = ((every[:, seed], seed) for seed in (1, 2))
        chains = np.array([walk(likelihood, at, np.cov(every), asked.seeds, seed) for at, seed in pairs])
        size, k, rows = draws.attrs["effective_sample_size"], draws.attrs["pareto_k"], []
        for at, (parameter, values) in enumerate(symbols.items()):
            assert likelihood.parameters.names[free[at]] in (parameter, "reference frequency")
            other = chains[..., at]
            off, wide = (values.mean() - other.mean()) / other.std(), values.std() / other.std()
            chain = f"{effective(other):.0f}", f"{r_hat(other):.3f}"
            rows.append((parameter, f"{off:+.3f}", f"{wide:.3f}", *chain))
        title = f"{name}: effective {size:.0f} of 4000, Pareto k {k:.2f}, {spent:.1f} s; Metropolis:"
        shown(title, ("parameter", "mean off (errors)", "error x", "effective", "R-hat"), rows)


PAPER_W, RELEASE, CLOCK = 9.91, 0.3, np.arange(0.0, 10.0, 0.01)
# Of each case: coefficients, noise (rad), forces that the fit lacks, density of a random force.
CURVES = {
    "five forces, weak noise": (FIVE, 1e-4, (), 0.0),
    "five forces, strong noise": (FIVE, 3e-3, (), 0.0),
    "dry friction, stop": ({"lambda": 8e-3, "zeta": 0.005}, 1e-3, (), 0.0),
    "random force, taken for none": (FIVE, 1e-4, (), 1e-6),
    "quadratic damping lacks": (FIVE, 1e-4, ("delta",), 0.0),
}


def true_curves(model: st.Model, bands: xr.Dataset) -> dict[str, np.ndarray]:
    """The true curves, but the motion, where the bands are."""
    change, frequency = averaged_rates(model)(bands.amplitude.values)
    return {
        "envelope": predict_envelope(model, bands.envelope_time.values, RELEASE).amplitude.values,
        "frequency": frequency,
        "damping_ratio": -change / (bands.amplitude.values * frequency),
    }


def covers(case: str, seed: int) -> dict[str, tuple[bool, float]]:
    """Of each curve whether it is wholly inside, and the part within 1.96 errors (of pointwise bands)."""
    coefficients, noise, lacking, density = CURVES[case]
    model = st.Model(CONTACT.select(list(coefficients)), coefficients, PAPER_W)
    motion = st.simulate(model, CLOCK, RELEASE, random_force=density, seed=seed).angle.values
    record = decay(CLOCK, motion, [seed, 5], noise)
    offered = model.library.select([symbol for symbol in coefficients if symbol not in lacking])
    fit = st.identify(record, offered, st.methods.Trajectory(random_force="off"))
    bands, held = st.validation.curve_bands(record, fit), {}
    for name, true in ({"angle": motion} | true_curves(model, bands)).items():
        apart = np.abs(bands[name].values - true)
        whole = np.all(apart <= bands[f"{name}_high"].values - bands[name].values + 1e-12)
        held[name] = bool(whole), float(np.mean(apart <= 1.96 * bands[f"{name}_standard_error"].values))
    return held


def curve_bands(asked: Namespace) -> None:
    rows = []
    for case in (case for case in CURVES if asked.only in case):
        every = over_seeds(asked, partial(covers, case), case=case)
        found = pd.DataFrame([row for row in every if "failed" not in row])
        for name, pairs in found.drop(columns=["case", "seed"]).items():
            whole, part = 100.0 * np.mean([*pairs], axis=0)
            rows.append([case, str(len(found)), str(name), f"{whole:.1f}", f"{part:.1f}"])
    heads = ("case", "records", "curve", "wholly inside (%)", "parts within pointwise bands (%)")
    shown("simultaneous bands of 95 %", heads, rows)
