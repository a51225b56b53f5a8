"""How often the 95 % bands of predictions 1, 3 and 10 periods ahead hold what is then measured.

python benchmarks/prediction_bands.py [--records N] [--method direct|trajectory] [--measured]

Each model is identified from the first two thirds of a record. From instants in the last third, which it has
not seen, the record is predicted from the samples up to then; predictions of one horizon do not overlap.
Simulated: 60 periods from 0.3 rad at 60 samples a period in noise of 0.2 mrad, pushed until they have
wandered by 1, 5 or 20 noise levels, by tests/kicked_motion.py, which shares nothing with the package.
--measured: the records of random_force_kinds.py. Beside coverage: the RMS error over the stated one.
Of measured records also the p-value of a random force that depends on nothing: where that is small, the model
is not the record's, and its bands promise nothing. And how errors of neighbouring windows one period ahead go
together: those of a random force do not.
"""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from kicked_motion import kicked_motion, smooth_forces  # noqa: E402
from random_force_kinds import BOTH, RECORDS  # noqa: E402

import sysid_trib as st  # noqa: E402
from sysid_trib.errors import SysidTribError  # noqa: E402
from sysid_trib.likelihood.random_force import RandomForce, random_force_of  # noqa: E402
from sysid_trib.validation.holdout import first_held_out  # noqa: E402

W, NOISE, PERIODS, PER_PERIOD, ANGLE = 8.87, 2e-4, 60, 60, 0.3
FRICTION, TRUTH = 2e-4, {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
WANDERS = (1.0, 5.0, 20.0)
HORIZONS = (1, 3, 10)
METHODS = {
    "direct": st.methods.Direct(random_force="estimated"),
    "trajectory": st.methods.Trajectory(random_force="estimated"),
}


def simulated(wander: float, seeds: Iterable[int]) -> list[xr.Dataset]:
    """Records of a known model."""
    time = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * time[-1]), W)
    seeds = list(seeds)
    motions, _ = kicked_motion(time, W, smooth_forces(TRUTH), FRICTION, density, seeds, start=(ANGLE, 0.0))
    noise = [NOISE * np.random.default_rng([seed, 5]).standard_normal(len(time)) for seed in seeds]
    return [xr.Dataset({"angle": ("time", a)}, {"time": time}) for a in motions + np.array(noise)]


def errors_ahead(decay: xr.Dataset, library: st.forces.ForceLibrary, method) -> dict[int, np.ndarray]:
    """Errors over the stated ones of the predictions of each horizon, of one record."""
    time = decay.time.values.astype(float)
    first = first_held_out(time)
    result = st.identify(decay.isel(time=slice(0, first)), library, method)
    period = 2.0 * np.pi / float(result.reference_frequency)
    errors = {}
    for ahead in HORIZONS:
        origins = np.arange(time[first], time[-1] - ahead * period, ahead * period)
        if len(origins):
            bands = st.validation.prediction_bands(decay, result, [ahead], origins=list(origins))
            z = ((bands.measured - bands.predicted) / bands.predicted_standard_error).values.ravel()
            errors[ahead] = z[np.isfinite(z)]
    return errors


def dependence(decay: xr.Dataset, library: st.forces.ForceLibrary, method) -> float:
    """p-value of a random force that depends on nothing, in what the model was identified from.

    nan where the most likely density is zero.
    """
    part = decay.isel(time=slice(0, first_held_out(decay.time.values)))
    result = st.identify(part, library, method)
    if not random_force_of(result):
        return float("nan")
    return st.validation.random_force_dependence(part, result).p_value.item()


def row_of(title: str, decays: Iterable[xr.Dataset], library: st.forces.ForceLibrary, method) -> list[str]:
    """A kind of records in the table."""
    known, failed = [], 0
    for decay in decays:
        try:
            known.append(errors_ahead(decay, library, method))
        except SysidTribError as error:
            print(f"{title}: {error}")
            failed += 1
    row = [title, str(len(known)), str(failed)]
    for ahead in HORIZONS:
        parts = [errors[ahead] for errors in known if ahead in errors]
        z = np.concatenate(parts) if parts else np.empty(0)
        inside = 100.0 * np.mean(np.abs(z) < 1.96) if len(z) else np.nan
        size = np.sqrt(np.mean(z**2)) if len(z) else np.nan
        row.append(f"{inside:.1f} of {len(z)}; {size:.2f}")
    nearest = [errors[HORIZONS[0]] for errors in known if HORIZONS[0] in errors]
    together = sum(float(z[1:] @ z[:-1]) for z in nearest) / max(sum(float(z @ z) for z in nearest), 1e-300)
    return [*row, f"{together:+.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--records", type=int, default=50, help="simulated records of each wander")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--measured", action="store_true", help="the measured records alone")
    asked = parser.parse_args()
    method = METHODS[asked.method]
    coverages = (f"{h} ahead (%; RMS error/stated)" for h in HORIZONS)
    table = Table("95 % bands", "records", "failed", *coverages, "neighbours' correlation")
    if asked.measured:
        for record in RECORDS:
            library, decay = BOTH.select(record.models.split()), record.decay()
            p = dependence(decay, library, method)
            table.add_row(*row_of(f"{record.title}, p {p:.2g}", [decay], library, method))
    else:
        library = st.load_library("contact_forces").select(["lambda", *TRUTH])
        for wander in WANDERS:
            decays = simulated(wander, range(asked.records))
            table.add_row(*row_of(f"simulated, wander {wander:g}", decays, library, method))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
