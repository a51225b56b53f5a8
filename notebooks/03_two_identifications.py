# %% [markdown]
# # Two identifications and their lower bound
#
# Averaging uses the amplitude and frequency of half periods; the direct method uses the equation of
# motion. This notebook shows their precision against noise, sampling rate and angle steps. No unbiased
# method can have smaller standard errors than the Cramér-Rao bound. `st.validation.cramer_rao_bound`
# computes it from the motion alone, before any record exists. All records here are simulated: the five
# forces of Le Bot et al. (2019, Sec. 3) and their frequency, from 0.3 rad at rest, 25 s.

# %%
import os

import numpy as np
import pandas as pd
import xarray as xr

import sysid_trib as st

# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # 2 records a point instead of 16, fewer points

# %%
SEEDS = 2 if QUICK else 16
library = st.load_library("contact_forces")
PAPER = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
truth = st.Model(library, PAPER, reference_frequency=9.91)
METHODS = {
    "direct": st.methods.Direct(),
    "averaging": st.methods.Averaging(),
    "averaging, bias left in": st.methods.Averaging(correct=False),
}

# %% [markdown]
# ## One record
#
# Both methods and the bound, at a noise of 0.1 mrad and 100 Hz:


# %%
def record(noise, rate, step, seed):
    """A simulated decay: white noise (rad), sampling rate (Hz), angle step of the sensor (rad, 0: none)."""
    motion = st.simulate(truth, np.arange(round(25 * rate)) / rate, angle=0.3)[["angle"]]
    noisy = motion + noise * np.random.default_rng(seed).standard_normal(motion.sizes["time"])
    return st.free_decay(step * np.round(noisy / step) if step else noisy)


def floor(noise, rate, step):
    """Cramér-Rao bound of each force; angle steps count as the white noise step/sqrt(12)."""
    time = np.arange(round(25 * rate)) / rate
    return st.validation.cramer_rao_bound(truth, time, 0.3, 0.0, np.hypot(noise, step / 12**0.5), free=True)


one = record(1e-4, 100, 0.0, seed=0)
rows = {
    "truth": PAPER,
    "Cramér-Rao bound": dict(zip(PAPER, floor(1e-4, 100, 0.0).standard_error.values, strict=True)),
}
for label, method in METHODS.items():
    found = st.identify(one, library, method).sel(force=list(PAPER))
    rows[label] = dict(zip(PAPER, found.coefficient.values, strict=True))
    rows[f"{label}: stated error"] = dict(zip(PAPER, found.standard_error.values, strict=True))
pd.DataFrame(rows).T.style.format("{:.3g}")

# %% [markdown]
# Averages of the first order in the forces are biased, far beyond the noise. `Averaging()` identifies a
# model, simulates it, averages its motion in the same way, and subtracts the error that this shows.
#
# ## Many records
#
# Each point below is the RMS error over records that differ in their noise. From $n$ records it is known
# to a fraction of about $1/\sqrt{2n}$, so that points may lie below the bound by this amount. The tables
# below the figures have the smallest and the largest ratio of error to bound among the forces, and the
# fraction of errors below 1.96 stated standard errors, which should be 95 %.


# %%
def study(levels, long_name, units, conditions):
    """RMS error of each method and force at each level of something, with the bound there."""
    forces = list(PAPER)
    shape = (len(METHODS), len(levels), SEEDS, len(forces))
    errors, stated = np.full(shape, np.nan), np.full(shape, np.nan)
    for at, condition in enumerate(conditions):
        for seed in range(SEEDS):
            decay = record(*condition, [at, seed])
            for row, method in enumerate(METHODS.values()):
                found = st.identify(decay, library, method).sel(force=forces)
                errors[row, at, seed] = found.coefficient - list(PAPER.values())
                stated[row, at, seed] = found.standard_error
    bound = np.stack([floor(*condition).standard_error.values for condition in conditions])
    dims = ("method", "level", "force")
    return xr.Dataset(
        {
            "error": (dims, np.sqrt(np.mean(errors**2, axis=2)), {"long_name": "RMS error", "units": "1"}),
            "within": (dims, np.mean(np.abs(errors) < 1.96 * stated, axis=2)),
            "bound": (dims[1:], bound, {"long_name": "Cramér-Rao bound", "units": "1"}),
        },
        {
            "method": list(METHODS),
            "level": ("level", levels, {"long_name": long_name, "units": units}),
            "force": forces,
        },
    )


