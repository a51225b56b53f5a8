"""Coverage of the simultaneous 95 % bands of the backbone, over 12 kinds of forces.

python -m benchmarks backbone [--seeds N] [--only ripple]

80 periods of 50 samples, white, coloured (autoregressive, 0.8) and rounded noise (0.5 mrad; a step of 2 mrad)
in turn, with the sensor's noise alone and with a random force of 1e-6 (rad/s^2)^2/Hz. True is the backbone of
the model's motion without noise and random force, by the same definition, at its own periods. Beside it:
pointwise coverage, the median half width, and processor time. Half of the kinds are in no library.
"""

import time
from argparse import Namespace
from functools import partial

import numpy as np
import xarray as xr
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter

import sysid_trib as st
from benchmarks.study.common import over_seeds, shown, timed
from sysid_trib.cycles.backbone import CURVES, half_width, period_rows
from sysid_trib.forces.library import parse_library

W, PERIODS, PER_PERIOD, NOISE, STEP, COLOUR, RANDOM_FORCE = 2.0 * np.pi, 80, 50, 5e-4, 2e-3, 0.8, 1e-6
JENKINS = {
    "formula": "max(-s, min(s, zr + x - xr))",
    "memory": {"xr": "x", "zr": "max(-s, min(s, zr + x - xr))"},
    "start": {"xr": "x", "zr": "0"},
    "shape": {"s": {"default": 0.02, "low": 1e-4, "high": 0.5, "meaning": "slip length"}},
}
# Formulas with coefficients, and the angle of the release.
KINDS = {
    "dry, viscous": ({"sign(v)": 1e-3, "2*v": 3e-3}, 0.3),
    "drag, softening": ({"2*v": 2e-3, "v*abs(v)": 0.03, "x**3": -0.15}, 0.6),
    "pendulum": ({"sin(x) - x": 1.0, "sign(v)": 1e-3, "2*v": 2e-3, "v*abs(v)": 0.02}, 1.2),
    "stribeck": ({"exp(-(v/.08)**2)*sign(v)": 1e-3, "2*v": 4e-3}, 0.4),
    "freeplay": ({"max(0, abs(x) - .12)*sign(x)": 0.4, "2*v": 5e-3}, 0.5),
    "jenkins": ({"jenkins": 0.15, "2*v": 2e-3}, 0.4),
    "soft wall": ({"max(0, abs(x) - .2)**2*sign(x)": 6.0, "2*v": 5e-3}, 0.45),
    "ripple": ({"sin(25*x)/25": 0.12, "2*v": 4e-3}, 0.5),
    "rough friction": ({"(1 + cos(20*x))*sign(v)": 1e-3, "2*v": 3e-3}, 0.5),
    "saturating damping": ({"2*v/(1 + abs(v)/.1)": 0.012, "x*abs(x)": 0.1}, 0.5),
    "bump of damping": ({"exp(-((abs(x) - .2)/.05)**2)*v": 0.02, "2*v": 4e-3}, 0.5),
    "two-slope spring": ({"x/(1 + (x/.1)**2)": 0.1, "v**3": 0.05, "2*v": 3e-3}, 0.5),
}


def motion(kind: str, random_force: float = 0.0, seed: int = 0) -> xr.Dataset:
    """The angle of a kind's motion."""
    forces, start = KINDS[kind]
    rows = [
        {"symbol": f"f{at}"} | (JENKINS if formula == "jenkins" else {"formula": formula})
        for at, formula in enumerate(forces)
    ]
    coefficients = {f"f{at}": value for at, value in enumerate(forces.values())}
    model = st.Model(parse_library({"force": rows}, kind), coefficients, W)
    clock = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
    return st.simulate(model, clock, angle=start, random_force=random_force, seed=seed)[["angle"]]


def measured(clean: xr.Dataset, seed: int) -> xr.Dataset:
    """A decay in white, coloured or rounded noise, by the seed."""
    noise = NOISE * np.random.default_rng([seed, 3]).standard_normal(clean.sizes["time"])
    if seed % 3 == 1:
        noise = lfilter([np.sqrt(1.0 - COLOUR**2)], [1.0, -COLOUR], noise)
    angle = clean.angle + (0.3 if seed % 3 == 2 else 1.0) * noise
    if seed % 3 == 2:
        angle = STEP * np.round(angle / STEP)
    return st.free_decay(clean.assign(angle=angle.assign_attrs(clean.angle.attrs)))


def coverage(curves: xr.Dataset, truth: xr.Dataset) -> dict[str, tuple[bool, float, float]]:
    """Return whether each curve is inside the band, the part within 1.96 errors, the median half width."""
    u = truth.log_amplitude.values
    along = np.log(curves.amplitude.values)
    inside = (u >= along[0]) & (u <= along[-1])
    found = {}
    for name in CURVES:
        half, error = half_width(curves, name), curves[f"{name}_standard_error"].values
        apart = np.abs(PchipInterpolator(along, curves[name])(u[inside]) - truth[name].values[inside])
        pointwise = np.mean(apart < 1.96 * np.interp(u[inside], along, error))
        whole = bool(np.all(apart <= np.interp(u[inside], along, half)))
        found[name] = whole, float(pointwise), float(np.median(half))
    return found


def truth_of(clean: xr.Dataset) -> xr.Dataset:
    """The single periods of a motion without noise, by amplitude."""
    u, rows = period_rows(st.records.envelope(st.free_decay(clean)))
    values = {"log_amplitude": u} | {name: rows[name][0] for name in CURVES}
    return xr.Dataset({name: ("period", of_rows) for name, of_rows in values.items()}).sortby("log_amplitude")


def cells(results: list[dict]) -> list[str]:
    """Return the cells of both curves of a kind: whole, pointwise, half width."""
    texts = []
    for name in CURVES:
        whole, pointwise, half = np.mean([result[name] for result in results], axis=0)
        texts.append(f"{100 * whole:.0f} ({100 * pointwise:.0f}) {half:.1e}")
    return texts


def held(kind: str, clean: xr.Dataset, truth: xr.Dataset, density: float, seed: int) -> dict:
    """Return the coverage of the bands of one record, and their time."""
    decay = measured(motion(kind, density, seed) if density else clean, seed)
    curves, seconds = timed(lambda: st.backbone(decay), time.process_time)
    return coverage(curves, truth) | {"seconds": seconds}


def backbone(asked: Namespace) -> None:
    table, every = [], {0.0: [], RANDOM_FORCE: []}
    for kind in (kind for kind in KINDS if asked.only in kind):
        clean, row = motion(kind), [kind]
        for density, results in every.items():
            one = partial(held, kind, clean, truth_of(clean), density)
            rows = over_seeds(asked, one, case=f"{kind}, {density:g}")
            row += cells(rows)
            results += rows
        table.append([*row, f"{1e3 * np.mean([each['seconds'] for each in rows]):.0f}"])
    table.append(["all", *(cell for rows in every.values() for cell in cells(rows)), ""])
    heads = [f"{name}{tail}" for tail in ("", ", random force") for name in CURVES]
    shown("", ("simultaneous % (pointwise %) half width", *heads, "ms"), table, 140)
