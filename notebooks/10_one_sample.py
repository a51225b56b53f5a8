# %% [markdown]
# # One sample: which forces act, and how large are they?
#
# You let a pendulum swing while your sample rubs, and you have one file. This notebook goes from the file
# to a table with errors, a figure and a page. It takes a minute. To use your own file, replace the line
# that begins with `record =`.

# %%
import os

import numpy as np
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # the first half of the record

# %% [markdown]
# ## The record
#
# `certified/three_frictions_1e-3` is simulated: dry, viscous and quadratic friction, and a noise of
# 1 mrad. Its true coefficients are known, so that you can see how far the answer can be trusted. It comes
# with the package.

# %%
record = st.datasets.load("certified/three_frictions_1e-3")  # or st.read_record("your_file.csv")
decay = st.free_decay(record, window=(None, 12.0 if QUICK else None))
st.show(st.look(decay))

# %% [markdown]
# ## The forces
#
# Two methods identify the contact forces of the paper, of which `nu` and `epsilon` do not act here. The
# first sentence of the answer says whether the model explains the record. If it does not, the
# coefficients are effective values, not those of forces.

# %%
tree = st.identify(decay, "contact_forces")
st.show(tree)

# %%
st.plots.overview(tree)

# %% [markdown]
# `st.report(tree, "sample.html")` writes all of this to one page that you can send. The same table as a
# DataFrame is `st.summary(tree)`; `st.summary(tree).to_csv("sample.csv")` saves it.
#
# ## Against the truth
#
# Skip this cell for your own record, which has no known truth. For this one the table shows the error of
# each coefficient over its standard error: about 95 % of them are between -2 and 2.

# %%
best = st.best(tree)
truth = st.datasets.truth("certified/three_frictions_1e-3")
table = best[["coefficient", "standard_error"]].to_dataframe()[["coefficient", "standard_error"]]
table["truth"] = truth.value.to_series().reindex(table.index).fillna(0.0)  # nu and epsilon do not act
table["error / standard error"] = (table.coefficient - table.truth) / table.standard_error
table

# %% [markdown]
# ## As moments in SI units
#
# A coefficient has no unit, or that of an angle. Multiplied by the moment of inertia it becomes a moment.
# For an inertia of (0.0120 ± 0.0002) kg m²:

# %%
moments = st.physics.in_si_units(best, inertia=(0.0120, 0.0002))
moments[["coefficient", "standard_error", "unit"]].to_dataframe()[["coefficient", "standard_error", "unit"]]

# %% [markdown]
# ## Without a choice of forces
#
# If no list of forces explains your record, identify the friction as a curve against speed and the
# restoring force as a curve against displacement. Each has a band that holds the whole curve with 95 %.

# %%
curves = st.laws(decay)
st.plots.laws(curves)

# %%
law = st.best(curves)
fastest = float(np.abs(law.speed.where(law.speed_visited)).max())
display(st.show(curves))
print(f"The record visits speeds up to {fastest:.2f} rad/s; the curves beyond are extrapolations.")
