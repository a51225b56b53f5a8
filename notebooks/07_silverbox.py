# %% [markdown]
# # Silverbox: from a signal to named forces
#
# An electronic circuit behaves as a mass on a hardening spring, driven by a voltage (Wigren and Schoukens
# 2013). The input has random phases, and there is no free decay. The model begins linear, and each further
# force has a name. Five realisations train it. The sixth is not used in any fit and tests the model.
#
# The record is not part of this repository: `st.datasets` reads it from the folder that `SYSID_TRIB_DATA`
# names, or downloads it. Published errors of this
# benchmark refer to another part, in which the drive grows beyond the training; do not compare them with
# those below.

# %%
import os
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import tables
import xarray as xr
from IPython.display import display

import sysid_trib as st

# %matplotlib inline
QUICK = os.environ.get("SYSID_TRIB_QUICK") == "1"  # one realisation in training, fewer models
record = tables.available("silverbox")

# %% [markdown]
# ## The record
#
# The column V1 is the input u of formulas. It is smooth between its samples, because it was
# measured without aliasing. A realisation has 8,700 samples.

# %%
SAMPLES, REALISATIONS = 8700, 5
if record is not None:
    end = REALISATIONS * SAMPLES
    train = record.isel(time=slice((REALISATIONS - 1) * SAMPLES if QUICK else 0, end))
    test = record.isel(time=slice(end, None))
    print(record.u.attrs["units"], train.sizes["time"], test.sizes["time"])

# %% [markdown]
# ## Forces, one after the other
#
# The first model has gain and viscous damping, a linear oscillator whose frequency is fitted as well. Then
# follow the cubic spring, for which the circuit was built, an even part, and three small forces: quadratic
# and dry friction and a fifth power of the displacement. The forces were chosen on these six realisations.

# %%
known = {
    force.symbol: force
    for name in ("candidate_effects", "contact_forces", "inputs")
    for force in st.load_library(name)
}
LADDER = ["gain zeta", "epsilon", "even_spring", *([] if QUICK else ["delta", "lambda", "quintic"])]


def library_of(symbols: list[str]) -> st.forces.ForceLibrary:
    return replace(st.load_library("inputs"), forces=tuple(known[symbol] for symbol in symbols))


def z_of(result: xr.Dataset, symbol: str) -> float:
    one = result.sel(force=symbol)
    return (one.coefficient / one.standard_error).item()


results, predictions, rows = [], [], []
if record is not None:
    for at, added in enumerate(LADDER):
        symbols = " ".join(LADDER[: at + 1]).split()
        result = st.identify(train, library_of(symbols), st.methods.Direct(random_force="off"))
        seen, unseen = (st.validation.predict(result, part) for part in (train, test))
        results.append(result)
        predictions.append(unseen)
        rows.append(
            {
                "added": added,
                "formula": ", ".join(known[symbol].formula.text for symbol in added.split()),
                "parameters": len(symbols) + 1,
                "coefficient over its error": ", ".join(f"{z_of(result, s):.3g}" for s in added.split()),
                "training (mV)": f"{1e3 * seen.residual_rms.item():.3f}",
                "last realisation (mV)": f"{1e3 * unseen.residual_rms.item():.3f}",
                "of the motion (%)": f"{100.0 * unseen.residual_over_motion.item():.2f}",
            }
        )
    display(pd.DataFrame(rows))

# %% [markdown]
# The predictions are free runs: the model knows the input and the start of the motion, and no output after
# that. Most of the residual of the linear model is the cubic spring. Each further force reduces the
# residual of the last realisation as it does in training.

# %%
if record is not None:
    figure, axes = plt.subplots(figsize=(7.0, 3.0))
    for row, unseen in list(zip(rows, predictions, strict=True))[:: len(rows) - 1]:
        axes.plot(unseen.time, 1e3 * unseen.residual, linewidth=0.5, label=f"{row['parameters']} parameters")
    axes.plot(test.time, 1e3 * test.angle, color="0.8", linewidth=0.5, label="record", zorder=0)
    axes.set(xlabel="time (s)", ylabel="record \N{MINUS SIGN} model (mV)")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.legend(ncols=3)
    plt.close(figure)
    display(figure)

# %% [markdown]
# ## The preferred result, and two methods
#
# Coefficients are in the units of the circuit: the cubic one in V^-2. The residual is more than noise.
# Therefore the errors include its correlation, and the coefficients are effective values of an incomplete
# model.

# %%
if record is not None:
    last = results[-1]
    print(f"w = {last.reference_frequency.item() / (2.0 * np.pi):.4f} * 2 pi rad/s")
    display(
        last[["coefficient", "standard_error", "unit"]].to_dataframe()[
            ["coefficient", "standard_error", "unit"]
        ]
    )

# %% [markdown]
# `Direct` uses the equation of motion row by row, `Trajectory` uses the free run. This is the model of
# five parameters by both:

# %%
if record is not None:
    part = train.isel(time=slice(SAMPLES if QUICK else 2 * SAMPLES))
    methods = [kind(random_force="off") for kind in (st.methods.Direct, st.methods.Trajectory)]
    tree = st.identify(part, library_of(["gain", "zeta", "epsilon", "even_spring"]), methods)
    compared = tree["agreement"].ds
    print(tree["judged"].attrs["verdict"], tree["judged"].residual_over_motion.values)
    if "difference" in compared:
        display(compared[["difference", "standard_error", "z"]].to_dataframe())
    display(st.plots.overview(tree))
