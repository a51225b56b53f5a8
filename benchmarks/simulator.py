"""The simulator against scipy restarted at every switching, on the run of the paper, in the same process.

Then forces with memory, a stop, and a motion that sticks and goes on, beside the package's scipy engine.
Times are medians of processor time.

python benchmarks/simulator.py
"""

import sys
from importlib import import_module
from pathlib import Path
from time import process_time

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from reference_motion import reference_motion  # noqa: E402
from stopwatch import median_ms, timed  # noqa: E402

from sysid_trib import ForceLibrary, Model, load_library  # noqa: E402
from sysid_trib.simulation.simulate import simulate, trajectory  # noqa: E402

PAPER = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
W = 9.91
# What is added to the paper's forces, and the strength of dry friction.
MORE = {
    "jenkins": ({"jenkins": 0.01}, PAPER["lambda"]),
    "iwan": ({"iwan": 0.01}, PAPER["lambda"]),
    "partial_slip": ({"partial_slip": 0.01}, PAPER["lambda"]),
    "dahl": ({"dahl": 0.001}, PAPER["lambda"]),
    "friction_drift, stops": ({"friction_drift": 0.003}, 1e-4),
    "ambient, sticks and goes on": ({"ambient": 0.05}, 0.02),
}


def main():
    print(f"import of heyoka        {1e3 * timed(lambda: import_module('heyoka'), process_time)[1]:8.1f} ms")
    model = Model(load_library("contact_forces"), PAPER, W)
    _, first = timed(lambda: trajectory(model, np.linspace(0.0, 25.0, 2501)), process_time)
    print(f"first call (compiling)  {1e3 * first:8.1f} ms")
    for count in (2501, 25_001):
        grid = np.linspace(0.0, 25.0, count)
        exact = reference_motion(PAPER, W, grid, rtol=3e-14)
        peer = median_ms(lambda grid=grid: reference_motion(PAPER, W, grid, rtol=1e-9), 7, process_time)
        peer_error = np.abs(reference_motion(PAPER, W, grid, rtol=1e-9) - exact).max()
        print(f"{count} samples\n  scipy, rtol 1e-9      {peer:8.2f} ms  error {peer_error:.1e} rad")
        for function, repeats in ((trajectory, 101), (simulate, 101)):
            ours = median_ms(lambda f=function, grid=grid: f(model, grid), repeats, process_time)
            error = np.abs(np.asarray(function(model, grid).angle) - exact).max()
            name = function.__name__
            print(f"  {name:<21} {ours:8.2f} ms  error {error:.1e} rad  {peer / ours:5.0f} times faster")
    grid = np.linspace(0.0, 25.0, 2501)
    print("2501 samples, further forces")
    for name, (coefficients, friction) in MORE.items():
        further(name, coefficients, friction, grid)


def further(name, coefficients, friction, grid):
    """One row: the paper's forces and further ones, by heyoka and by scipy."""
    effects = load_library("candidate_effects").select(coefficients)
    library = ForceLibrary("further forces", (*load_library("contact_forces"), *effects))
    model = Model(library, PAPER | {"lambda": friction} | coefficients, W)
    motion, peer = timed(lambda: trajectory(model, grid, engine="scipy"), process_time)
    exact = motion.angle
    ours = median_ms(lambda: trajectory(model, grid), 31, process_time)
    error = np.abs(trajectory(model, grid).angle - exact).max()
    print(f"  {name:<28} {ours:8.2f} ms  scipy {1e3 * peer:8.1f} ms  difference {error:.1e} rad")


if __name__ == "__main__":
    main()
