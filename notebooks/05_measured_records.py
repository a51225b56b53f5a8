# %% [markdown]
# # Measured records
#
# Three free decays that others measured and published: a steel pendulum on a bearing, a filmed bob on a
# string, and the model of a ship that rolls in a basin. For each, some facts are known beforehand and can
# be compared with the result. No model explains a record completely: the residuals are shown.
#
# The records are not part of this repository. `st.datasets` reads them from the folder that
# `SYSID_TRIB_DATA` names, or downloads them from their public sources, and checks them.

# %%
import os
from dataclasses import replace

import numpy as np
import pandas as pd
import tables
import xarray as xr
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
pd.set_option("display.max_colwidth", None)
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # shorter, coarser records, fewer candidates, methods

# %% [markdown]
# ## The same three questions
#
# Which coefficients do averaging and direct identification find, and does their model explain the record?
# How do other methods compare, also on a last third that they have not used? Which force is missing, if
# the search starts from one force: viscous friction for the pendulums, quadratic drag for the ship?

# %%
contact, effects = st.load_library("contact_forces"), st.load_library("candidate_effects")
everything = replace(effects, forces=(*contact, *effects))
FEW = "lambda delta nu epsilon stribeck gravity inertia angle_drag"
candidates = everything.select(FEW.split() if QUICK else [s for s in everything.symbols if s != "alpha"])

m = st.methods
METHODS = {"direct": m.Direct(), "averaging": m.Averaging()}
if not QUICK:
    METHODS |= {
        "trajectory": m.Trajectory(),
        "averaging (printed rule)": m.Averaging("last", correct=False, weighted=False),
        "direct (strong form)": m.Direct(form="strong"),
        "logarithmic decrement": m.LogarithmicDecrement(),
        "Feeny-Liang decrement": m.FeenyLiang(),
        "Wu decrement": m.WuDecrement(),
        "quadratic decay": m.QuadraticDecay(),
    }


def identified(decay: xr.Dataset, symbols: str) -> xr.DataTree:
    """Compare averaging and direct with the same forces, and show their residuals."""
    library = everything.select(symbols.split())
    first, second = (st.identify(decay, library, method) for method in (m.Averaging(), m.Direct()))
    tree = st.cross_check(decay, first, second)
    display(tables.coefficients({"averaging": first, "direct": second}))
    judged, checked = tree["judged"].ds, tree["agreement"].ds
    residuals = ", ".join(f"{ratio:.3g}" for ratio in judged.residual_over_noise.values)
    verdict, p = judged.attrs["verdict"], checked.p_value.item()
    print(f"Verdict: {verdict}; the RMS residuals are {residuals} times the noise.")
    print(f"The methods {checked.attrs['verdict']} (p = {p:.2g}).")
    return tree


def searched(decay: xr.Dataset, start: str, effects: int, holdout: xr.Dataset | None = None) -> xr.DataTree:
    """Find the forces that a start model lacks, and print residuals in noise levels."""
    unseen = () if holdout is None else holdout
    most = 1 if QUICK else effects
    tree = st.discover(decay, contact.select([start]), candidates, max_effects=most, holdout=unseen)
    display(tables.effects_found(tree))
    residuals = tree["holdout"].rms.values / tree["holdout"].residual_noise.item()
    print(
        f"Verdict: {tree['judged'].attrs['verdict']}; outcome of the search: {tree.attrs['search_outcome']}."
    )
    print(
        f"On the held-out part ({tree.attrs['held_out']}) the residual is {residuals[0]:.3g} times the "
        f"noise by the start model, {residuals[-1]:.3g} times by the final one."
    )
    return tree


def parted(decay: xr.Dataset, seconds: float) -> tuple[xr.Dataset, xr.Dataset]:
    """A decay without its last seconds, and these."""
    end = decay.time[-1].item() - seconds
    return decay.sel(time=slice(None, end)), decay.sel(time=slice(end, None))


def value_of(tree: xr.DataTree, symbol: str) -> tuple[float, float]:
    """Coefficient of a force by direct identification, and its standard error."""
    one = tree["direct"].ds.sel(force=symbol)
    return one.coefficient.item(), one.standard_error.item()


decays: dict[str, xr.Dataset] = {}
records = {
    "pendulum": tables.available("steel_pendulum"),
    "string": tables.available("string_pendulum"),
    "ship": tables.available("ship_roll"),
}
known: list[dict[str, str]] = []  # what is known beforehand, and what is found


