"""A trajectory fit as an identification, whoever made it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.records.runs import one_or_all
from sysid_trib.results.per_run import start_variables
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.simulation.integrate import FREQUENCY
from sysid_trib.trajectory_fit.problem import FitProblem


@dataclass(frozen=True)
class FitEstimate:
    """Parameters fitted to records, with their errors.

    Parameters
    ----------
    problem : FitProblem
        Records and parameters.
    values : (parameter,) array of float
        The fitted values.
    covariance : (parameter, parameter) array of float
        Their covariance.
    noises : sequence of float, rad
        The sensor's noise in each run.
    """

    problem: FitProblem
    values: Array
    covariance: Array
    noises: Sequence[float]

    def identification(
        self,
        method: Any,
        runs: Sequence[xr.Dataset],
        offered: ForceLibrary,
        extra: Mapping[str, tuple[ArrayLike, str, str]],
    ) -> xr.Dataset:
        """The Dataset that every method returns.

        Parameters
        ----------
        method : dataclass with `shapes`
            The method, for the provenance.
        runs : sequence of xarray.Dataset
            The decays.
        offered : ForceLibrary
            All forces to choose from.
        extra : mapping of str to (values, units, long_name)
            Further variables, a number each or one for each run.
        """
        parameters = self.problem.parameters
        model, per_run = parameters.model(self.values), parameters.per_run(self.values)
        estimate = Estimate(
            parameters.coefficients(self.values),
            parameters.covariance_of(self.covariance, (*parameters.library.symbols, FREQUENCY)),
            model.reference_frequency,
            self.noises,
            {**start_variables([(angle, rate) for angle, rate, _ in per_run], per_run[:, 2]), **extra},
        )
        method = replace(method, shapes=dict(model.shapes))
        result = identification(method, one_or_all(runs), parameters.library, estimate, offered=offered)
        if "shape" in result:
            errors = dict(zip(parameters.names, np.sqrt(np.diag(self.covariance)), strict=True))
            errors = {name: errors[name] for name in parameters.fit_shapes}
            fitted = [errors.get(name, np.nan) for name in result.shape_parameter.values.tolist()]
            result["shape_standard_error"] = result.shape_standard_error.copy(data=fitted)
        return result
