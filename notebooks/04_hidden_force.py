# %% [markdown]
# # Finding a hidden force
#
# An oscillator is known to have dry and viscous friction. A random draw hides one effect, none, or one
# that is in no library. `discover` gets the record alone. It shows where the known model and the record
# differ, ranks the candidates, adds the best one, shows how the residual decreases, and says which effects
# the record cannot separate. The envelopes with the truth are opened after the verdicts.
#
# Every record in this notebook is *synthetic*: simulated, with white noise added.

# %%
import os
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import tables
import xarray as xr
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
pd.set_option("display.max_colwidth", None)
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # fewer candidates and hidden records, shorter motions

# %% [markdown]
# ## The start model and the candidates
#
# The start model has solid and viscous friction. Candidates are the other contact forces and the effects
# of the package. `alpha`, a linear spring, is not offered: one record cannot separate it from the
# frequency, which is fitted.

# %%
contact, effects = st.load_library("contact_forces"), st.load_library("candidate_effects")
everything = replace(effects, forces=(*contact, *effects))
known = contact.select(["lambda", "zeta"])
FEW = "delta nu epsilon stribeck structural_damping detent gravity inertia even_drag sensor_curve"
names = FEW.split() if QUICK else [s for s in everything.symbols if s not in ("lambda", "zeta", "alpha")]
candidates = everything.select(names)

FREQUENCY, NOISE = 9.0, 2e-4  # rad/s, rad
BASE = {"lambda": 3e-4, "zeta": 0.006}
SECONDS, RATE = (15.0, 40.0) if QUICK else (25.0, 50.0)  # s, Hz


