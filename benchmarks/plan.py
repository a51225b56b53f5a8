"""Loops of discover, plan, run, discover again: runs until one right name, and if what is stated holds.

usage: python benchmarks/plan.py [--loops 20]
"""

import argparse

import numpy as np
import xarray as xr
from scipy.stats import beta

import sysid_trib as st

LIMITS, DURATION, RATE, NOISE, MOST_RUNS = (0.1, 0.8), 12.0, 50.0, 2e-3, 5
# What is hidden beside viscous friction: symbol, coefficient.
HIDDEN = {"epsilon": -0.167, "delta": 0.03, "nu": -0.1, "lambda": 6e-4}


def decay_of(model: st.Model, amplitude: float, duration: float, seed: int) -> xr.Dataset:
    """A run of a model with noise."""
    time = np.arange(0.0, duration, 1.0 / RATE)
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return st.free_decay(np.column_stack([time, st.simulate(model, time, amplitude).angle.values + noise]))


def named(tree: xr.DataTree) -> list[str]:
    """Names of the last credible set, or none."""
    steps = tree["steps"].to_dataset()
    if not tree["steps"].attrs["count"]:
        return []
    last = steps.isel(step=-1)
    return last.candidate.values[last.credible.values].tolist()


def loop(symbol: str, seed: int, planned: bool) -> tuple[int, list[tuple[float, bool]]]:
    """Runs until the set is the right name alone, and what was stated of each and came true."""
    library = st.load_library().select(["zeta", symbol])
    model = st.Model(library, {"zeta": 0.01, symbol: HIDDEN[symbol]}, 9.9)
    rng = np.random.default_rng([seed, 7])
    runs, said = [decay_of(model, 0.25, DURATION, 1000 * seed)], []
    tree = st.discover(runs)
    for count in range(1, MOST_RUNS + 1):
        if named(tree) == [symbol] or count == MOST_RUNS:
            break
        amplitude = float(np.exp(rng.uniform(*np.log(LIMITS))))
        if planned and len(named(tree)) > 1:
            best = st.validation.plan(tree, amplitude=LIMITS, duration=(DURATION, DURATION)).isel(run=0)
            amplitude, probability = best.amplitude.item(), best.probability.item()
        runs.append(decay_of(model, amplitude, DURATION, 1000 * seed + count))
        tree = st.discover(runs)
        if planned and len(runs) > 1 and "probability" in locals():
            said.append((probability, named(tree) == [symbol]))
    return (len(runs) if named(tree) == [symbol] else MOST_RUNS + 1), said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=20)
    loops, said, counts = parser.parse_args().loops, [], {True: [], False: []}
    for seed in range(loops):
        symbol = list(HIDDEN)[seed % len(HIDDEN)]
        for planned in (True, False):
            runs, stated = loop(symbol, seed, planned)
            counts[planned].append(runs)
            said += stated
        print(f"{seed}: {symbol}: {counts[True][-1]} runs planned, {counts[False][-1]} at random", flush=True)
    for planned, words in ((True, "planned"), (False, "at random")):
        print(f"{words}: median {np.median(counts[planned]):g}, mean {np.mean(counts[planned]):.2f} runs")
    if said:
        stated, came = np.array(said).T
        low, high = beta.ppf([0.025, 0.975], came.sum() + 0.5, len(came) - came.sum() + 0.5)
        true = f"{came.mean():.2f} ({low:.2f} to {high:.2f}) of {len(came)}"
        print(f"stated {stated.mean():.2f}, came true {true}")


if __name__ == "__main__":
    main()
