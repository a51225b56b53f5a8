# %% [markdown]
# # A frame that rubs: friction against load
#
# A single-storey frame is shaken at its base, and brass rubs on steel at its floor under a load (Marino and
# Cicirello 2023). Displacements of mass and base were measured. Frequency and damping belong to the frame,
# the friction to the load: three records are identified together, in which only the friction differs.
#
# The records are not part of this repository: `SYSID_TRIB_DATA` names the folder that holds them.

# %%
import os
from dataclasses import replace

import matplotlib.pyplot as plt
import measured
import numpy as np
import pandas as pd
import xarray as xr
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # two records of three, half as long
folder = measured.driven("frame")

# %% [markdown]
# ## Inputs from files of their own
#
# The base has a file of its own for each record: `FILE:COLUMN` names it. The spring is stretched by x - base
# and the damper moves at its rate, so that both forces hold the input. That of the spring is known: its
# coefficient is one.

# %%
LOADS = np.array([250.0, 550.0] if QUICK else [250.0, 350.0, 550.0])  # g
MASS, GRAVITY = 3.0799, 9.81  # kg, as its authors weighed it; m/s^2


def read(load: float) -> xr.Dataset:
    files = [folder / f"s_b_{load:.0f}g_{which}.mat" for which in "xy"]
    record = st.read_record(files[0], time="t", units="mm", input={"base": f"{files[1]}:y"})
    return record.isel(time=slice(record.sizes["time"] // 2 if QUICK else None))


contact, inputs = st.load_library("contact_forces"), st.load_library("inputs")
forces = (*inputs.select(["base_spring", "base_damping"]), *contact.select(["lambda"]))
library = replace(inputs, forces=forces)

# %%
if folder is not None:
    runs = [read(load) for load in LOADS]
    methods = [kind(own=("lambda",)) for kind in (st.methods.Direct, st.methods.Trajectory)]
    tree = st.identify(runs, library, methods, constraints={"base_spring": 1.0})
    judged = tree["judged"]
    answer = tree[judged.attrs["preferred"]].to_dataset()
    left = float(judged.residual_over_motion.sel(model=judged.attrs["preferred"]))
    print(f"{judged.attrs['preferred']}: {judged.attrs['verdict']}, {100 * left:.2g} % are left")
    display(st.plots.overview(tree))

# %% [markdown]
# More than noise is left, so that the verdict is no "explained", and the coefficients are effective values.
# The errors allow for what is left being correlated, by blocks of the records. They know nothing of another
# form of the friction.
#
# ## Friction against load
#
# The coefficient lambda is a displacement, that of the spring under the friction. With the mass it is a
# force, F = m w^2 lambda.

# %%
if folder is not None:
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
if folder is not None:
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
# The line is one friction coefficient for all loads. Where the points leave it by more than their errors, the
# friction is not in proportion to the load, or the form of the model takes its part: this record cannot tell.
