"""Significance of a hidden effect in a record with both noises, by exact fits of the truth.

z is the root of the deviance that the truth gains on what the search sees, the first two thirds of each run.
"""

import itertools
from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib import free_decay, load_library
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.likelihood import likelihood
from sysid_trib.discovery.engine.model_fit import fit_model
from sysid_trib.discovery.engine.paths import RecordPath
from sysid_trib.discovery.engine.run_rows import decimated
from sysid_trib.discovery.engine.start_model import fit_start_model
from sysid_trib.discovery.engine.trials import TrialEffect
from sysid_trib.discovery.screen import screen
from sysid_trib.discovery.single_columns import each_column, projected
from sysid_trib.forces import ForceLibrary
from sysid_trib.forces.force import Force
from sysid_trib.forces.library import library_of_text
from sysid_trib.validation.holdout import split

from .effects import Shapes

CONTACT, OTHERS = load_library(), load_library("candidate_effects")
EVERY = {force.symbol: force for force in (*CONTACT, *OTHERS)}
# Formulas of what no library holds, by its shapes.
STRANGE = {
    "friction_bump": "sign(v)*exp(-((abs(x) - {a!r})/{d!r})**2)",
    "speed_bump": "sign(v)*exp(-((abs(v) - {a!r})/{d!r})**2)",
    "root": "sign(x)*abs(x)**0.3",
    "washboard": "sin({k!r}*x)",
    "braking": "v*exp(-((t - {a!r})/{d!r})**2)",
    "jump": "x*(0.5 + 0.5*tanh((t - {a!r})/{d!r}))",
}
# Pairs of other candidates of which the likelihood is computed.
PAIRS = 20


def force_of(symbol: str, shapes: Shapes) -> Force:
    """The library's force, or one made for what no library holds."""
    if symbol in EVERY:
        return EVERY[symbol]
    text = f'title = "strange"\n[[force]]\nsymbol = "{symbol}"\nname = "{symbol}"\nfamily = "strange"\n'
    return library_of_text(f'{text}formula = "{STRANGE[symbol].format(**shapes)}"\n', "strange").forces[0]


def trial_of(symbol: str, shapes: Shapes) -> TrialEffect:
    force = force_of(symbol, shapes)
    return TrialEffect(force, {f"{symbol}.{name}": shapes[name] for name in force.shape}, added=False)


def in_range(symbol: str, shapes: Shapes) -> bool:
    """Return whether the shape parameters are within the ranges of the library."""
    ranges = EVERY[symbol].shape if symbol in EVERY else {}
    return all(shape.low <= shapes[name] <= shape.high for name, shape in ranges.items())


def as_seen(time: np.ndarray, angles: Sequence[np.ndarray]) -> list[xr.Dataset]:
    """Return the part of each run that the search uses."""
    decays = [free_decay(xr.Dataset({"angle": ("time", angle)}, {"time": time})) for angle in angles]
    return [split(decimated(decay))[0] for decay in decays]


def base_model(seen: Sequence[xr.Dataset], base: Sequence[str]) -> FittedModel:
    return fit_start_model(seen, CONTACT.select(list(base)).forces, None)


def resolution(base: FittedModel, trials: Sequence[TrialEffect]) -> tuple[np.ndarray, np.ndarray]:
    """Standard error of each effect beside base and others; the RMS of a unit of it over the restoring force.

    Of an error of the sensor that over the angle.
    """
    tables = [
        np.column_stack([run.columns(trials), table])
        for run, table in zip(base.rows, base.tables, strict=True)
    ]
    products = [run.products(table) for run, table in zip(base.rows, tables, strict=True)]
    found = likelihood(products, range(1, 1 + tables[0].shape[1]))
    sizes = []
    for trial in trials:
        of_runs = zip(*(_values(run.path, trial) for run in base.rows), strict=True)
        values, angles = map(np.concatenate, of_runs)
        sizes.append(np.sqrt(np.mean(values**2) / np.mean(angles**2)))
    return np.sqrt(np.diag(found.covariance))[: len(trials)], np.array(sizes)


def _values(path: RecordPath, trial: TrialEffect) -> tuple[np.ndarray, np.ndarray]:
    """An effect of coefficient 1 and the angle along a path."""
    if trial.force.kind == "sensor":
        return path.sensor_errors([(trial, 1.0)]), path.at_samples[0]
    return path.force_values([trial])[:, 0], path.points[1]


def true_fit(base: FittedModel, hidden: Sequence[tuple[TrialEffect, float]]) -> FittedModel:
    """The model with all hidden effects, started from the truth."""
    first = np.array([*base.coefficients, *(c for _, c in hidden), base.stiffness])
    trials = [*base.trials, *(trial for trial, _ in hidden)]
    return _fit(base, trials, first)


def _fit(near: FittedModel, trials: Sequence[TrialEffect], first: np.ndarray) -> FittedModel:
    paths = [run.path for run in near.rows]
    return fit_model(paths, trials, first)


def gained(base: FittedModel, full: FittedModel) -> list[float]:
    """z of each hidden effect beside the base and the others."""
    count, zs = len(base.trials), []
    for at in range(count, len(full.trials)):
        kept = [i for i in range(len(full.trials)) if i != at]
        first = np.append(full.coefficients[kept], full.stiffness)
        without = _fit(full, [full.trials[i] for i in kept], first).deviance
        if len(kept) == count:
            without = min(without, base.deviance)
        zs.append(float(np.sqrt(max(0.0, without - full.deviance))))
    return zs


def left_by_two(full: FittedModel, truth: str, others: Sequence[Force]) -> list[float]:
    """z that the best one and the best two of other candidates leave of the truth, along its motion."""
    screening = screen(full, others)
    gone = {1 + column for column in full.columns_of(truth)}
    kept = [1 + column for column in range(full.columns) if 1 + column not in gone]
    columns = [screening.first_trial + at for at in screening.replacing]
    bare = likelihood(screening.products, kept)
    deviance = each_column(screening.products, kept, columns, bare)[0]
    best: dict[str, int] = {}
    for i in np.argsort(deviance).tolist():
        best.setdefault(screening.trials[screening.replacing[i]].force.symbol, i)
    chosen = [columns[i] for i in best.values()]
    one = float(deviance.min()) - full.deviance
    _, rest = projected(screening.products, full.likelihood, kept, [0, *chosen])
    pairs = sorted(itertools.combinations(range(len(chosen)), 2), key=lambda pair: -_explained(rest, pair))[
        :PAIRS
    ]
    two = [likelihood(screening.products, [*kept, chosen[i], chosen[j]]).deviance for i, j in pairs]
    return [float(np.sqrt(max(0.0, q))) for q in (one, min([one, *(d - full.deviance for d in two)]))]


def _explained(rest: np.ndarray, pair: tuple[int, int]) -> float:
    """Return the fall of squares of the target by two columns, outside of the kept ones."""
    at = [1 + i for i in pair]
    right = rest[0, at]
    inner = rest[np.ix_(at, at)]
    return float(right @ np.linalg.pinv(inner, rcond=1e-6, hermitian=True) @ right)


def offered(base: Sequence[str], left_out: Sequence[str]) -> ForceLibrary:
    """Return both libraries without the forces of the model and those that are left out."""
    forces = tuple(force for force in EVERY.values() if force.symbol not in {*base, *left_out})
    return ForceLibrary("candidates", forces, "libraries")
