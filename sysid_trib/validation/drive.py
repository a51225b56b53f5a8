"""Models of a driven record: a few candidates, each with its residual relative to the motion."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError
from sysid_trib.forces import selection
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.offered import with_inputs_acting
from sysid_trib.forces.systems import System, shipped_systems
from sysid_trib.methods.direct import Direct
from sysid_trib.records import inputs
from sysid_trib.records.roles import INPUT
from sysid_trib.records.smoothing import clock_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.validation.driven import residual_over_motion

# Least fraction of zero steps of an input that is held between changes.
MOSTLY_HELD = 0.5
# Formulas of the forces of an oscillator, starting with the fewest.
OSCILLATORS = (
    ("2*v",),
    ("sign(v)", "2*v"),
    ("2*v", "x**3"),
    ("sign(v)", "2*v", "x**3"),
    ("sign(v)", "2*v", "v*abs(v)", "x*abs(x)", "x**3"),
)
# A model with more forces is used if its residual is below this fraction of the best one with fewer.
LESS = 0.8
# Number of samples in the fit: per period of the fastest motion, and in total.
PER_PERIOD, MOST_OF_RECORD = 40, 3000


class TriedModel(NamedTuple):
    """A model that was tried.

    Attributes
    ----------
    system : str
        Name of a system of `libraries/systems.toml`; empty for an oscillator.
    forces : tuple of str
        Symbols of its forces.
    residual : float
        Residual of the motion, over the RMS of the measured signal; infinite without a motion.
    """

    system: str
    forces: tuple[str, ...]
    residual: float


def fitting_models(runs: Sequence[xr.Dataset]) -> xr.Dataset:
    """Return models of driven records: first the recommended one, then the best of each other kind.

    Parameters
    ----------
    runs : sequence of Dataset
        `angle(time)` with inputs.

    Returns
    -------
    Dataset
        Over `model`: the `system` of `libraries/systems.toml`, empty for an oscillator; the symbols of its
        `forces`; `residual_over_motion`, infinite without a motion.

    Notes
    -----
    Direct fits each model to the first samples. The oscillator is the one with the fewest forces whose
    residual is hardly larger than that of models with more forces.
    """
    short = [_short(run) for run in runs[:1]]
    names = [name for name in inputs.inputs_of(short[0]) if name != INPUT]
    oscillators = _nested([_tried("", library, short) for library in _oscillators(names)])
    # Try systems with a held force too, because it changes the equation.
    systems = [_of_system(system, names, short) for system in shipped_systems() if system.held]
    kinds = [oscillators, *systems]
    # A system precedes an oscillator with more forces if it is equally good.
    kinds = sorted(kinds, key=lambda model: model.residual * (1.0 if model.system else 1.0 / LESS))
    return xr.Dataset(
        {
            "system": ("model", [model.system for model in kinds]),
            "forces": ("model", [",".join(model.forces) for model in kinds]),
            "residual_over_motion": ("model", [model.residual for model in kinds]),
        }
    )


def _oscillators(names: Sequence[str]) -> list[ForceLibrary]:
    library = load_library()
    made = []
    for formulas in OSCILLATORS:
        forces = (library.role(formula) for formula in formulas)
        chosen = library.select(force.symbol for force in forces if force is not None)
        made.append(with_inputs_acting(chosen, names))
    return made


def _nested(models: Sequence[TriedModel]) -> TriedModel:
    """Return the model with the fewest forces that no larger model improves."""
    best = models[0]
    for model in models[1:]:
        if model.residual < LESS * best.residual:
            best = model
    return best


def _of_system(system: System, names: Sequence[str], runs: Sequence[xr.Dataset]) -> TriedModel:
    offered = selection.with_shipped(load_library(), system.symbols).select(system.symbols)
    return _tried(system.name, with_inputs_acting(offered, names), runs, system.held)


def _tried(
    system: str, library: ForceLibrary, runs: Sequence[xr.Dataset], held: Mapping[str, float] | None = None
) -> TriedModel:
    residual = np.inf
    with suppress(SysidTribError, np.linalg.LinAlgError):
        residual = _residual(runs[0], library, held=dict(held or {}))
    return TriedModel(system, library.symbols, float(residual))


@in_units_of_the_motion
def _residual(decay: xr.Dataset, library: ForceLibrary, *, held: dict[str, float]) -> float:
    frequency = clock_of(decay) if selection.is_free_to_move(library, held) else None
    method = Direct(reference_frequency=frequency, random_force="off", refine=False, constraints=held)
    return residual_over_motion([decay], method.identify(decay, library))


def _short(run: xr.Dataset) -> xr.Dataset:
    """Return the first samples of a run, decimated as far as they resolve the motion."""
    step = float(np.median(np.diff(run.time.values)))
    period = 2.0 * np.pi / clock_of(run)
    every = max(1, int(period / PER_PERIOD / step))
    known = inputs.inputs_of(run)
    held = any(is_held(known[name].values) for name in known)
    # Do not decimate an input with jumps: the omitted part would act as another drive.
    every = 1 if held else every
    part = run.isel(time=slice(None, MOST_OF_RECORD * every, every))
    if "measured" in part:
        part = part.sel(measured_time=part.time.values)
    return part


def common_between(run: xr.Dataset) -> str | None:
    """Return the interpolation that the varying inputs of a run have in common; None if they differ.

    A switch is held, whatever is between the samples of the other inputs.
    """
    known = inputs.inputs_of(run).values()
    varying = [of for of in known if not inputs.is_constant(of.values)]
    moving = [of for of in varying if not inputs.is_switch(of.values)]
    words = {of.between for of in moving or varying}
    return words.pop() if len(words) == 1 else None


def is_held(values: np.ndarray) -> bool:
    """Return true if an input is constant from sample to sample most of the time, like a square wave."""
    return bool(np.mean(np.diff(values) == 0.0) > MOSTLY_HELD)
