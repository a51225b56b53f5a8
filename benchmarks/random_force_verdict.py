"""Is "explained with a random force" said where it is true, and not where a force was left out?

python benchmarks/random_force_verdict.py [SEEDS] [FIRST SEED] [NOISE] [--method METHOD] [--left-out]

NOISE of the sensor: white, or AR(0.8); --left-out: the last part alone. First motions with nothing beside it:
they are explained. Then motions that are pushed by a white force alone: p-values of `random_force_dependence`
are uniform. Then motions without a random force in which one effect of the library acts that the model has
not: its coefficient is 60 to 200 standard errors of a fit that offers it (Cramér-Rao bound in white noise as
strong as that of the sensor at the frequency of the swing).
"""

import argparse
import sys
import time as clock
from collections import Counter
from pathlib import Path

import numpy as np
import xarray as xr

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from helpers import correlated_noise  # noqa: E402

import sysid_trib as st  # noqa: E402
from sysid_trib.errors import SysidTribError  # noqa: E402
from sysid_trib.likelihood.random_force import RandomForce, random_force_of  # noqa: E402
from sysid_trib.methods.scope import Method  # noqa: E402

W, NOISE, PERIODS, PER_PERIOD, ANGLE = 8.87, 2e-4, 20, 60, 0.3
TRUTH = {"zeta": 5e-3, "delta": 2e-3, "epsilon": -0.1}
OFFERED = st.load_library("contact_forces").select(TRUTH)
ZERO = st.load_library("candidate_effects")["bias"]
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
METHODS = {
    "trajectory": st.methods.Trajectory(random_force="estimated"),
    "direct": st.methods.Direct(random_force="estimated"),
}
# Autocorrelation of the sensor's noise from sample to sample.
NOISES = {"white": 0.0, "AR(0.8)": 0.8}


def decay_of(model: st.Model, noise: str, seed: int, density: float = 0.0) -> xr.Dataset:
    """A simulated record with the sensor's noise."""
    angle = st.simulate(model, TIME, ANGLE, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + correlated_noise(len(TIME), seed, NOISES[noise], NOISE)})


def noise_at_swing(noise: str) -> float:
    """Standard deviation of white noise that is as strong as the sensor's at the swing's frequency, rad."""
    correlation = NOISES[noise]
    turn = np.exp(-2j * np.pi / PER_PERIOD)
    return float(NOISE * np.sqrt(1.0 - correlation**2) / np.abs(1.0 - correlation * turn))


def verdict_of(decay: xr.Dataset, method: Method) -> tuple[str, float]:
    """What is said of a record, and the p-value of a random force that depends on nothing (nan: none)."""
    result = st.identify(decay, OFFERED, method)
    tree = st.cross_check(decay, result, result, draws=1)
    p = tree["random_force"].p_value.item() if "random_force" in tree.children else np.nan
    return tree["comparison"].attrs["verdict_on_record"], p


def undisturbed(method: Method, noise: str, seeds: range) -> str:
    """One line: the verdicts where there is the sensor's noise and nothing else."""
    model = st.Model(OFFERED, TRUTH, W)
    verdicts = Counter(verdict_of(decay_of(model, noise, seed), method)[0] for seed in seeds)
    return f"noise alone: {', '.join(f'{name} {count}' for name, count in verdicts.items())}"


def p_value(decay: xr.Dataset, method: Method) -> float:
    """Of a random force that depends on nothing; nan where no random force was found."""
    result = st.identify(decay, OFFERED, method)
    return (
        st.validation.random_force_dependence(decay, result).p_value.item()
        if random_force_of(result)
        else np.nan
    )


def pushed(method: Method, noise: str, wander: float, seeds: range) -> str:
    """One line: how often a random force is called dependent."""
    # The wander at the end, RMS, is so many noise levels.
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * TIME[-1]), W)
    model = st.Model(OFFERED, TRUTH, W)
    values, failed = [], 0
    for seed in seeds:
        try:
            values.append(p_value(decay_of(model, noise, seed, density), method))
        except SysidTribError:
            failed += 1
    known = np.array([value for value in values if np.isfinite(value)])
    rates = ", ".join(f"{100.0 * np.mean(known < level):.1f} %" for level in (0.01, 0.1, 0.5))
    return (
        f"pushed, wander {wander:2}: p below 1, 10, 50 %: {rates} of {len(known)} records; "
        f"no random force found {len(values) - len(known)}, failed {failed}"
    )


def left_out(method: Method, noise: str, seeds: range) -> str:
    """One line: the verdicts where a force is left out, and where they are wrong."""
    effects = [f for f in st.load_library("candidate_effects") if f.kind == "force"]
    missed, verdicts, failed = [], Counter[str](), []
    for seed in seeds:
        force = effects[seed % len(effects)]
        model = with_effect(force, np.random.default_rng(seed), noise_at_swing(noise))
        if model is None:
            continue
        try:
            verdict, p = verdict_of(decay_of(model, noise, seed), method)
        except SysidTribError:
            failed.append(force.symbol)
            continue
        verdicts[verdict] += 1
        if verdict != "not explained":
            missed.append(f"{force.symbol} ({verdict}, p {p:.2g})")
    counts = ", ".join(f"{name} {count}" for name, count in verdicts.items())
    return (
        f"left out: {counts}; wrong: {', '.join(missed) or 'none'}; no identification: "
        f"{', '.join(failed) or 'none'}"
    )


def with_effect(force: st.forces.Force, random: np.random.Generator, noise: float) -> st.Model | None:
    """The model with an effect of 60 to 200 standard errors; None where no such motion exists."""
    if force.symbol == ZERO.symbol:
        return None
    library = st.forces.ForceLibrary("with one that is left out", (*OFFERED, force))
    # The bound takes the sensor's zero as known; a constant force is the same as one that is fitted.
    whole = st.forces.ForceLibrary("with a free zero", (*library, ZERO))
    shapes = library.shape_values()
    coefficient = 1e-4
    try:
        # The error hardly depends on the coefficient, but where the force makes switchings.
        for _ in range(3):
            model = st.Model(whole, TRUTH | {force.symbol: coefficient, ZERO.symbol: 0.0}, W, shapes)
            bound = st.validation.cramer_rao_bound(model, TIME, ANGLE, 0.0, noise, free=True)
            coefficient = 60.0 * bound.standard_error.sel(force=force.symbol).item()
    except SysidTribError:
        return None
    if not np.isfinite(coefficient) or coefficient > 1.0:
        return None
    factor = float(np.exp(random.uniform(0.0, np.log(200.0 / 60.0))))
    return st.Model(library, TRUTH | {force.symbol: factor * coefficient}, W, shapes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="?", default=20)
    parser.add_argument("first", type=int, nargs="?", default=0)
    parser.add_argument("noise", choices=NOISES, nargs="?", default="white")
    parser.add_argument("--method", choices=METHODS, help="one of the two")
    parser.add_argument("--left-out", action="store_true")
    asked = parser.parse_args()
    seeds, start = range(asked.first, asked.first + asked.seeds), clock.process_time()
    for name in [asked.method] if asked.method else METHODS:
        method = METHODS[name]
        print(f"{name}, {asked.noise} noise")
        if not asked.left_out:
            print(undisturbed(method, asked.noise, seeds), flush=True)
            for wander in (1, 5, 20):
                print(pushed(method, asked.noise, wander, seeds), flush=True)
        print(left_out(method, asked.noise, seeds), flush=True)
    print(f"{clock.process_time() - start:.0f} s")


if __name__ == "__main__":
    main()
