"""Bands and errors of the laws on simulated records of laws in no library, and of the paper's six forces.

python -m benchmarks laws [--seeds N] [--only stribeck]

40 s at 100 Hz from 0.3 rad at 9 rad/s, white noise of 3e-4, 1e-3 and 3e-3 of the amplitude. In percent of
the seeds: the simultaneous 95 % band holds everywhere in the visited range, of friction and of the restoring
force; median relative error of the friction over its visited speeds; processor time.
"""

import time
from argparse import Namespace
from functools import partial

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks.study.common import over_seeds, shown, timed
from sysid_trib.forces.library import parse_library

W, RELEASE, NOISES = 9.0, 0.3, (3e-4, 1e-3, 3e-3)
# Friction and restoring force beyond the straight line, as formulas over w^2.
KINDS = {
    "stribeck": ("1.2e-3*(0.5 + exp(-(v/0.04)**2))*sign(v) + 0.008*v", "-0.15*x**3"),
    "saturating drag": ("3e-4*sign(v) + 0.05*v*abs(v)/(1 + abs(v)/0.1)", "0.02*tanh(x/0.08)"),
    "hardening, softening": ("2e-4*sign(v) + 0.008*v + 0.01*sign(v)*abs(v)**1.5", "0.5*x**3 - 4*x**5"),
    "asymmetric friction": ("3e-4*sign(v) + 0.01*v + 0.01*abs(v) + 0.02*v**2/(1 + abs(v)/0.1)", "-0.1*x**3"),
    "the paper's forces": ("3e-4*sign(v) + 0.0097*v + 0.037*v*abs(v)", "-0.4*x*abs(x) + 0.3*x**3"),
}


def simulated(kind: str) -> tuple[xr.Dataset, st.forces.ForceLibrary]:
    """The motion of a kind without noise, and its two forces."""
    friction, restoring = KINDS[kind]
    rows = [{"symbol": "friction", "formula": friction}, {"symbol": "restoring", "formula": restoring}]
    library = parse_library({"force": rows}, kind)
    model = st.Model(library, {"friction": 1.0, "restoring": 1.0}, W)
    return st.simulate(model, np.arange(0.0, 40.0, 0.01), angle=RELEASE)[["angle"]], library


def law_held(kind: str, clean: xr.Dataset, library: st.forces.ForceLibrary, noise: float, seed: int) -> dict:
    """Return whether the bands of the preferred method contain the true laws; errors and time."""
    draw = np.random.default_rng(seed).standard_normal(clean.sizes["time"])
    decay = st.free_decay(clean.assign(angle=clean.angle + noise * RELEASE * draw))
    tree, seconds = timed(lambda: st.laws(decay), time.process_time)
    result, found = (
        st.best(tree),
        {"seconds": seconds, "direct": tree["judged"].attrs["preferred"] == "direct"},
    )
    for law, variable, symbol in (
        ("friction", "speed", "friction"),
        ("restoring", "displacement", "restoring"),
    ):
        part = result.isel({variable: np.flatnonzero(result[f"{variable}_visited"].values)})
        places = part[variable].values
        x, v = (0.0 * places, places / W) if variable == "speed" else (places, 0.0 * places)
        truth = W**2 * (x + library[symbol].value(x, v))
        inside = (part[f"{law}_low"].values <= truth) & (truth <= part[f"{law}_high"].values)
        error = np.abs(part[law].values - truth) / np.maximum(np.abs(truth), 1e-300)
        found[law] = (bool(inside.all()), float(inside.mean()), float(np.median(error)))
    return found


def laws(asked: Namespace) -> None:
    table = []
    for kind in (kind for kind in KINDS if asked.only in kind):
        clean, library = simulated(kind)
        for noise in NOISES:
            one = partial(law_held, kind, clean, library, noise)
            rows = over_seeds(asked, one, case=f"{kind}, {noise:g}")
            cells = [kind, f"{noise:g}"]
            for law in ("friction", "restoring"):
                whole, pointwise, error = np.mean([row[law] for row in rows], axis=0)
                cells.append(f"{100 * whole:.0f} ({100 * pointwise:.0f}), {100 * error:.3f} %")
            cells += [f"{100 * np.mean([row['direct'] for row in rows]):.0f}"]
            table.append([*cells, f"{np.mean([row['seconds'] for row in rows]):.1f}"])
    heads = ("law", "noise", "friction: whole % (pointwise %), error", "restoring", "direct preferred %", "s")
    shown("", heads, table, 140)