def held_against(record: str, what: str, known_as: str, found: str) -> None:
    known.append({"record": record, "what": what, "known beforehand": known_as, "found": found})


# %% [markdown]
# ## A steel pendulum on its bearing
#
# An encoder reads the angle at 1 kHz. Known beforehand: hanging down is pi; gravity restores the pendulum,
# as sin(theta) with the coefficient 1; the bearing rubs, the air drags, and nothing feeds energy in. Its
# authors published 55 s of the swing in six parts, which are joined. Every tenth sample is more than
# enough.

# %%
if records["pendulum"] is not None:
    record = records["pendulum"].isel(time=slice(None, None, 40 if QUICK else 10))
    decay = st.free_decay(record, window=(None, 25.0 if QUICK else 45.0))
    decays["pendulum"] = decay
    print(decay.attrs["free_decay"])
    centre, error = decay.equilibrium.item(), decay.equilibrium_standard_error.item()
    held_against("pendulum", "equilibrium (rad)", f"{np.pi:.4f}", f"{centre:.4f} ± {error:.4f}")

# %% [markdown]
# With the contact forces, of which the cubic one must replace gravity,

# %%
if "pendulum" in decays:
    cubic = identified(decays["pendulum"], "lambda zeta delta epsilon")
    display(st.plots.overview(cubic))

# %% [markdown]
# the methods find the same coefficients of a wrong model, and the check says so: at such angles x^3 is not
# gravity. With gravity itself:

# %%
if "pendulum" in decays:
    gravity = identified(decays["pendulum"], "lambda zeta delta gravity")
    for symbol, what, said in (
        ("gravity", "gravity over all that restores", "1"),
        ("lambda", "friction of the bearing", "> 0"),
        ("zeta", "viscous friction", ">= 0"),
        ("delta", "air drag", "> 0"),
    ):
        value, error = value_of(gravity, symbol)
        held_against("pendulum", what, said, f"{value:.5f} ± {error:.5f}")
    compared = st.compare(decays["pendulum"], everything.select(gravity["direct"].force.values), METHODS)
    display(st.plots.comparison(compared))

# %% [markdown]
# Next comes the search, on the whole record. Its last seconds are not used; they are predicted, with only
# the start of their motion fitted.

# %%
if records["pendulum"] is not None:
    longer = st.free_decay(record, window=(None, 30.0 if QUICK else None))
    seen, unseen = parted(longer, 9.0)
    pendulum = searched(seen, "zeta", effects=3, holdout=unseen)
    display(st.plots.story(pendulum))
    display(st.plots.ranking(pendulum))

# %% [markdown]
# ## A filmed bob on a string
#
# The film has twenty pictures per second. Known beforehand: gravity restores the bob, so that a cubic
# force must be near -1/6 as long as angles are not too large; air drags it. The camera looks from one
# side.

# %%
if records["string"] is not None:
    decays["string"] = st.free_decay(records["string"], window=(None, 40.0 if QUICK else None))
    print(decays["string"].attrs["free_decay"])
    string = identified(decays["string"], "zeta delta epsilon")
    display(st.plots.overview(string))
    for symbol, what, said in (
        ("epsilon", "gravity as a cubic force", f"{-1 / 6:.4f}"),
        ("delta", "air drag", "> 0"),
        ("zeta", "viscous friction", ">= 0"),
    ):
        value, error = value_of(string, symbol)
        held_against("string", what, said, f"{value:.5f} ± {error:.5f}")

# %%
if "string" in decays:
    compared = st.compare(decays["string"], everything.select(["zeta", "delta", "epsilon"]), METHODS)
    display(st.plots.comparison(compared))

# %%
if "string" in decays:
    filmed = searched(decays["string"], "zeta", effects=2)
    display(st.plots.story(filmed))
    display(st.plots.ranking(filmed))

# %% [markdown]
# ## A ship model that rolls
#
# A hundred readings per second, in steps of 0.005 degree. Known beforehand: water dissipates the energy,
# mostly by drag with the square of speed; there is no dry friction.

