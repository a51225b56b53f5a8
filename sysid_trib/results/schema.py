"""The common schema of an identification: plain xarray, with provenance."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib._version import __version__
from sysid_trib.arrays import Array, Mask, root_mean_square
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.records.roles import CONSTANT, input_names
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.results.frequencies import asymptotic_frequency
from sysid_trib.results.models import INPUT_UNITS, NOT_KEPT, library_of, shape_values_of
from sysid_trib.results.variables import FORMAT_VERSION, Variable, described, refuse_whole_result, variable
from sysid_trib.simulation.model import Model


@dataclass(frozen=True)
class Estimate:
    """Estimate of a method, before it becomes a Dataset.

    Attributes
    ----------
    coefficients : (force,) array of float
        Coefficients of the forces.
    covariance : (force + 1, force + 1) array of float
        Covariance; the last row and column belong to the reference frequency (zero if it was given).
    reference_frequency : float, rad/s
        Reference frequency w.
    noises : (run,) sequence of float, rad
        Standard deviation of the sensor's noise in each run.
    extra : mapping of str to (values, str, str)
        Further scalars, or one value per run: values, units, long name.
    shape_errors : mapping of str to float
        Standard errors of the shape parameters that were fitted.
    """

    coefficients: Array
    covariance: Array
    reference_frequency: float
    noises: Sequence[float]
    extra: Mapping[str, tuple[ArrayLike, str, str]] = field(default_factory=dict)
    shape_errors: Mapping[str, float] = field(default_factory=dict)


def identification(
    method: Any,
    decay: Decays,
    library: ForceLibrary,
    estimate: Estimate,
    *,
    offered: ForceLibrary,
    active: Mask | None = None,
) -> xr.Dataset:
    """Return the Dataset that every method returns, with provenance in its attributes.

    Parameters
    ----------
    method : dataclass
        The method, whose fields are its options.
    decay : Dataset or sequence of Dataset
        One decay, or several runs.
    library : ForceLibrary
        The forces that were identified, in the order of the estimate.
    estimate : Estimate
        Values and errors of the estimate.
    offered : ForceLibrary
        All offered forces.
    active : (force,) array of bool, optional
        Forces that were kept; the others have coefficient 0 and the error that they would have.
    """
    count, covariance = len(library), estimate.covariance
    kept = np.ones(count, bool) if active is None else active
    w = float(estimate.reference_frequency)
    limit, gradient = asymptotic_frequency(library, estimate.coefficients, w)
    variances = covariance[count, count], gradient @ covariance @ gradient
    w_error, limit_error = np.sqrt(np.fmax(0.0, variances)).tolist()
    of_force = covariance[:count, :count]
    # A motion that does not oscillate at small amplitudes has no asymptotic frequency.
    with_frequency = covariance @ gradient if limit > 0.0 else covariance[:, count]
    values_of: dict[str, Any] = {
        "coefficient": np.where(kept, estimate.coefficients, 0.0),
        "standard_error": np.sqrt(np.diag(of_force)),
        "covariance": of_force,
        "active": kept,
        "refers_to": np.full(count, w),
        "frequency_covariance": with_frequency[:count],
        "noise": root_mean_square(estimate.noises),
        # A given frequency has the error 0.
        "reference_frequency": (w, w_error),
        "asymptotic_frequency": (limit, limit_error),
    }
    if len(estimate.noises) > 1:
        values_of["run_noise"] = list(estimate.noises)
    variables = described("identification", values_of | _shape_values(method, library, estimate))
    for name, (values, units, long_name) in estimate.extra.items():
        # A scalar, also for a single run.
        numbers = np.squeeze(np.asarray(values, dtype=float))
        variables[name] = variable(("run",) * numbers.ndim, numbers, long_name, units)
    symbols = list(library.symbols)
    coords: dict[str, Any] = {"force": symbols, "other_force": symbols}
    recorded = as_runs(decay, driven=True)[0].variables.items()
    # A constant, such as the gain of a loop, is a number in the formula and not a unit of a coefficient.
    of_inputs = {str(k): _unit_of_input(v) for k, v in recorded if CONSTANT not in v.attrs}
    coords |= force_labels(library.forces, of_inputs)
    # Create all variables at once: xarray takes a quarter of a millisecond for each one.
    return xr.Dataset(variables, coords, provenance(method, decay, offered))


def _unit_of_input(values: xr.Variable) -> str:
    """Return the unit of an input; empty if it is not stated. A switch between 0 and 1 has the unit 1."""
    unit = str(values.attrs.get("units", ""))
    is_switch = not unit and values.dtype.kind in "fiub" and bool(np.isin(values.values, (0, 1)).all())
    return "1" if is_switch else unit


def force_labels(forces: Sequence[Force], inputs: Mapping[str, str] | None = None) -> dict[str, Variable]:
    """Return the coordinates that describe each force, with the units of inputs by name."""
    # The degree in the rate determines how a coefficient changes with its reference; a sensor term has none.
    speed_degree = [None if f.kind == "sensor" else f.speed_degree for f in forces]
    values = {
        "name": [f.name for f in forces],
        "formula": [f.formula.text for f in forces],
        "unit": [f.units_with(inputs or {}) for f in forces],
        "parity": [f.parity for f in forces],
        "degree": np.array([f.degree for f in forces], dtype=float),
        "speed_degree": np.array(speed_degree, dtype=float),
    }
    return described("identification", values)


def _shape_values(method: Any, library: ForceLibrary, estimate: Estimate) -> dict[str, Any]:
    """Return shape parameters and their errors; nothing if there are none (netCDF has no empty axis)."""
    shapes = library.shape_values(dict(getattr(method, "shapes", {})))
    errors = [estimate.shape_errors.get(name, np.nan) for name in shapes]
    values = {"shape": list(shapes.values()), "shape_standard_error": errors}
    return {"shape_parameter": list(shapes), **values} if shapes else {}


def provenance(method: Any, decay: Decays, library: ForceLibrary) -> dict[str, Any]:
    """Return the provenance of a result: package version, method and options, library text, record(s)."""
    runs = as_runs(decay, driven=True)
    names = [f.name for f in fields(method)] if is_dataclass(method) else []
    options = {name: getattr(method, name) for name in names}
    of_kind = {channel.input for channel in library.channels if channel.kind}
    inputs = {name: runs[0][name].attrs.get("units") for name in input_names(runs[0]) if name not in of_kind}
    kept = {INPUT_UNITS: json.dumps(inputs)} if any(inputs.values()) else {}
    return kept | {
        "method": type(method).__name__.lower(),
        "options": json.dumps(options, default=lambda value: {NOT_KEPT: str(value)}),
        "sysid_trib_version": __version__,
        "format_version": FORMAT_VERSION,
        "library_title": library.title,
        "library_source": library.source,
        "library": library.to_toml(),
        "record_source": [str(run.attrs.get("source", "")) for run in runs],
        "record_checksum": [str(run.attrs.get("record_checksum", "")) for run in runs],
    }


def model_of(result: xr.Dataset, run: int = 0) -> Model:
    """Return the identified model: active forces that refer to the reference frequency.

    Parameters
    ----------
    result : Dataset
        An identification.
    run : int
        Index of the run, from 0, if forces have separate coefficients in each run.

    Returns
    -------
    Model
        The identified coefficients, frequency (rad/s) and shape parameters, without their errors.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.physics.model_of(st.identify(st.records.paper_twin(), method="direct"))
    >>> round(model.coefficients["zeta"], 4), round(model.reference_frequency, 2)
    (0.0097, 9.91)
    >>> st.simulate(model, np.arange(0.0, 10.0, 0.01), angle=0.3).angle.sizes["time"]
    1000
    """
    refuse_whole_result(result)
    frequency = result.reference_frequency.item()
    kept = result.active.values & np.isclose(result.refers_to.values, frequency, rtol=1e-12)
    identified = zip(
        result.force.values[kept].tolist(), result.coefficient.values[kept].tolist(), strict=True
    )
    acting = library_of(result).in_run(run + 1)
    coefficients = {symbol: c for symbol, c in identified if symbol in acting.symbols}
    return Model(acting, coefficients, frequency, shape_values_of(result, acting))
