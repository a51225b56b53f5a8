# %% [markdown]
# # Six contact forces
#
# Draft.

# %%
import os

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # fewer ... (every notebook has this line)

# %%
library = st.load_library("contact_forces")
