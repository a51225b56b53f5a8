"""The likelihood of free motions about their best fit: deviances, also with parameters held."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.motion_fit.least_squares import Fit, fitted
from sysid_trib.motion_fit.parameters import Parameters
from sysid_trib.motion_fit.problem import FitProblem

# Relative step at which a fit with parameters held is done: its deviance is known to far less than 1.
HELD_TOLERANCE = 1e-8


@dataclass(frozen=True)
class FreeLikelihood:
    """Records in white noise, of the variance that the best fit leaves of each.

    Attributes
    ----------
    problem : FitProblem
        Its whitened residual has unit variance at the best fit.
    best : Fit
    """

    problem: FitProblem
    best: Fit

    @classmethod
    def of_fit(cls, problem: FitProblem, fit: Fit) -> "FreeLikelihood":
        """The likelihood about a fit; its parameters take their part of the noise from what it leaves."""
        part, records = len(problem.parameters.free) / len(problem.records), []
        for record, residual in zip(problem.records, problem.residuals(fit.values), strict=True):
            white = replace(record, weight=1.0).white(residual)
            records.append(replace(record, weight=float(np.sqrt((len(white) - part) / (white @ white)))))
        problem = replace(problem, records=tuple(records))
        return cls(problem, fitted(problem, fit.values))

    @property
    def parameters(self) -> Parameters:
        """The parameters, in the order of their vector."""
        return self.problem.parameters

    @cached_property
    def covariance(self) -> Array:
        """Covariance of all parameters by the curvature at the best fit, (parameter, parameter)."""
        return self.parameters.covariance(self.best.sensitivity, self.best.values)

    @cached_property
    def root(self) -> Array:
        """Root of the covariance, (parameter, parameter): it makes unit draws draws of the parameters."""
        size = np.sqrt(np.diag(self.covariance))
        scale = np.where(size > 0.0, size, 1.0)
        variances, axes = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return np.asarray(size[:, None] * axes * np.sqrt(np.maximum(variances, 0.0)))

    def deviance(self, values: Array) -> float:
        """Deviance of values: by how much twice the log likelihood is below that of the best fit."""
        residual = self.problem.white(self.problem.residuals(values))
        return float(residual @ residual - self.best.residual @ self.best.residual)

    def deviance_of(self, fit: Fit) -> float:
        """Deviance of another fit."""
        return float(fit.residual @ fit.residual - self.best.residual @ self.best.residual)

    def holding(self, held: Mapping[str, float], near: Array) -> Fit:
        """The best fit in which parameters have these values, from one that is near."""
        places = [self.parameters.index(name) for name in held]
        across = self.covariance[:, places] @ np.linalg.pinv(self.covariance[np.ix_(places, places)])
        start = near + across @ (np.array([*held.values()]) - near[places])
        return fitted(
            replace(self.problem, parameters=self.parameters.fix(held)), start, tolerance=HELD_TOLERANCE
        )