# %%
if records["ship"] is not None:
    decay = st.free_decay(records["ship"], window=(25.0, 65.0 if QUICK else None))
    decays["ship"] = decay.isel(time=slice(None, None, 4)) if QUICK else decay
    print(decays["ship"].attrs["free_decay"])
    ship = identified(decays["ship"], "lambda delta epsilon")
    display(st.plots.overview(ship))
    largest = float(np.abs(decays["ship"].angle).max())
    share = st.physics.weights(ship["direct"].to_dataset(), largest).decay_share.sel(force="delta").item()
    held_against("ship", f"share of drag in the decay at {largest:.2f} rad", "most", f"{100 * share:.1f} %")
    value, error = value_of(ship, "lambda")
    held_against("ship", "dry friction", "0", f"{value:.6f} ± {error:.6f}")

# %%
if "ship" in decays:
    compared = st.compare(decays["ship"], everything.select(["lambda", "delta", "epsilon"]), METHODS)
    display(st.plots.comparison(compared))

# %%
if "ship" in decays:
    rolling = searched(decays["ship"], "delta", effects=3)
    display(st.plots.story(rolling))
    display(st.plots.ranking(rolling))

# %% [markdown]
# ## A random force in addition to the sensor noise
#
# The fits above contain the sensor noise alone, and their residuals are many times that noise. With a
# random force (a white acceleration) angle and rate follow a random walk. Its density is estimated
# together with the sensor noise, and the errors of the coefficients increase. A random force does not
# excuse a missing force: if it depends on the motion, the p-value of a force that depends on nothing is
# small, and a force is missing.

# %%
MODELS = {
    "pendulum": "lambda zeta delta gravity sensor_curve",
    "string": "zeta delta gravity sensor_curve sensor_cubic shutter",
    "ship": "lambda delta epsilon",
}


def with_random_force(decay: xr.Dataset, name: str) -> xr.Dataset:
    return st.identify(decay, everything.select(MODELS[name].split()), m.Direct(random_force="estimated"))


pushed = {name: with_random_force(decay, name) for name, decay in decays.items()}
ahead = {name: st.validation.innovations(decay, pushed[name]) for name, decay in decays.items()}
for name, result in pushed.items():
    display(tables.coefficients({name: result}))
if pushed:
    display(tables.random_forces(decays, pushed, ahead))

# %% [markdown]
# Innovations are the errors of the prediction one sample ahead. For a correct model they are white: within
# their band over time, and without autocorrelation. A model that lacks a slow force can have white
# innovations too, because the random force follows the record. The last column of the table separates the
# two cases. It is small for all three records: each of these models lacks a force.
#
# When did the random force act? The third panel below shows the smoothed random force, as a mean over the
# span that the sensor resolves, with its band. A force that follows the swing, or decreases with its
# amplitude, is not random: that of the ship is largest in the first seconds.
#
# How far ahead can the motion be predicted? A model of the first two thirds predicts the last third, from
# each origin on with the samples up to there. The random force widens the bands with time. They contain 95
# % if the force is random. If it depends on the motion they can be too wide (in the film, the forces that
# its model lacks at large angles count as noise at small ones) or too narrow.


# %%
def foreseen(decay: xr.Dataset, name: str) -> xr.Dataset:
    """Predictions up to two periods ahead in the last third, by a model of the first two."""
    length = decay.time[-1].item() - decay.time[0].item()
    seen, unseen = parted(decay, length / 3.0)
    model = with_random_force(seen, name)
    longest = 4.0 * np.pi / model.reference_frequency.item()
    origins = np.arange(unseen.time[0].item(), unseen.time[-1].item() - longest, longest)
    return st.validation.prediction_bands(decay, model, np.arange(1, 17) / 8.0, origins=list(origins))


for name, decay in decays.items():
    bands = foreseen(decay, name)
    missed = np.abs(bands.measured - bands.predicted).sel(horizon=1.0)
    inside = (missed < 1.96 * bands.predicted_standard_error.sel(horizon=1.0)).values
    print(f"{name}: {inside.sum()} of {inside.size} within their band one period ahead")
    figure = st.plots.innovations(ahead[name], bands)
    figure.suptitle(name)
    display(figure)

# %% [markdown]
# ## Known and found
#
# The errors are those that direct identification states. They are valid if the model is. If the record is
# not explained, a difference of many errors says more about the form of the model than about the
# coefficient: a negative viscous coefficient, or a dry friction of water, stands for a force of another
# form.

# %%
if known:
    display(pd.DataFrame(known))
