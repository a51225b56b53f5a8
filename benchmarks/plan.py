"""Does what a plan states come true, and how many runs does it save? Discover, plan, run, discover again.

python -m benchmarks plan [--drawn] [--first 1000] [--seeds 60] [--out FILE]     with FILE resumable
python -m benchmarks loops [--first 3000] [--seeds 15] [--out FILE]

Of each plan two runs are made: the one that is planned, and another row of its table. With --drawn the hidden
effect is drawn from all candidates, as probabilities suppose. Loops go on until the right name stands alone.
"""

import itertools
from argparse import Namespace
from collections.abc import Callable

import numpy as np
import xarray as xr
from helpers import measured
from scipy.stats import beta

import sysid_trib as st
from benchmarks.study.common import added, read
from sysid_trib.errors import SysidTribError
from sysid_trib.questions.rivals import ODDS

LIMITS, DURATION, RATE, NOISE, MOST_RUNS = (0.1, 0.8), 12.0, 50.0, 2e-3, 5
# Release of the first run (rad), frequency (rad/s); strengths that are drawn, over what that run detects.
FIRST, FREQUENCY, STRENGTHS = 0.25, 9.9, (1.0, 6.0)
# Between which probabilities stated ones are counted together.
BINS = (0.0, 0.5, 0.8, 0.95, 1.0)
# What is hidden beside viscous friction: symbol, coefficient.
HIDDEN = {"epsilon": -0.167, "delta": 0.03, "nu": -0.1, "lambda": 6e-4}


def decay_of(model: st.Model, amplitude: float, duration: float, seed: int) -> xr.Dataset:
    """A run of a model with noise."""
    time = np.arange(0.0, duration, 1.0 / RATE)
    return st.free_decay(measured(model, time, amplitude, noise=NOISE, seed=seed))


def named(tree: xr.DataTree) -> list[str]:
    """Names of the last credible set, or none."""
    steps = tree["steps"].to_dataset()
    if not tree["steps"].attrs["count"]:
        return []
    last = steps.isel(step=-1)
    return last.candidate.values[last.credible.values].tolist()


def odds_came(tree: xr.DataTree, symbol: str, models: list[str]) -> bool:
    """Return whether the right name has the planned odds against each other model."""
    if not tree["steps"].attrs["count"]:
        return False
    step = tree["steps"].to_dataset().isel(step=-1)
    likely = dict(zip(step.candidate.values.tolist(), step.tie_probability.values.tolist(), strict=True))
    right = np.nan_to_num(likely.get(symbol, 0.0))
    others = [np.nan_to_num(likely.get(other, 0.0)) for other in models if other != symbol]
    return bool(right > ODDS * max(others))


def hidden_in(seed: int, drawn: bool) -> tuple[str, st.Model]:
    """The effect that a loop hides: of four in turn, or any that a first run shows, of either sign."""
    library, rng = st.load_library(), np.random.default_rng([seed, 11])
    symbol = list(HIDDEN)[seed % len(HIDDEN)]
    if not drawn:
        model = {"zeta": 0.01, symbol: HIDDEN[symbol]}
        return symbol, st.Model(library.select(["zeta", symbol]), model, FREQUENCY)
    bare = st.Model(library.select(["zeta"]), {"zeta": 0.01}, FREQUENCY)
    shown = st.discover(decay_of(bare, FIRST, DURATION, 0))["detectability"].to_dataset()
    offered = [*library, *st.load_library("candidate_effects")]
    while True:
        force = offered[rng.integers(len(offered))]
        shapes = {f"{force.symbol}.{n}": float(s.at(rng.uniform())) for n, s in force.shape.items()}
        if force.symbol == "zeta" or not shown.testable.sel(candidate=force.symbol):
            continue
        size = shown.detectable.sel(candidate=force.symbol).item() * np.exp(rng.uniform(*np.log(STRENGTHS)))
        sign = 1.0 if force.passive else rng.choice([-1.0, 1.0])
        coefficient = sign * size if force.coefficient is None else force.coefficient
        forces = st.forces.ForceLibrary("hidden", (library["zeta"], force))
        model = st.Model(forces, {"zeta": 0.01, force.symbol: coefficient}, FREQUENCY, shapes)
        try:
            for amplitude in (FIRST, *LIMITS):
                decay_of(model, amplitude, DURATION, 0)
        except SysidTribError:
            continue
        return force.symbol, model


