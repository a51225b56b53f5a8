"""Auxiliary models that are linear equations between neighbouring half periods."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.half_sines import envelope
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.indirect import AuxiliaryFit, AuxiliaryModel
from sysid_trib.regression.relations import Equations, solve


def half_period_model(
    equations: Mapping[str, Equations],
    values: Callable[[Array], Array],
    library: ForceLibrary,
    shapes: Mapping[str, float] | None = None,
) -> AuxiliaryModel:
    """Groups of equations between the half periods of one decay as a model for indirect inference.

    Parameters
    ----------
    equations : Mapping of str to Equations
        Groups with parameters of their own, `envelope`, `frequency`.
    values : callable
        From all parameters, in the groups' order, to coefficients and, last, the frequency (rad/s).
    library : ForceLibrary
        The forces of these coefficients.
    shapes : Mapping of str to float
        Shape parameters of these forces.
    """

    def fit(measured: Sequence[xr.Dataset]) -> AuxiliaryFit:
        solutions = {group: solve(of_group, measured[0]) for group, of_group in equations.items()}
        parameters = np.concatenate([part.parameters for part in solutions.values()])

        def covariance(ratios: Mapping[str, float]) -> Array:
            # Groups share the errors of half periods, each has its own Birge ratio.
            scaled = [part.influence * ratios[group] for group, part in solutions.items()]
            return _covariance(values, parameters, np.concatenate(scaled))

        return AuxiliaryFit(
            values(parameters),
            {group: [part.residual] for group, part in solutions.items()},
            {group: part.degrees_of_freedom for group, part in solutions.items()},
            lambda group, residuals: solutions[group].chi_square(residuals[0]),
            covariance,
        )

    return AuxiliaryModel(envelope, fit, library, shapes or {})


def _covariance(values: Callable[[Array], Array], parameters: Array, influence: Array) -> Array:
    """Covariance of values of the parameters, from the influence of unit errors on the parameters."""
    steps = 1e-3 * np.linalg.norm(influence, axis=1) + 1e-300
    steps = np.clip(steps, 1e-7 * np.abs(parameters), None)
    slopes = [
        (values(parameters + step * unit) - values(parameters - step * unit)) / (2.0 * step)
        for step, unit in zip(steps, np.eye(len(parameters)), strict=True)
    ]
    by_sample = np.stack(slopes, axis=1) @ influence
    return np.asarray(by_sample @ by_sample.T)
