# %% [markdown]
# # A driven rig: a motor moves a carriage
#
# The motion of your rig is not free: a motor, a shaker or the base drives it, and you measured the drive.
# This notebook takes the EMPS, a carriage on a ball screw that a motor moves (Janot, Gautier and Brunot
# 2019), and identifies its mass and friction. It takes a minute.
#
# The record is fetched from its public source, or read from the folder that `SYSID_TRIB_DATA` names. Without
# either, the cells that need it are skipped.

# %%
import os

import numpy as np
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # a third of the record

# %% [markdown]
# ## The record
#
# `qm` is the measured position (m). The drive is the motor's voltage `vir` times its gain `gtau`, which the
# file states, so that the input is a force in newton. With your own file:
# `st.read_record("rig.mat", time="t", angle="x", units="mm", input="force")`.

# %%
try:
    record = st.datasets.load("emps")
except st.errors.SysidTribError as error:
    record = None
    print(error)

# %%
if record is not None:
    record = record.isel(time=slice(record.sizes["time"] // 3 if QUICK else None))
    display(record)

# %% [markdown]
# ## Mass and friction
#
# The carriage has no restoring force: `st.system("axis")` holds the forces of such a rig. The table has the
# coefficients in newtons, with the mass. The first sentence says whether the model explains the record.

# %%
if record is not None:
    axis = st.system("axis")
    tree = st.identify(record, axis.library, constraints=axis.constraints)
    display(st.show(tree))

# %%
if record is not None:
    display(st.plots.overview(tree))

# %% [markdown]
# ## The friction law
#
# If the named forces do not explain the record, as here, the friction is identified as a curve against
# speed.

# %%
if record is not None:
    curves = st.laws(record, "axis")
    display(st.show(curves))
    display(st.plots.laws(curves))

# %% [markdown]
# ## What the model predicts
#
# The test of a model is a part of the record that it has not seen. The first two thirds are identified; the
# last third is predicted from its drive alone, after two seconds for the start.

# %%
if record is not None:
    cut = 2 * record.sizes["time"] // 3
    known, unseen = record.isel(time=slice(cut)), record.isel(time=slice(cut, None))
    model = st.identify(known, axis.library, "trajectory", constraints=axis.constraints)
    predicted = st.predict(model, unseen, warm_up=2.0)
    motion = np.ptp(unseen.angle.values)
    print(f"RMS of the prediction: {1e3 * predicted.residual_rms.item():.3g} mm of {1e3 * motion:.0f} mm.")
