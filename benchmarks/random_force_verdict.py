"""Is "explained with a random force" said where it is true, and not where a force was left out?

python benchmarks/random_force_verdict.py [SEEDS] [FIRST SEED]

First motions that are pushed by a white force alone: p-values of `random_force_dependence` are uniform. Then
motions without a random force in which one effect of the library acts that the model has not: its coefficient
is 60 to 200 standard errors of a fit that offers it (Cramér-Rao bound).
"""

import sys
import time as clock
from collections import Counter

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import SysidTribError
from sysid_trib.methods.scope import Method
from sysid_trib.noise.random_force import RandomForce, random_force_of

W, NOISE, PERIODS, PER_PERIOD, ANGLE = 8.87, 2e-4, 20, 60, 0.3
TRUTH = {"zeta": 5e-3, "delta": 2e-3, "epsilon": -0.1}
OFFERED = st.load_library("contact_forces").select(TRUTH)
ZERO = st.load_library("candidate_effects")["bias"]
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD


def decay_of(model: st.Model, seed: int, density: float = 0.0) -> xr.Dataset:
    """A simulated record with the sensor's noise."""
    angle = st.simulate(model, TIME, ANGLE, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))})


def p_value(decay: xr.Dataset, method: Method) -> float:
    """Of a random force that depends on nothing; nan where no random force was found."""
    result = st.identify(decay, OFFERED, method)
    return st.random_force_dependence(decay, result).p_value.item() if random_force_of(result) else np.nan


def pushed(method: Method, wander: float, seeds: range) -> str:
    """One line: how often a random force is called dependent."""
    # The wander at the end, RMS, is so many noise levels.
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * TIME[-1]), W)
    model = st.Model(OFFERED, TRUTH, W)
    values, failed = [], 0
    for seed in seeds:
        try:
            values.append(p_value(decay_of(model, seed, density), method))
        except SysidTribError:
            failed += 1
    known = np.array([value for value in values if np.isfinite(value)])
    rates = ", ".join(f"{100.0 * np.mean(known < level):.1f} %" for level in (0.01, 0.1, 0.5))
    return (
        f"pushed, wander {wander:2}: p below 1, 10, 50 %: {rates} of {len(known)} records; "
        f"no random force found {len(values) - len(known)}, failed {failed}"
    )


def left_out(method: Method, seeds: range) -> str:
    """One line: the verdicts where a force is left out, and where they are wrong."""
    effects = [f for f in st.load_library("candidate_effects") if f.kind == "force"]
    missed, verdicts, failed = [], Counter[str](), []
    for seed in seeds:
        force = effects[seed % len(effects)]
        model = with_effect(force, np.random.default_rng(seed))
        if model is None:
            continue
        decay = decay_of(model, seed)
        try:
            result = st.identify(decay, OFFERED, method)
        except SysidTribError:
            failed.append(force.symbol)
            continue
        tree = st.cross_check(decay, result, result, draws=1)
        verdict = tree["comparison"].attrs["verdict_on_record"]
        verdicts[verdict] += 1
        if verdict != "not explained":
            p = tree["random_force"].p_value.item() if "random_force" in tree.children else np.nan
            missed.append(f"{force.symbol} ({verdict}, p {p:.2g})")
    counts = ", ".join(f"{name} {count}" for name, count in verdicts.items())
    return (
        f"left out: {counts}; wrong: {', '.join(missed) or 'none'}; no identification: "
        f"{', '.join(failed) or 'none'}"
    )


def with_effect(force: st.Force, random: np.random.Generator) -> st.Model | None:
    """The model with an effect of 60 to 200 standard errors; None where no such motion exists."""
    if force.symbol == ZERO.symbol:
        return None
    library = st.ForceLibrary("with one that is left out", (*OFFERED, force))
    # The bound takes the sensor's zero as known; a constant force is the same as one that is fitted.
    whole = st.ForceLibrary("with a free zero", (*library, ZERO))
    shapes = library.shape_values()
    coefficient = 1e-4
    try:
        # The error hardly depends on the coefficient, but where the force makes switchings.
        for _ in range(3):
            model = st.Model(whole, TRUTH | {force.symbol: coefficient, ZERO.symbol: 0.0}, W, shapes)
            bound = st.cramer_rao_bound(model, TIME, ANGLE, 0.0, NOISE, free=True)
            coefficient = 60.0 * bound.standard_error.sel(force=force.symbol).item()
    except SysidTribError:
        return None
    if not np.isfinite(coefficient) or coefficient > 1.0:
        return None
    factor = float(np.exp(random.uniform(0.0, np.log(200.0 / 60.0))))
    return st.Model(library, TRUTH | {force.symbol: factor * coefficient}, W, shapes)


if __name__ == "__main__":
    count, first = (int(given) for given in (*sys.argv[1:3], *("20", "0")[len(sys.argv) - 1 :]))
    start = clock.process_time()
    for method in (st.methods.Trajectory(random_force="auto"), st.methods.Direct(random_force="auto")):
        print(type(method).__name__)
        for wander in (1, 5, 20):
            print(pushed(method, wander, range(first, first + count)), flush=True)
        print(left_out(method, range(first, first + count)), flush=True)
    print(f"{clock.process_time() - start:.0f} s")
