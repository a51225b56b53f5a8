"""Auxiliary models that are linear equations between neighbouring half periods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.half_sines import envelope
from sysid_trib.methods.indirect import AuxiliaryFit, AuxiliaryModel
from sysid_trib.regression.relations import Equations, EquationSolution, solve
from sysid_trib.simulation.model import Model


@dataclass(frozen=True)
class HalfPeriodModel:
    """Groups of equations between the half periods of one decay.

    Attributes
    ----------
    equations : Mapping of str to Equations
        Groups with parameters of their own, `envelope`, `frequency`.
    values : callable
        From all parameters, in the groups' order, to coefficients and, last, the frequency (rad/s).
    model : callable
        The model of such values.
    """

    equations: Mapping[str, Equations]
    values: Callable[[Array], Array]
    model: Callable[[Array], Model]

    def auxiliary(self) -> AuxiliaryModel:
        """The equations as a model for indirect inference, on half-sines."""
        return AuxiliaryModel(envelope, self.fit, self.model)

    def fit(self, measured: Sequence[xr.Dataset]) -> AuxiliaryFit:
        """Solve the equations on the envelope of the one decay."""
        solutions = {group: solve(equations, measured[0]) for group, equations in self.equations.items()}
        return AuxiliaryFit(
            self.values(np.concatenate([part.parameters for part in solutions.values()])),
            {group: [part.residual] for group, part in solutions.items()},
            {group: part.degrees_of_freedom for group, part in solutions.items()},
            lambda group, residuals: solutions[group].chi_square(residuals[0]),
            lambda ratios: self._covariance(solutions, ratios),
        )

    def _covariance(self, solutions: Mapping[str, EquationSolution], ratios: Mapping[str, float]) -> Array:
        """Covariance of the values: groups share the errors of half periods, each has its own Birge ratio."""
        parameters = np.concatenate([part.parameters for part in solutions.values()])
        influence = np.concatenate([part.influence * ratios[group] for group, part in solutions.items()])
        steps = 1e-3 * np.linalg.norm(influence, axis=1) + 1e-300
        steps = np.clip(steps, 1e-7 * np.abs(parameters), None)
        slopes = [
            (self.values(parameters + step * unit) - self.values(parameters - step * unit)) / (2.0 * step)
            for step, unit in zip(steps, np.eye(len(parameters)), strict=True)
        ]
        by_sample = np.stack(slopes, axis=1) @ influence
        return np.asarray(by_sample @ by_sample.T)
