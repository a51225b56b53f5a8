# %% [markdown]
# # A frame that rubs: friction against load
#
# A single-storey frame is shaken at its base, and brass rubs on steel at its floor under a load (Marino
# and Cicirello 2023). Displacements of mass and base were measured. Frequency and damping belong to the
# frame, the friction to the load. Three records are identified together, in which only the friction
# differs.
#
# The records are not part of this repository: `st.datasets` reads them from the folder that
# `SYSID_TRIB_DATA` names, or downloads them.

# %%
import os
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import tables
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # two records of three, half as long

# %% [markdown]
# ## Inputs from separate files
#
# Each record has a separate file with the motion of the base; `st.datasets` reads both. For files of your
# own, `st.read_record("mass.mat", input={"base": "base.mat:y"})` does the same. The spring is
# stretched by x - base, and the damper moves at the rate of x - base, so that both forces contain the
# input. The coefficient of the spring is known to be one.

# %%
LOADS = np.array([250.0, 550.0] if QUICK else [250.0, 350.0, 550.0])  # g
MASS, GRAVITY = 3.0799, 9.81  # kg, as its authors weighed it; m/s^2
records = [tables.available(f"friction_frame_{load:.0f}g") for load in LOADS]
complete = all(record is not None for record in records)

contact, inputs = st.load_library("contact_forces"), st.load_library("inputs")
forces = (*inputs.select(["base_spring", "base_damping"]), *contact.select(["lambda"]))
library = replace(inputs, forces=forces)

# %%
if complete:
    runs = [record.isel(time=slice(record.sizes["time"] // 2 if QUICK else None)) for record in records]
    methods = [kind(own=("lambda",)) for kind in (st.methods.Direct, st.methods.Trajectory)]
    tree = st.identify(runs, library, methods, constraints={"base_spring": 1.0})
    judged = tree["judged"]
    answer = tree[judged.attrs["preferred"]].to_dataset()
    left = float(judged.residual_over_motion.sel(model=judged.attrs["preferred"]))
    print(f"{judged.attrs['preferred']}: {judged.attrs['verdict']}, {100 * left:.2g} % are left")
    display(st.plots.overview(tree))

# %% [markdown]
# The residual is more than noise, so the verdict is not "explained", and the coefficients are effective
# values. The errors include the correlation of the residual, by blocks of the records. They do not include
# another form of the friction.
#
# ## Friction against load
#
# The coefficient lambda is a displacement: that of the spring under the friction. With the mass it is a
# force, F = m w^2 lambda.

# %%
if complete:
    w = answer.reference_frequency.item()
    own = answer.sel(force=[f"lambda_{run}" for run in range(1, len(LOADS) + 1)])
    newton = 1e-3 * MASS * w**2
    friction, error = newton * own.coefficient.values, newton * own.standard_error.values
    normal = 1e-3 * LOADS * GRAVITY
    rows = {
        "load (N)": normal,
        "friction (N)": friction,
        "error (N)": error,
        "over the load": friction / normal,
    }
    display(pd.DataFrame(rows).round(4))
    print(f"{w / (2 * np.pi):.3f} Hz, zeta = {answer.coefficient.sel(force='base_damping').item():.4f}")

# %%
if complete:
    figure, axes = plt.subplots(figsize=(4.0, 3.0))
    axes.errorbar(normal, friction, yerr=1.96 * error, fmt="o", capsize=3)
    slope = np.sum(normal * friction) / np.sum(normal**2)
    line = np.array([0.0, normal[-1] * 1.1])
    axes.plot(line, slope * line, color="0.6", linewidth=0.8, label=f"{slope:.3f} of the load")
    axes.set(xlabel="load (N)", ylabel="friction (N)", xlim=(0.0, None), ylim=(0.0, None))
    axes.legend()
    plt.close(figure)
    display(figure)

# %% [markdown]
# The line is one friction coefficient for all loads. If the points differ from it by more than their
# errors, either the friction is not proportional to the load, or the form of the model is wrong. This
# record cannot decide between the two.
