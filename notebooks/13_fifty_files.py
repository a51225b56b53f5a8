# %% [markdown]
# # Fifty files: what varies between them, and with what?
#
# You have a folder of records and a table of the conditions under which they were measured. A campaign
# identifies all of them, marks those that fail, and tests which coefficients change with a condition. It
# takes a minute.

# %%
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # 12 files instead of 50
FILES = 12 if QUICK else 50

# %% [markdown]
# ## The files
#
# For your own files: `files = sorted(Path("runs").glob("*.csv"))` and
# `conditions = pd.read_csv("conditions.csv")`, one row for each file in the same order.
#
# Here they are simulated from the certified decay `three_frictions`, and written as any laboratory would:
# one CSV file for each run, and a table of conditions. The solid friction (`lambda`) rises with the load by
# 2 % for each newton. The temperature has no effect. The last file is empty, as happens.

# %%
certified = st.datasets.truth("certified/three_frictions_1e-4")
FORCES = st.load_library("contact_forces").select(["lambda", "zeta", "delta"])
TRUTH = certified.value.sel(quantity=list(FORCES.symbols)).to_series().to_dict()
w = certified.value.sel(quantity="reference_frequency").item()
folder = TemporaryDirectory()
random = np.random.default_rng(0)
conditions = pd.DataFrame(
    {
        "record": [f"run_{at:02}.csv" for at in range(FILES)],
        "load (N)": np.tile([2.0, 4.0, 6.0, 8.0, 10.0], FILES)[:FILES],
        "temperature (degC)": random.uniform(20.0, 30.0, FILES).round(1),
    }
)
time = np.arange(1500) / 100.0
for name, load in zip(conditions["record"], conditions["load (N)"], strict=True):
    coefficients = TRUTH | {"lambda": TRUTH["lambda"] * (1.0 + 0.02 * load)}
    motion = st.simulate(st.Model(FORCES, coefficients, w), time, angle=random.normal(0.3, 0.01))
    angle = motion.angle.values + 2e-4 * random.standard_normal(len(time))
    table = pd.DataFrame({"time (s)": time, "angle (rad)": angle.round(6)})
    table.to_csv(Path(folder.name) / name, index=False)
(Path(folder.name) / conditions["record"].iloc[-1]).write_text("")
conditions.head()

# %% [markdown]
# ## The campaign
#
# `output` is a store on disk. An interrupted campaign goes on where it stopped when the cell is run again.
# `workers=2` uses two processes; in a notebook 0 (this process alone) is simplest.

# %%
task = st.campaigns.Task("identify", FORCES, {"direct": st.methods.Direct()})
files = [Path(folder.name) / name for name in conditions["record"]]
store = st.campaign(files, task, output=Path(folder.name) / "results.zarr", workers=0)
st.show(store)

# %% [markdown]
# Records without an answer have a reason:

# %%
store[["status", "message"]].where(store.status != 1, drop=True).to_dataframe()

# %% [markdown]
# ## What varies, and with what

# %%
estimates = st.campaigns.estimates_of(store, "direct")
measured_at = conditions.drop(columns="record").iloc[estimates["at"].values]
compared = st.campaigns.between_runs(estimates, measured_at)
compared[["verdict", "between_run", "scatter_p_value"]].to_dataframe()

# %%
st.plots.against_condition(compared, "load (N)", measured_at["load (N)"])

# %% [markdown]
# The increase of each coefficient for each newton of load, with its error and the truth:

# %%
effect = compared.sel(term="load (N)")
table = effect[["effect", "effect_standard_error"]].to_dataframe()[["effect", "effect_standard_error"]]
table["truth"] = [0.02 * TRUTH["lambda"] if name == "lambda" else 0.0 for name in table.index]
table

# %%
folder.cleanup()
