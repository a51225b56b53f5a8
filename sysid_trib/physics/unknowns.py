"""The unknowns of an identification at one reference frequency, their covariance, and its propagation."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.physics.quantities import Array
from sysid_trib.results.schema import asymptotic_frequency, library_of
from sysid_trib.simulation.model import Model, rescaling_factors


@dataclass(frozen=True)
class Unknowns:
    """Coefficients of an identification, all referred to its reference frequency w.

    Attributes
    ----------
    library : the forces. values : (force + 1,) coefficients, then w (rad/s); covariance : theirs.
    within : (force,) False for a force that w holds already, as an alpha added by the contactless frequency.
    shapes : shape parameters, taken as exact.
    """

    library: ForceLibrary
    values: Array
    covariance: Array
    within: NDArray[np.bool_]
    shapes: Mapping[str, float]

    @property
    def forces(self) -> tuple[Force, ...]:
        """The forces, in the order of the values."""
        return self.library.forces

    @property
    def symbols(self) -> list[str]:
        """Their symbols."""
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
    def spread(self) -> Array:
        """Covariance of the coefficients alone."""
        return self.covariance[:-1, :-1]

    def model(self, values: Array) -> Model:
        """The model with these values of the unknowns, of the forces that are in it."""
        chosen = self.within & (self.coefficients != 0.0)
        pairs = zip(self.symbols, values[:-1].tolist(), chosen, strict=True)
        return Model(self.library, {s: c for s, c, yes in pairs if yes}, float(values[-1]), self.shapes)


def unknowns_of(result: xr.Dataset) -> Unknowns:
    """Read the unknowns of an identification, all coefficients converted to its reference frequency.

    Sensor terms are left out.

    Raises
    ------
    UsageError
        Not an identification.
    """
    needed = ("coefficient", "covariance", "refers_to", "reference_frequency", "frequency_covariance")
    missing = [name for name in needed if name not in getattr(result, "variables", ())]
    if missing or "library" not in result.attrs:
        raise UsageError(
            f"This wants an identification, as identify returns it; {', '.join(missing) or 'library'} is "
            "missing."
        )
    # A sensor term takes no energy and has no weight.
    library = library_of(result)
    library = library.select(f.symbol for f in library if f.kind == "force")
    result = result.sel(force=list(library.symbols), other_force=list(library.symbols))
    w, refers = result.reference_frequency.item(), result.refers_to.values
    c = result.coefficient.values.astype(float)
    own = np.isclose(refers, w, rtol=1e-12)
    whole, jacobian = _as_stated(result, library, own), np.eye(len(c) + 2)[:-1]
    converted = np.append(c, w)
    for i in np.flatnonzero(~own):
        factor = float(rescaling_factors((library.forces[i],), refers[i], w)[0])
        power = np.log(factor) / np.log(refers[i] / w)
        converted[i] = c[i] * factor
        jacobian[i, np.array([i, -2, -1])] = (
            factor,
            -power * converted[i] / w,
            power * converted[i] / refers[i],
        )
    shapes: dict[str, float] = {}
    if "shape" in result:
        shapes = dict(zip(result.shape_parameter.values.tolist(), result.shape.values.tolist(), strict=True))
    return Unknowns(library, converted, jacobian @ whole @ jacobian.T, own, shapes)


def _as_stated(result: xr.Dataset, library: ForceLibrary, own: NDArray[np.bool_]) -> Array:
    """Covariance of (coefficients as stated, w, omega0), (force + 2, force + 2)."""
    count = len(own)
    c, spread = result.coefficient.values.astype(float), result.covariance.values
    w, error = result.reference_frequency.item(), result.reference_frequency_standard_error.item()
    inside = library.select(s for s, yes in zip(library.symbols, own, strict=True) if yes)
    _, gradient = asymptotic_frequency(inside, c[own], w)
    whole = np.zeros((count + 2, count + 2))
    whole[:count, :count] = spread
    if error > 0:
        # A result states the covariance with the asymptotic frequency; that with w follows.
        with_w = (result.frequency_covariance.values - spread[:, own] @ gradient[:-1]) / gradient[-1]
        whole[:count, count] = whole[count, :count] = with_w
        whole[count, count] = error**2
    if "omega0" in result and not own.all():
        omega0, its_error = result.omega0.item(), result.omega0_standard_error.item()
        # alpha = (w_inf/w0)^2 - 1 moves with w0.
        slope = np.where(own, 0.0, -2.0 * (1.0 + c) / omega0)
        whole[:count, -1] = whole[-1, :count] = slope * its_error**2
        whole[-1, -1] = its_error**2
    return whole
