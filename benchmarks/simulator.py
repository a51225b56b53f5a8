"""The simulator against scipy restarted at every switching, on the run of the paper, in the same process.

Then forces with memory, a stop, and a motion that sticks and goes on, beside the package's scipy engine.
Times are medians of processor time.

python benchmarks/simulator.py
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from reference_motion import reference_motion  # noqa: E402

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


def median_ms(function, repeats):
    """Median time of a call in ms, the first call not counted."""
    function()
    spent = []
    for _ in range(repeats):
        begin = time.process_time()
        function()
        spent.append(time.process_time() - begin)
    return 1e3 * float(np.median(spent))


def main():
    begin = time.process_time()
    import heyoka  # noqa: F401

    print(f"import of heyoka        {1e3 * (time.process_time() - begin):8.1f} ms")
    model = Model(load_library("contact_forces"), PAPER, W)
    begin = time.process_time()
    trajectory(model, np.linspace(0.0, 25.0, 2501))
    print(f"first call (compiling)  {1e3 * (time.process_time() - begin):8.1f} ms")
    for count in (2501, 25_001):
        grid = np.linspace(0.0, 25.0, count)
        exact = reference_motion(PAPER, W, grid, rtol=3e-14)
        peer = median_ms(lambda grid=grid: reference_motion(PAPER, W, grid, rtol=1e-9), 7)
        peer_error = np.abs(reference_motion(PAPER, W, grid, rtol=1e-9) - exact).max()
        print(f"{count} samples\n  scipy, rtol 1e-9      {peer:8.2f} ms  error {peer_error:.1e} rad")
        for function, repeats in ((trajectory, 101), (simulate, 101)):
            ours = median_ms(lambda f=function, grid=grid: f(model, grid), repeats)
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
    begin = time.process_time()
    exact = trajectory(model, grid, engine="scipy").angle
    peer = 1e3 * (time.process_time() - begin)
    ours = median_ms(lambda: trajectory(model, grid), 31)
    error = np.abs(trajectory(model, grid).angle - exact).max()
    print(f"  {name:<28} {ours:8.2f} ms  scipy {peer:8.1f} ms  difference {error:.1e} rad")


if __name__ == "__main__":
    main()
