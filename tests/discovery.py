"""Simulated records for tests of discovery: few samples, every kind of force."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from helpers import FIVE, Array, W, decay

from sysid_trib import Model, load_library
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.start_model import fit_start_model
from sysid_trib.discovery.engine.trials import DEFAULTS, Settings
from sysid_trib.discovery.fits import Fits, credible, probabilities
from sysid_trib.discovery.search import Search, search, with_steps
from sysid_trib.forces import ForceLibrary
from sysid_trib.simulation.trajectory import trajectory

CONTACT, EFFECTS = load_library(), load_library("candidate_effects")
BASE = CONTACT.select(FIVE)
EVERY = {force.symbol: force for force in (*CONTACT, *EFFECTS)}
# 25 samples a period, 31 periods.
TIME = np.arange(800) / 40.0


def library(*symbols: str) -> ForceLibrary:
    return ForceLibrary("of a test", tuple(EVERY[symbol] for symbol in symbols))


def model_of(coefficients: Mapping[str, float], shapes: Mapping[str, float] | None = None) -> Model:
    return Model(library(*coefficients), dict(coefficients), W, dict(shapes or {}))


def exact(model: Model, time: Array = TIME, start: float = 0.3) -> Array:
    """The angle shown by the sensor, without noise."""
    return trajectory(model, time, start, 0.0).angle


def with_effect(effects: Mapping[str, float], *, seed: int, base=FIVE, shapes=None, start=0.3) -> xr.Dataset:
    """A record of the base forces and of effects."""
    return decay(TIME, exact(model_of({**base, **effects}, shapes), start=start), seed)


def start_model(
    runs: Sequence[xr.Dataset], forces: ForceLibrary = BASE, settings: Settings = DEFAULTS
) -> FittedModel:
    return fit_start_model(runs, forces.forces, None, settings)


def searched(runs, candidates: ForceLibrary = EFFECTS, forces: ForceLibrary = BASE) -> Search:
    return with_steps(search(Fits(start_model(runs, forces), candidates.forces)))


def credible_set(found: Search, symbol: str) -> set[str]:
    """Candidates in place of an effect; "" stands for none of them."""
    costs = found.rivals[symbol]
    inside = credible(probabilities(list(costs.values())), DEFAULTS.credible)
    return {name for name, within in zip(costs, inside, strict=True) if within}


def errors_of(model: FittedModel) -> dict[str, float]:
    """Standard errors of the coefficients."""
    symbols = [trial.force.symbol for trial in model.trials]
    return dict(zip(symbols, np.sqrt(np.diag(model.covariance_with_frequency())), strict=False))


def coefficients_of(model: FittedModel) -> dict[str, float]:
    symbols = [trial.force.symbol for trial in model.trials]
    return dict(zip(symbols, model.coefficients.tolist(), strict=True))


def deviations(model: FittedModel, truth: Mapping[str, float]) -> Array:
    """Errors of coefficients over their standard errors."""
    values, errors = coefficients_of(model), errors_of(model)
    return np.array([(values[symbol] - true) / errors[symbol] for symbol, true in truth.items()])


def active(candidates: ForceLibrary) -> ForceLibrary:
    """Return the same forces without the restriction to dissipation."""
    return replace(candidates, forces=tuple(replace(force, passive=False) for force in candidates))
