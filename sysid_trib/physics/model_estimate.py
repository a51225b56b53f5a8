"""An identified model at one reference frequency, first-order error propagation, and the arrest time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Mask, jacobian
from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.questions.averaged_motion import predict_envelope
from sysid_trib.results import models, variables
from sysid_trib.results.frequencies import covariance_with_frequency
from sysid_trib.simulation.model import Model, rescaling_factors
from sysid_trib.simulation.trajectory import trajectory


def propagate(
    function: Callable[[Array], ArrayLike], values: Array, covariance: Array
) -> tuple[Array, Array]:
    """Compute values and standard errors of a function to first order, by central differences.

    Parameters
    ----------
    function : callable
        Function of the values; its result is an array of any shape.
    values : (value,) array of float
        Values at which the function is evaluated.
    covariance : (value, value) array of float
        Covariance of the values.

    Returns
    -------
    tuple of array
        Value of the function, and its standard error.
    """
    result = np.asarray(function(values), dtype=float)
    slopes = jacobian(function, values, np.sqrt(np.diag(covariance)))
    variance = np.einsum("...i,ij,...j->...", slopes, covariance, slopes)
    return result, np.sqrt(np.maximum(variance, 0.0))


def of_measured(
    function: Callable[[Array], ArrayLike], result: tuple[str, str, str], *measured: tuple[str, float, float]
) -> xr.Dataset:
    """Return a function of independently measured quantities, with its standard error.

    Parameters
    ----------
    function : callable
        Function of their values, given as one array.
    result : tuple of (str, str, str)
        Name, meaning and unit of the result.
    *measured : tuple of (str, float, float)
        Name, value and standard error of each quantity.

    Raises
    ------
    UsageError
        A quantity is not positive, or an error is negative.
    """
    for quantity in measured:
        check_quantity(*quantity)
    name, meaning, units = result
    _, values, errors = zip(*measured, strict=True)
    made = propagate(function, np.array(values), np.diag(np.square(errors)))
    return xr.Dataset(variables.with_error(name, (), made, meaning, units))


def amplitude_row(amplitude: ArrayLike) -> Array:
    """Return amplitudes as a one-dimensional array; raise a UsageError unless they are positive angles."""
    a = np.asarray(amplitude, dtype=float)
    if a.ndim > 1 or a.size == 0 or not np.all(np.isfinite(a) & (a > 0)):
        raise UsageError("Amplitudes must be positive angles in rad: a number or one row of numbers.")
    return np.atleast_1d(a)


def check_quantity(name: str, value: float, error: float = 0.0) -> None:
    """Raise an error for a quantity that is not finite and positive, or for a negative standard error.

    Raises
    ------
    UsageError
        The quantity or its error is invalid.
    """
    if not (np.isfinite(value) and value > 0):
        raise UsageError(f"The {name} must be a positive number, not {value}.")
    if not (np.isfinite(error) and error >= 0):
        raise UsageError(f"The standard error of the {name} must be a number >= 0, not {error}.")


NEEDED = ("coefficient", "covariance", "refers_to", "reference_frequency", "frequency_covariance")


@dataclass(frozen=True)
class ModelEstimate:
    """Coefficients of an identification, all referred to its reference frequency w.

    Attributes
    ----------
    library : ForceLibrary
        The forces.
    values : (force + 1,) array of float
        Coefficients, then w (rad/s).
    covariance : (force + 1, force + 1) array of float
        Covariance of `values`.
    in_model : (force,) array of bool
        False for a force that is already contained in w, such as an alpha added by the contactless frequency.
    shapes : mapping of str to float
        Shape parameters, taken as exact.
    provenance : mapping of str to str
        Attributes that are copied to results computed from the identification: the text of its library.
    """

    library: ForceLibrary
    values: Array
    covariance: Array
    in_model: Mask
    shapes: Mapping[str, float]
    provenance: Mapping[str, str]

    @property
    def forces(self) -> tuple[Force, ...]:
        """Forces, in the order of the values."""
        return self.library.forces

    @property
    def symbols(self) -> list[str]:
        """Symbols of the forces."""
        return list(self.library.symbols)

    @property
    def coefficients(self) -> Array:
        """Coefficients at the reference frequency, (force,)."""
        return self.values[:-1]

    @property
    def frequency(self) -> float:
        """Reference frequency w, rad/s."""
        return float(self.values[-1])

    @property
    def coefficient_covariance(self) -> Array:
        """Covariance of the coefficients alone."""
        return self.covariance[:-1, :-1]

    def model(self, values: Array) -> Model:
        """Return the model of the forces that are in it, with these values instead of its own."""
        chosen = self.in_model & (self.coefficients != 0.0)
        pairs = zip(self.symbols, values[:-1].tolist(), chosen, strict=True)
        return Model(self.library, {s: c for s, c, yes in pairs if yes}, float(values[-1]), self.shapes)

    def with_inertia(self, inertia: float, standard_error: float) -> tuple[Array, Array]:
        """Return values and covariance with a separately measured inertia (kg m^2) as the last value."""
        covariance = np.pad(self.covariance, (0, 1))
        covariance[-1, -1] = standard_error**2
        return np.append(self.values, inertia), covariance

    def over_amplitude(self, data: variables.Variables, given: ArrayLike) -> xr.Dataset:
        """Return variables over force and amplitude, or over force only if one number was given.

        Parameters
        ----------
        data : dict
            Variables over `force` and `amplitude`.
        given : array_like, rad
            Amplitudes as given by the user.
        """
        amplitude = variables.variable("amplitude", np.atleast_1d(given).astype(float), "amplitude", "rad")
        table = xr.Dataset(data, {"force": self.symbols, "amplitude": amplitude}, self.provenance)
        return table if np.ndim(given) else table.isel(amplitude=0)


def model_estimate(result: xr.Dataset) -> ModelEstimate:
    """Read an identification, with all coefficients converted to its reference frequency.

    Sensor terms are omitted.

    Parameters
    ----------
    result : Dataset
        An identification.

    Raises
    ------
    UsageError
        The dataset is not an identification.
    """
    variables.refuse_whole_result(result)
    missing = [name for name in NEEDED if name not in getattr(result, "variables", ())]
    if missing or "library" not in result.attrs:
        raise UsageError(
            "This needs an identification, as identify returns it; "
            f"{', '.join(missing) or 'library'} is missing."
        )
    # A sensor term dissipates no energy and has no weight.
    library = models.library_of(result)
    library = library.select(f.symbol for f in library if f.kind == "force")
    result = result.sel(force=list(library.symbols), other_force=list(library.symbols))
    w, refers = result.reference_frequency.item(), result.refers_to.values
    c = result.coefficient.values.astype(float)
    in_model = np.isclose(refers, w, rtol=1e-12)
    covariance, jacobian = _stated_covariance(result, in_model), np.eye(len(c) + 2)[:-1]
    values = np.append(c, w)
    for i in np.flatnonzero(~in_model):
        factor = float(rescaling_factors((library.forces[i],), refers[i], w)[0])
        power = np.log(factor) / np.log(refers[i] / w)
        values[i] = c[i] * factor
        slopes = factor, -power * values[i] / w, power * values[i] / refers[i]
        jacobian[i, np.array([i, -2, -1])] = slopes
    covariance = jacobian @ covariance @ jacobian.T
    provenance = {"library": result.attrs["library"]}
    return ModelEstimate(library, values, covariance, in_model, models.shape_values_of(result), provenance)


def _stated_covariance(result: xr.Dataset, in_model: Mask) -> Array:
    """Return the covariance of (coefficients as stated, w, omega0), (force + 2, force + 2)."""
    count, c = len(in_model), result.coefficient.values.astype(float)
    whole = np.pad(covariance_with_frequency(result), (0, 1))
    if "omega0" in result and not in_model.all():
        omega0, its_error = result.omega0.item(), result.omega0_standard_error.item()
        # alpha = (w_inf/w0)^2 - 1 depends on w0.
        slope = np.where(in_model, 0.0, -2.0 * (1.0 + c) / omega0)
        whole[:count, -1] = whole[-1, :count] = slope * its_error**2
        whole[-1, -1] = its_error**2
    return whole


def arrest_time(result: xr.Dataset, amplitude: float) -> xr.Dataset:
    """Compute when the motion stops, if it starts from rest at an amplitude.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : float, rad
        Amplitude at which the motion starts.

    Returns
    -------
    Dataset
        `arrest_time` from the averaged equations (s, nan if the motion only tends to zero or is sustained)
        and its standard error, and `stop_time` of the exact motion (s, in steps of about half a period; nan
        if it does not stop, or only after 20,000 periods).

    Raises
    ------
    UsageError
        The dataset is not an identification, or the angle is not positive.

    Notes
    -----
    With dry and viscous friction it is ln(1 + pi zeta a/(2 lambda))/(zeta w). The paper's remaining time
    pi/(4 zeta w) after a = lambda/(2 zeta) is a rough bound of it (Le Bot et al. 2019, Sec. 4).

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"lambda": 2e-3, "zeta": 0.0097}, 9.91)
    >>> record = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> stop = st.physics.arrest_time(st.identify(record, "lambda,zeta", "direct"), amplitude=0.3)
    >>> stop.arrest_time.round(1).item(), stop.stop_time.round(1).item()
    (12.4, 12.4)
    """
    estimate = model_estimate(result)
    if np.ndim(amplitude):
        raise UsageError("One amplitude (rad) at which the motion starts is needed.")
    start = float(amplitude_row(amplitude)[0])

    def arrest(values: Array) -> float:
        try:
            return float(predict_envelope(estimate.model(values), [0.0], start).arrest_time)
        except SimulationError:
            return np.nan

    end, error = arrest(estimate.values), np.nan
    if np.isfinite(end):
        error = float(propagate(arrest, estimate.values, estimate.covariance)[1])
    stop = _exact_stop(estimate, start, end)
    data = variables.with_error("arrest_time", (), (end, error), "arrest of the averaged motion", "s")
    data["stop_time"] = variables.variable((), stop, "stop of the exact motion", "s")
    at = variables.variable((), start, "amplitude at the start", "rad")
    return xr.Dataset(data, {"amplitude": at}, estimate.provenance)


def _exact_stop(estimate: ModelEstimate, start: float, averaged: float) -> float:
    period = 2.0 * np.pi / estimate.frequency
    # Longest motion, in periods, that is simulated to its end.
    if not averaged < 20_000 * period:
        return np.nan
    # The error of averaging is at most a few periods plus a fraction of the whole time.
    time = np.array([0.0, 1.2 * averaged + 5.0 * period])
    try:
        return float(trajectory(estimate.model(estimate.values), time, start, 0.0).stop_time)
    except SimulationError:
        return np.nan