def shown(found):
    """Errors of each force by level for each method, and in black the bound, below which no one gets."""
    look = {"xscale": "log", "yscale": "log", "sharey": False, "marker": "o", "markersize": 3}
    panels = found.error.plot.line(x="level", hue="method", col="force", col_wrap=3, **look)
    for ax, force in zip(panels.axs.flat, found.force.values, strict=False):
        ax.plot(found.level, found.bound.sel(force=force), color="black")


def over_bound(found):
    """Error over bound, over the forces the smallest and the largest."""
    ratio = found.error / found.bound
    low, high = (getattr(ratio, k)("force").transpose("level", "method").to_pandas() for k in ("min", "max"))
    return low.map("{:.2g} to ".format) + high.map("{:.2g}".format)


# %% [markdown]
# ## Noise
#
# At 100 Hz. Averaging without its correction does not improve below the noise at which its bias dominates;
# the other methods follow the bound.

# %%
noises = [3e-5, 1e-3] if QUICK else [1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3]
by_noise = study(noises, "noise of a sample", "rad", [(noise, 100, 0.0) for noise in noises])
shown(by_noise)

# %%
over_bound(by_noise)

# %%
by_noise.within.mean("force").transpose("level", "method").to_pandas().style.format("{:.0%}")

# %% [markdown]
# ## Sampling rate
#
# At a noise of 0.1 mrad per sample. More samples with the same noise contain more information: the bound
# decreases with the square root of the rate.

# %%
rates = [50, 200] if QUICK else [25, 50, 100, 200, 400]
by_rate = study(rates, "sampling rate", "Hz", [(1e-4, rate, 0.0) for rate in rates])
shown(by_rate)

# %%
over_bound(by_rate)

# %%
bound = by_rate.bound.sel(force="zeta").values
print(f"bound of zeta times the root of the rate: {bound * np.sqrt(rates)}")

# %% [markdown]
# ## Angle steps
#
# A sensor with steps, at 100 Hz and 0.1 mrad of noise. The bound treats steps as white noise of
# step/$\sqrt{12}$. This is correct if the noise is a good part of a step. Otherwise the errors of the
# steps depend on the angle and repeat from swing to swing. Methods that assume white noise then lose some
# precision and, which is worse, state errors that are too small (the second table). A little noise before
# the steps improves the result.

# %%
steps = [3e-4, 3e-3] if QUICK else [1e-4, 3e-4, 1e-3, 3e-3, 1e-2]
by_step = study(steps, "angle step", "rad", [(1e-4, 100, step) for step in steps])
shown(by_step)

# %%
over_bound(by_step)

# %%
by_step.within.mean("force").transpose("level", "method").to_pandas().style.format("{:.0%}")

# %% [markdown]
# ## Planning a measurement
#
# The bound needs no record, so that it can choose an experiment. From which angle must the pendulum be
# released to know $\epsilon$ to one percent, at 100 Hz and 0.5 mrad of noise?

# %%
time = np.arange(2500) / 100
angles = [0.1, 0.2, 0.3, 0.45, 0.6, 0.9]
bounds = [
    st.validation.cramer_rao_bound(truth, time, angle, 0.0, 5e-4, free=True).standard_error
    for angle in angles
]
plan = pd.DataFrame([bound.values / np.abs(list(PAPER.values())) for bound in bounds], angles, list(PAPER))
print(f"epsilon is known to 1 % from {plan.index[plan.epsilon < 0.01][0]} rad on")
plan.rename_axis("from angle (rad)").style.format("{:.2%}")
