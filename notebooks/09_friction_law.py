# %% [markdown]
# # From a record to a friction law
#
# A bob on a string was filmed while it swung. No sum of a few named forces explains the record. This
# notebook identifies its friction as a curve against speed, with a band, and the restoring force as a
# curve against displacement. No formula is chosen.
#
# The record is not part of this repository. `st.datasets` reads it from the folder that `SYSID_TRIB_DATA`
# names, or downloads it from its public source, and checks it.

# %%
import os

import numpy as np
import tables
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # a shorter record
record = tables.available("string_pendulum")

# %% [markdown]
# ## A simulated record first
#
# Its friction law is known, but the method does not get the forces that made the record.

# %%
library = st.load_library("contact_forces")
model = st.Model(library, {"zeta": 0.01, "delta": 0.03, "epsilon": 0.2}, 9.0)
time = np.arange(0.0, 12.0 if QUICK else 30.0, 0.02)
motion = st.simulate(model, time, 0.3)
noise = 1e-4 * np.random.default_rng(0).standard_normal(len(time))
simulated = st.laws(motion.assign(angle=motion.angle + noise))
display(st.plots.laws(simulated))

# %%
law = st.best(simulated)
seen = law.isel(speed=np.flatnonzero(law.speed_visited.values))
v = seen.speed.values / 9.0
truth = 9.0**2 * (2.0 * 0.01 * v + 0.03 * v * np.abs(v))
inside = (seen.friction_low.values <= truth) & (truth <= seen.friction_high.values)
print(f"The band holds the true law at {inside.sum()} of {len(v)} visited speeds.")

# %% [markdown]
# ## The filmed string
#
# With the named forces of a pendulum the residual is several times the noise.

# %%
if record is not None:
    window = (None, 15.0) if QUICK else (None, None)
    decay = st.free_decay(record, window=window)
    print(decay.attrs["free_decay"])
    tree = st.laws(decay, "pendulum")
    judged = tree["judged"].ds
    print(f"Preferred: {judged.attrs['preferred']}. {judged.attrs['reason']}")
    print(f"Residual over the noise: {judged.residual_over_noise.to_series().round(2).to_dict()}")
    display(st.plots.laws(tree))

# %% [markdown]
# The record does not visit the grey part; dashed lines there are extrapolations. The restoring force is
# shown without the straight line and without gravity, which `pendulum` holds. The rest comes from the
# sensor or the string.
#
# The numbers of the figure, as a table that can be published:

# %%
if record is not None:
    best = st.best(tree)
    table = best[["friction", "friction_standard_error", "friction_low", "friction_high"]].to_dataframe()
    display(table.assign(visited=best.speed_visited.values).iloc[::5])

# %% [markdown]
# ## In SI units
#
# The laws are forces over the inertia. Multiplied by the moment of inertia they are torques; divided by
# the load and the radius of a contact these are coefficients of friction. For example, a bob of 0.2 kg on
# a string of 0.66 m:

# %%
if record is not None:
    mass, length = 0.2, 0.66
    torque = mass * length**2 * best.friction.values
    at = np.argmin(np.abs(best.speed.values - 1.5))
    print(f"At {best.speed.values[at]:.2f} rad/s the friction is {1e3 * torque[at]:.3g} mN m.")
