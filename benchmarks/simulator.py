"""The simulator against scipy restarted at every switching, on the run of the paper, in the same process.

Then its derivatives over the motion alone, identifications, driven motions, what is lost over 10,000 periods,
forces with memory and a motion that sticks and goes on. Times are medians of processor time.

python -m benchmarks simulator
"""

from argparse import Namespace
from dataclasses import replace
from time import process_time

import numpy as np
from helpers import FIVE, paper_run
from scipy_motion import reference_motion

from benchmarks.blind.effects import make
from benchmarks.blind.generator import Oscillator, motion
from benchmarks.stopwatch import median_ms, timed
from sysid_trib import Model, load_library
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation.motions import BY_ANGLE, BY_RATE
from sysid_trib.simulation.simulate import simulate, trajectory

PAPER = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
W = 9.91
SIX = load_library("contact_forces")
GRID = np.linspace(0.0, 25.0, 2501)
# What is added to the paper's forces, and the strength of dry friction.
MORE = {
    "jenkins": ({"jenkins": 0.01}, PAPER["lambda"]),
    "iwan": ({"iwan": 0.01}, PAPER["lambda"]),
    "partial_slip": ({"partial_slip": 0.01}, PAPER["lambda"]),
    "dahl": ({"dahl": 0.001}, PAPER["lambda"]),
    "friction_drift, stops": ({"friction_drift": 0.003}, 1e-4),
    "ambient, sticks and goes on": ({"ambient": 0.05}, 0.02),
}


def main(asked: Namespace) -> None:
    _, loading = timed(lambda: trajectory(Model(SIX, PAPER, W), GRID[:3]), process_time)
    print(f"first call (loads the engine, or compiles it)  {loading:8.2f} s")
    for friction in (PAPER["lambda"], 1e-3):
        of_the_paper(PAPER | {"lambda": friction})
    identified()
    driven()
    conserved()
    print("further forces")
    for name, (coefficients, friction) in MORE.items():
        further(name, coefficients, friction)


def of_the_paper(coefficients):
    """The paper's run: time over scipy's, errors, and the derivatives over the motion alone."""
    model, by = Model(SIX, coefficients, W), (*coefficients, BY_ANGLE, BY_RATE)
    exact = reference_motion(coefficients, W, GRID, rtol=3e-14)
    peer = median_ms(lambda: reference_motion(coefficients, W, GRID, rtol=1e-10), 5, process_time)
    print(f"lambda = {coefficients['lambda']:g}: scipy, rtol 1e-10  {peer:8.2f} ms")
    for function in (trajectory, simulate):
        ours = median_ms(lambda f=function: f(model, GRID), 101, process_time)
        error = np.abs(np.asarray(function(model, GRID).angle) - exact).max()
        name = function.__name__
        print(f"  {name:<12} {ours:8.2f} ms  error {error:.1e} rad  {peer / ours:5.0f} times faster")
    plain = median_ms(lambda: trajectory(model, GRID), 101, process_time)
    whole = median_ms(lambda: trajectory(model, GRID, by=by), 31, process_time)
    print(f"  with {len(by)} derivatives {whole:.2f} ms, {whole / plain:.1f} times the motion")


def identified():
    """Identifications of the paper's run with the sensor's noise alone, over scipy's motion."""
    peer = median_ms(lambda: reference_motion(PAPER, W, GRID, rtol=1e-10), 5, process_time)
    decay = paper_run().decay(0)
    for method in (Direct, Averaging, Trajectory):
        ours = median_ms(
            lambda m=method: m(random_force="off").identify(decay, SIX.select(FIVE)), 5, process_time
        )
        print(f"  {method.__name__:<12} {ours:8.2f} ms, {ours / peer:.2f} of scipy's motion")


def driven():
    """Motions that an input drives: 2,501 samples with stick and slip, 131,072 of a Duffing oscillator."""
    push = W**2 * (0.2 * np.sin(0.7 * W * GRID) + 0.05 * np.sin(1.7 * W * GRID))
    for name, coefficients in (
        ("stick and slip", {"lambda": 0.15, "zeta": 0.01}),
        ("without", {"zeta": 0.01}),
    ):
        model = replace(Model(SIX, coefficients, W), inputs={"input": KnownInput(GRID, push)})
        stuck = np.mean(trajectory(model, GRID, 0.0).rate == 0.0)
        ours = median_ms(lambda m=model: trajectory(m, GRID, 0.0), 31, process_time)
        print(f"driven, {name}: 2,501 samples {ours:.2f} ms, {100 * stuck:.0f} % at rest")
    time, w = np.arange(131_072) / 610.35, 2.0 * np.pi * 68.0
    push = 0.1 * w**2 * np.random.default_rng(0).standard_normal(len(time))
    model = Model(SIX, {"zeta": 0.023, "epsilon": 0.3}, w, inputs={"input": KnownInput(time, push)})
    ours = median_ms(lambda: trajectory(model, time), 3, process_time)
    print(f"driven Duffing, 131,072 samples: {ours:.0f} ms")


def conserved():
    """What is lost over 10,000 periods without friction, and by dry friction in each half period."""
    model = Model(SIX, {"alpha": 0.2, "nu": -0.4, "epsilon": 0.3}, W)
    found = trajectory(model, np.linspace(0.0, 20_000 * np.pi / W, 20_001), 0.3, 1.0)
    x, v = found.angle, found.rate / W
    energy = v**2 / 2 + 0.6 * x**2 - 0.4 * np.abs(x) ** 3 / 3 + 0.3 * x**4 / 4
    print(f"energy over 10,000 periods: {np.abs(energy / energy[0] - 1.0).max():.1e} of it")
    dry = Model(SIX, {"lambda": 0.003}, W)
    turned = trajectory(dry, np.concatenate([[0.0], trajectory(dry, GRID).reversals])).angle
    lost = np.abs(np.abs(turned) - (0.3 - 0.006 * np.arange(len(turned)))).max()
    print(f"dry friction: 2 lambda a half period to {lost:.1e} rad")


def further(name, coefficients, friction):
    """One row: the paper's forces and further ones, beside the generator of the blind records."""
    effects = load_library("candidate_effects").select(coefficients)
    library, base = ForceLibrary("further forces", (*SIX, *effects)), PAPER | {"lambda": friction}
    model, step = Model(library, base | coefficients, W), W * GRID[1]
    shapes = {symbol: {k: s.default for k, s in effects[symbol].shape.items()} for symbol in coefficients}
    made = [(make(symbol, shapes[symbol]), c) for symbol, c in coefficients.items()]
    parts = 4 * max(effect.parts for effect, _ in made)
    exact, peer = timed(lambda: motion(Oscillator(W, base), made, 0.3, step, len(GRID), parts), process_time)
    ours = median_ms(lambda: trajectory(model, GRID), 31, process_time)
    error = np.abs(trajectory(model, GRID).angle - exact.x).max()
    print(f"  {name:<28} {ours:8.2f} ms  generator {1e3 * peer:8.1f} ms  difference {error:.1e} rad")