def record_of(model: st.Model, angle: float = 0.5, seed: int = 0, noise: float = NOISE) -> xr.Dataset:
    """A synthetic record: the model's motion from rest at `angle` (rad), and white noise."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    motion = st.simulate(model, time, angle)
    return motion[["angle"]] + noise * np.random.default_rng(seed).standard_normal(time.size)


def model_with(hidden: dict[str, float], shapes: dict[str, float] | None = None) -> st.Model:
    """The known forces and what is hidden."""
    return st.Model(everything, BASE | hidden, FREQUENCY, shapes or {})


print(f"{len(candidates)} candidates in {len({force.family for force in candidates})} families")

# %% [markdown]
# ## Nothing missing, and the detectable effects
#
# In the first oscillator nothing is hidden. The outcome *nothing missing* says little without the smallest
# effect that the record would show. The table of detectability has one row for each candidate, computed
# from the noise of the record and the sensitivities of the motion. An effect that the known forces can
# imitate on this record is marked as not testable.

# %%
nothing = st.discover(record_of(model_with({})), known, candidates)
best = nothing["ranking"].z.isel(selection_step=-1).to_series().abs().sort_values(ascending=False)
p_value = nothing["omnibus"].p_value[-1].item()
print(f"Outcome: {nothing.attrs['search_outcome']}; p-value of the omnibus test: {p_value:.2g}")
print("Highest scores:", ", ".join(f"{symbol} |z| = {z:.2f}" for symbol, z in best.head(3).items()))
seen_from = nothing["detectability_after"].detectable.to_series().dropna().sort_values()
print("Would be seen from:", ", ".join(f"{symbol} {c:.2g}" for symbol, c in seen_from.head(5).items()))

# %% [markdown]
# ## A sealed record
#
# A draw chooses any candidate (or none, one time in six), a sign if both make sense, shape parameters
# within a factor of two of their defaults, and a strength: the RMS residual of the best fit of the known
# forces is between 0.4 and 8 times the noise. The truth goes into an envelope. Several records are drawn;
# this is one of them.

# %%
LOSING = ("friction", "damping", "hysteresis")


def unexplained(record: xr.Dataset) -> float:
    """RMS (rad) of the residual of the best fit of the known forces."""
    return st.identify(record, known, st.methods.Trajectory()).residual_rms.item()


def sealed(number: int) -> tuple[xr.Dataset, st.Model]:
    """A synthetic record with something hidden, and the envelope."""
    draw = np.random.default_rng(number)
    testable = nothing["detectability"].candidate.values[
        np.isfinite(nothing["detectability"].detectable.values)
    ]
    force = candidates[str(draw.choice(testable))]
    sign = 1.0 if force.family in LOSING else draw.choice([-1.0, 1.0])
    shapes = {
        f"{force.symbol}.{name}": float(np.clip(s.default * 2.0 ** draw.uniform(-1.0, 1.0), s.low, s.high))
        for name, s in force.shape.items()
    }
    wanted = NOISE * np.exp(draw.uniform(np.log(0.4), np.log(8.0)))
    if draw.random() < 1 / 6:
        return record_of(model_with({}), seed=number), model_with({})
    size = sign * nothing["detectability"].detectable.sel(candidate=force.symbol).item()
    # The residual is nearly proportional to the coefficient: a few steps settle it.
    for _ in range(4):
        motion = record_of(model_with({force.symbol: size}, shapes), noise=0.0)
        size *= float(np.clip(wanted / unexplained(motion), 0.02, 50.0))
    hidden = model_with({force.symbol: size}, shapes)
    return record_of(hidden, seed=number), hidden


records = {number: sealed(number) for number in range(1, 4 if QUICK else 13)}
number = max(records, key=lambda n: unexplained(records[n][0]))
record, envelope = records[number]
found = st.discover(record, known, candidates)

# %% [markdown]
# Where do model and record differ? The model *before* has the best fit of the known forces; the model
# *after* also has the effects that were found.

# %%
display(st.plots.story(found))

# %% [markdown]
# Which effect explains the residual? The score of a candidate is its coefficient over its standard error,
# after the part that the known forces can imitate is removed. The threshold is corrected for the number of
# candidates and shape parameters that were tried. Effects that explain the record equally well compete
# with the named one: they are in its 95 % credible set.

# %%
display(st.plots.ranking(found))

# %%
print(f"Outcome of the search: {found.attrs['search_outcome']}")
display(tables.effects_found(found))

# %% [markdown]
# The last third of the record is held out: the models are fitted to the first two thirds, and predict it.
# Now the envelope:

# %%
truth = {symbol: c for symbol, c in envelope.coefficients.items() if symbol not in BASE}
print("Hidden:", *(f"{name} = {value:.4g}" for name, value in (truth | envelope.shapes).items()))

# %% [markdown]
# ## Competing effects, and the measurement that separates them
#
# At small angles a cubic spring, gravity of a pendulum, a magnet, and an inertia that grows with the angle
# have nearly the same effect. One of them is hidden, at 0.3 rad.

# %%
alike = [s for s in ("epsilon", "gravity", "magnet", "inertia") if s in candidates.symbols]
chosen = str(np.random.default_rng(2019).choice(alike))
strength = {"epsilon": 0.02, "gravity": -0.12, "magnet": -0.03, "inertia": 0.06}[chosen]
elastic = model_with({chosen: strength})
small = record_of(elastic, angle=0.3, seed=1)
one = st.discover(small, known, candidates)
print(f"One record from 0.3 rad: {one.attrs['search_outcome']}")
display(tables.effects_found(one))

# %% [markdown]
# Which measurement would separate them? The detectability answers this before the measurement. It
# simulates the *known* model, released from larger and larger angles, and computes the coefficient of five
# standard errors of each candidate, and the cosine between the responses of any two, without the part that
# the model can imitate. This gives the number of standard errors of the effect just found, and of its
# difference from each competing effect. Some 2.4 standard errors (odds of 19 to 1 between two) separate
# two effects.


# %%
def difference(angle: float, symbol: str, coefficient: float) -> xr.DataArray:
    """Standard errors by which an effect of this size differs from others, released from `angle` (rad)."""
    planned = st.discover(record_of(model_with({}), angle=angle, seed=3), known, candidates.select(alike))
    effect = planned["detectability"].ds.sel(candidate=symbol)
    return 5.0 * abs(coefficient) / effect.detectable * np.sqrt(1.0 - np.minimum(effect.cosine, 1.0) ** 2)


step = one["steps"].ds.isel(step=0)
found_name, found_size = step["symbol"].item(), step["coefficient"].item()
releases = [0.3, 0.6, 1.2] if QUICK else [0.2, 0.3, 0.45, 0.65, 0.9, 1.2]
differences = xr.concat(
    [difference(angle, found_name, found_size) for angle in releases],
    xr.Variable("release", releases, {"units": "rad", "long_name": "release from"}),
)

# %%
display(differences.to_pandas().round(1))

# %% [markdown]
# The second release is therefore made from 1.2 rad, and both runs are searched together: they share forces
# and frequency.

# %%
large = record_of(elastic, angle=1.2, seed=2)
both = st.discover([small, large], known, candidates)
print(f"With a second release from 1.2 rad: {both.attrs['search_outcome']}")
display(tables.effects_found(both))
print("Hidden was:", chosen, strength)

# %% [markdown]
# ## An effect that is in no library
#
# A name is only the best of the candidates. Here the pivot is a motor with magnets: its cogging torque
# repeats 24 times a turn, and no candidate does that.

# %%
COGGING = """
title = "Cogging of a motor"
[[force]]
symbol = "cogging"
name = "cogging torque of a motor"
formula = "sin(n*x)"
family = "elasticity"
shape = { n = { default = 24.0, low = 6.0, high = 48.0, meaning = "steps a turn" } }
"""
with TemporaryDirectory() as folder:
    path = Path(folder) / "cogging.toml"
    path.write_text(COGGING, encoding="utf-8")
    cogging = st.load_library(path)
motor = st.Model(replace(everything, forces=(*everything, *cogging)), BASE | {"cogging": 3e-4}, FREQUENCY)
driven = record_of(motor, seed=4)
unknown = st.discover(driven, known, candidates, max_effects=2)
print(f"Outcome of the search: {unknown.attrs['search_outcome']}")
display(tables.effects_found(unknown))

# %% [markdown]
# The name is wrong, and the result shows it: the residual does not fall to the noise, and an effect may
# even worsen the prediction of the held-out third. The omnibus test involves no candidate: it uses trial
# forces (powers of the amplitude times harmonics of the phase). Its p-value says whether the residual
# depends on the motion.

# %%
omnibus = unknown["omnibus"].ds.isel(selection_step=-1)
strongest = omnibus.z.to_series().sort_values(key=np.abs, ascending=False).head(5)
print(f"p-value of the omnibus test: {omnibus.p_value.item():.2g}")
display(strongest.to_frame("z of the trial force (amplitude r, phase phi)").round(1))
display(st.plots.story(unknown))

# %% [markdown]
# If the cogging torque is offered as a further candidate, it is named:

# %%
named = st.discover(driven, known, replace(candidates, forces=(*candidates, *cogging)))
print(f"Outcome of the search: {named.attrs['search_outcome']}")
display(tables.effects_found(named))

# %% [markdown]
# ## All sealed records
#
# One record proves little. Here are all that were drawn, by number from 1 on. First the outcomes,

# %%
others = {n: st.discover(record, known, candidates) for n, (record, _) in records.items() if n != number}
searched = others | {number: found}

# %% [markdown]
# then the envelopes:


# %%
def row_of(tree: xr.DataTree, hidden: st.Model) -> dict[str, object]:
    """Truth against outcome; residuals are those of the held-out third, in noise levels."""
    truth = {symbol: c for symbol, c in hidden.coefficients.items() if symbol not in BASE}
    steps, residuals = tree["steps"].ds, tree["holdout"].rms.values / tree["holdout"].residual_noise.item()
    each = [steps.isel(step=at) for at in range(steps.attrs["count"])]
    named = [one["symbol"].item() for one in each]
    classes = [one.candidate.values[one.credible.values].tolist() for one in each]
    coefficients = [f"{one['coefficient'].item():.3g} ± {one['standard_error'].item():.1g}" for one in each]
    return {
        "hidden": ", ".join(f"{symbol} {c:.3g}" for symbol, c in truth.items()) or "nothing",
        "outcome": tree.attrs["search_outcome"],
        "named": "; ".join(" ".join(pair) for pair in zip(named, coefficients, strict=True)),
        "competing": "; ".join(", ".join(s for s in tied if s not in named) for tied in classes),
        "residual before": residuals[0],
        "after": residuals[-1],
        "exact": set(named) == set(truth),
        "in the set": len(named) == len(truth) and all(set(truth) & set(tied) for tied in classes),
    }


table = pd.DataFrame({n: row_of(searched[n], records[n][1]) for n in records}).T.infer_objects()
display(table.round(2))
something = table.hidden != "nothing"
exact, tied = (table[something][column].sum() for column in ("exact", "in the set"))
print(f"{exact} of {something.sum()} hidden effects were named exactly, {tied} are in a credible set.")
alarms = (table[~something].outcome != "nothing missing").sum()
print(f"{alarms} of {(~something).sum()} records with nothing hidden raised an alarm.")

# %% [markdown]
# The residual can fall to one noise level, not further. A row whose effect is not in the set is a wrong
# name, given with confidence. This happens more often if the effect is weak and if many candidates
# resemble it: [What discover finds](../docs/discovery.md) has the rates of some hundred such records.
#
# ## Summary
#
# - A name is the best of the candidates. Read the competing effects and the held-out prediction with it.
# - Read the detectability with *nothing missing*: weaker effects may be present.
# - If effects compete, the record does not separate them. The program computes which other record would.
# - *Unknown effect* is a result too. Describe what you know about the apparatus in a line of TOML, and
#   repeat the search.