def step(seed: int, drawn: bool) -> tuple[str, list[tuple[float, int, int, bool]]]:
    """Return the hidden effect, and for two runs of a plan the stated and the observed outcome."""
    (symbol, model), rng = hidden_in(seed, drawn), np.random.default_rng([seed, 3])
    first = decay_of(model, FIRST, DURATION, 1000 * seed)
    tree, said = st.discover(first), []
    if len(named(tree)) > 1:
        table = st.validation.plan(tree, amplitude=LIMITS, duration=(DURATION, DURATION))
        models = table.attrs["models"]
        for at in (0, int(rng.integers(1, table.sizes["run"]))) if len(models) > 1 else ():
            row = table.isel(run=at)
            second = decay_of(model, row.amplitude.item(), DURATION, 1000 * seed + 1 + at)
            again = st.discover([first, second])
            came = int(odds_came(again, symbol, models)) if symbol in models else -1
            said.append((row.probability.item(), came, int(named(again) == [symbol]), at == 0))
    return symbol, said


def table_of(said: list[tuple[float, int, int]]) -> None:
    """Print stated probabilities and how often they came true."""
    stated, came, right = np.array(said, dtype=float).reshape(-1, 3).T
    print(
        f"{len(came)} runs, {np.count_nonzero(came < 0)} without the truth among their models; of the others"
    )
    print("stated probability    runs  stated  came true (95 %)      named alone")
    for low, high in [*itertools.pairwise(BINS), (0.0, 1.0)]:
        there = (came >= 0) & (stated >= low) & ((stated < high) | (high == 1.0))
        if count := np.count_nonzero(there):
            true = came[there].sum()
            ends = beta.ppf([0.025, 0.975], true + 0.5, count - true + 0.5)
            interval = f"{true / count:.2f} ({ends[0]:.2f} to {ends[1]:.2f})"
            words = f"{low:.2f} to {high:.2f}          {count:5}  {stated[there].mean():.2f}"
            print(f"{words}    {interval:20}  {right[there].mean():.2f}")


def over_loops(asked: Namespace, one: Callable[[int], list]) -> list[list]:
    """A row of each seed: those of the file, then those that are added to it."""
    rows = read(asked.out)
    for seed in range(asked.first + len(rows), asked.first + asked.seeds):
        rows.append(one(seed))
        print(f"{seed}: {rows[-1]}", flush=True)
        added(asked.out, rows[-1])
    return rows


def plan(asked: Namespace) -> None:
    rows = over_loops(asked, lambda seed: list(step(seed, bool(asked.drawn))))
    for best, words in ((True, "the run that is planned"), (False, "another row of the table")):
        print(f"{words}:")
        table_of([tuple(run[:3]) for _, said in rows for run in said if run[3] == best])


def runs_needed(seed: int, planned: bool) -> int:
    """Runs until the set is the right name alone, with releases that are planned or drawn."""
    (symbol, model), rng = hidden_in(seed, False), np.random.default_rng([seed, 7])
    runs = [decay_of(model, FIRST, DURATION, 1000 * seed)]
    for count in range(1, MOST_RUNS + 1):
        tree = st.discover(runs)
        if named(tree) == [symbol]:
            return count
        amplitude = float(np.exp(rng.uniform(*np.log(LIMITS))))
        if planned and len(named(tree)) > 1:
            table = st.validation.plan(tree, amplitude=LIMITS, duration=(DURATION, DURATION))
            amplitude = table.amplitude[0].item()
        runs.append(decay_of(model, amplitude, DURATION, 1000 * seed + count))
    return MOST_RUNS + 1


def loops(asked: Namespace) -> None:
    rows = over_loops(asked, lambda seed: [runs_needed(seed, planned) for planned in (True, False)])
    for words, counts in zip(("planned", "at random"), zip(*rows, strict=True), strict=True):
        print(f"{words}: median {np.median(counts):g} runs, mean {np.mean(counts):.2f}, {len(counts)} loops")
