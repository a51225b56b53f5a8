# %% [markdown]
# # Two samples: do they differ, and in which force?
#
# You measured two samples on the same rig. This notebook says which coefficients differ, by how much, and
# how long the next run must be to see a difference of a given size. It takes a minute.

# %%
import os

import numpy as np

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # one run a sample instead of two

# %% [markdown]
# ## The records
#
# Two samples with two runs each. They are simulated from the certified decay `paper_six`: the second
# sample has 1 % more viscous friction (`zeta`), and nothing else differs. With your own files:
# `new = [st.free_decay(st.read_record(name)) for name in ("new_1.csv", "new_2.csv")]`.

# %%
certified = st.datasets.truth("certified/paper_six_1e-3")
FORCES = st.load_library("contact_forces")
TRUTH = certified.value.sel(quantity=list(FORCES.symbols)).to_series().to_dict()
w = certified.reference_frequency.item()


def run(changes, seed):
    """One run of 25 s at 100 Hz from 0.3 rad, with a noise of 0.2 mrad."""
    time = np.arange(2500) / 100.0
    motion = st.simulate(st.Model(FORCES, TRUTH | changes, w), time, angle=0.3)
    return st.free_decay(
        (time, motion.angle.values + 2e-4 * np.random.default_rng(seed).standard_normal(2500))
    )


RUNS = 1 if QUICK else 2
new = [run({}, seed) for seed in range(RUNS)]
worn = [run({"zeta": 1.01 * TRUTH["zeta"]}, seed) for seed in range(10, 10 + RUNS)]

# %% [markdown]
# ## The difference
#
# Runs of one sample are identified together. The answer names the coefficients that differ; a correction
# for the number of comparisons is included.

# %%
contrast = st.difference(new, worn, "contact_forces")
st.show(contrast)

# %%
st.plots.difference(contrast)

# %% [markdown]
# ## Without a choice of forces
#
# The friction curves of both samples, and their difference with a band. The band excludes zero where the
# samples differ.

# %%
first, second = st.laws(new[0]), st.laws(worn[0])
curves = st.physics.law_difference(first, second)
st.plots.law_difference(curves)

# %% [markdown]
# ## Which run next?
#
# `plan` computes, before any further measurement, what other runs of the same rig would reach.

# %%
planned = st.plan(st.identify(new, "contact_forces"))
st.show(planned)
