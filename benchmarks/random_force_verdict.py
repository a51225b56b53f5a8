"""Is "explained with a random force" said where it is true, and not where a force was left out?

python benchmarks/random_force_verdict.py [SEEDS] [FIRST SEED]

First motions that are pushed by a white force alone: p-values of `random_force_dependence` are uniform. Then
motions without a random force in which one effect of the library acts that the model has not: its coefficient
is 60 to 200 standard errors of a fit that offers it (Cramér-Rao bound).
"""

import sys
import time as clock

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import SysidTribError
from sysid_trib.noise.random_force import RandomForce, random_force_of

W, NOISE, PERIODS, PER_PERIOD, ANGLE = 8.87, 2e-4, 20, 60, 0.3
TRUTH = {"lambda": 2e-4, "zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
OFFERED = st.load_library("contact_forces").select(TRUTH)
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
LEVEL = 0.01


def decay_of(model: st.Model, seed: int, density: float = 0.0) -> xr.Dataset:
    """A simulated record with the sensor's noise."""
    angle = st.simulate(model, TIME, ANGLE, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))})


def p_value(decay: xr.Dataset, method: object) -> float:
    """Of a random force that depends on nothing; nan where no random force was found."""
    result = st.identify(decay, OFFERED, method)
    return st.random_force_dependence(decay, result).p_value.item() if random_force_of(result) else np.nan


def pushed(method: object, wander: float, seeds: range) -> str:
    """One line: how often a random force is called dependent."""
    # The wander at the end, RMS, is so many noise levels.
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * TIME[-1]), W)
    model = st.Model(OFFERED, TRUTH, W)
    values = [p_value(decay_of(model, seed, density), method) for seed in seeds]
    known = np.array([value for value in values if np.isfinite(value)])
    rates = ", ".join(f"{100.0 * np.mean(known < level):.1f} %" for level in (0.01, 0.1, 0.5))
    return f"pushed, wander {wander:2}: p below 1, 10, 50 %: {rates} of {len(known)} records"


def left_out(method: object, seeds: range) -> str:
    """One line: how often a force that is left out is found dependent, and which are not."""
    effects = [f for f in st.load_library("candidate_effects") if f.kind == "force"]
    missed, told, none, failed = [], 0, 0, 0
    for seed in seeds:
        force = effects[seed % len(effects)]
        model = with_effect(force, np.random.default_rng(seed))
        if model is None:
            continue
        try:
            value = p_value(decay_of(model, seed), method)
        except SysidTribError as error:
            failed += 1
            print(f"  {force.symbol}: {error}", flush=True)
            continue
        none += int(np.isnan(value))
        told += int(value < LEVEL)
        if value >= LEVEL:
            missed.append(f"{force.symbol} {value:.2g}")
    return (
        f"left out: {told} of {told + len(missed)} not explained; missed: {', '.join(missed) or 'none'}; "
        f"no random force found {none}, failed {failed}"
    )


def with_effect(force: st.Force, random: np.random.Generator) -> st.Model | None:
    """The model with an effect of 60 to 200 standard errors; None where no such motion exists."""
    library = st.ForceLibrary("with one that is left out", (*OFFERED, force))
    shapes = library.shape_values()
    coefficient = 1e-4
    try:
        # The error hardly depends on the coefficient, but where the force makes switchings.
        for _ in range(3):
            model = st.Model(library, TRUTH | {force.symbol: coefficient}, W, shapes)
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
    for wander in (1, 5, 20):
        print(
            pushed(st.methods.Trajectory(random_force="auto"), wander, range(first, first + count)),
            flush=True,
        )
    print(left_out(st.methods.Trajectory(random_force="auto"), range(first, first + count)), flush=True)
    print(f"{clock.process_time() - start:.0f} s")
