"""The one schema of an identification: plain xarray, with provenance."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib._version import __version__
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import library_of_text
from sysid_trib.records.runs import Decays, as_runs, root_mean_square
from sysid_trib.results.format import FORMAT_VERSION
from sysid_trib.results.per_run import run_noise
from sysid_trib.simulation.model import Model

Array = NDArray[np.float64]


# Marks an option that is told but cannot be read back: an optimiser, a start model.
NOT_KEPT = "not kept"


@dataclass(frozen=True)
class Estimate:
    """What a method found, before it is labelled.

    Attributes
    ----------
    coefficients : (force,); covariance : (force + 1, force + 1), the last row and column belong to the
        reference frequency (zero where it was given).
    reference_frequency : rad/s.
    noises : standard deviation of the sensor's noise in each run, rad.
    extra : further scalars, or one number a run, with (value, units, long_name).
    """

    coefficients: Array
    covariance: Array
    reference_frequency: float
    noises: Sequence[float]
    extra: Mapping[str, tuple[ArrayLike, str, str]] = field(default_factory=dict)


def identification(
    method: Any,
    decay: Decays,
    library: ForceLibrary,
    estimate: Estimate,
    *,
    offered: ForceLibrary,
    active: NDArray[np.bool_] | None = None,
) -> xr.Dataset:
    """Label an estimate: the Dataset that every method returns, provenance in its attrs.

    Parameters
    ----------
    library : the forces that were unknowns, in the order of the estimate; offered : all to choose from.
    active : which forces were kept; the others have coefficient 0 and the error they would have had.
    """
    count = len(library)
    kept = np.ones(count, bool) if active is None else active
    limit, gradient = asymptotic_frequency(library, estimate.coefficients, estimate.reference_frequency)
    scalars: dict[str, tuple[ArrayLike, str, str]] = {
        "reference_frequency": (estimate.reference_frequency, "rad/s", "reference frequency w"),
        "reference_frequency_standard_error": (
            _root(float(estimate.covariance[count, count])),
            "rad/s",
            "standard error of the reference frequency, 0 if it was given",
        ),
        "asymptotic_frequency": (limit, "rad/s", "frequency at vanishing amplitude"),
        "asymptotic_frequency_standard_error": (
            _root(float(gradient @ estimate.covariance @ gradient)),
            "rad/s",
            "standard error of the asymptotic frequency",
        ),
        "noise": (
            root_mean_square(estimate.noises),
            "rad",
            "standard deviation of the sensor's noise in a sample",
        ),
        **run_noise(estimate.noises),
        **estimate.extra,
    }
    result = _per_force(library, estimate, kept)
    result["frequency_covariance"] = (
        "force",
        (estimate.covariance @ gradient)[:count],
        {"units": "rad/s", "long_name": "covariance with the asymptotic frequency"},
    )
    result = result.merge(_shapes(method, library)).assign_attrs(provenance(method, decay, offered))
    # All at once: xarray takes a quarter of a millisecond for each on its own.
    labelled = {
        name: (*_per_run(value), {"units": units, "long_name": told})
        for name, (value, units, told) in scalars.items()
    }
    return result.assign(labelled)


def _per_run(value: ArrayLike) -> tuple[tuple[str, ...], Any]:
    """Dimensions and values: a scalar, also if there is but one run."""
    each = np.asarray(value, dtype=float)
    return ((), float(each.item())) if each.size == 1 else (("run",), each)


def _per_force(library: ForceLibrary, estimate: Estimate, kept: NDArray[np.bool_]) -> xr.Dataset:
    symbols = list(library.symbols)
    count = len(symbols)
    covariance = estimate.covariance[:count, :count]
    # A coefficient's unit differs from force to force: it is in the coordinate `unit`.
    own = {"units": "see the coordinate unit"}
    frequency = np.full(count, float(estimate.reference_frequency))
    return xr.Dataset(
        {
            "coefficient": (
                "force",
                np.where(kept, estimate.coefficients, 0.0),
                own | {"long_name": "coefficient"},
            ),
            "standard_error": (
                "force",
                np.sqrt(np.diag(covariance)),
                own | {"long_name": "standard error of the coefficient"},
            ),
            "covariance": (("force", "other_force"), covariance, own | {"long_name": "covariance"}),
            "active": ("force", kept, {"long_name": "kept in the model"}),
            "refers_to": (
                "force",
                frequency,
                {"units": "rad/s", "long_name": "frequency to which the coefficient refers"},
            ),
        },
        {"force": symbols, "other_force": symbols} | _labels(library.forces),
    )


def _labels(forces: Sequence[Force]) -> dict[str, Any]:
    return {
        "name": ("force", [f.name for f in forces]),
        "formula": ("force", [f.formula.text for f in forces]),
        "unit": ("force", [f.units for f in forces]),
    }


def _shapes(method: Any, library: ForceLibrary) -> xr.Dataset:
    """Shape parameters as they were held; nothing where the forces have none (netCDF has no empty axis)."""
    given = dict(getattr(method, "shapes", {}))
    shapes = {f"{f.symbol}.{k}": value for f in library for k, value in f.shape_values(given).items()}
    if not shapes:
        return xr.Dataset()
    held = np.full(len(shapes), np.nan)
    return xr.Dataset(
        {
            "shape": ("shape_parameter", list(shapes.values()), {"long_name": "shape parameter"}),
            "shape_standard_error": (
                "shape_parameter",
                held,
                {"long_name": "standard error, nan where the shape was held"},
            ),
        },
        {"shape_parameter": list(shapes)},
    )


def _root(variance: float) -> float:
    return float(np.sqrt(max(0.0, variance)))


def provenance(method: Any, decay: Decays, library: ForceLibrary) -> dict[str, Any]:
    """How a result came about: package version, method and options, library text, record(s)."""
    runs = as_runs(decay)

    options = (
        {f.name: getattr(method, f.name) for f in fields(method)}
        if hasattr(method, "__dataclass_fields__")
        else {}
    )
    return {
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


def asymptotic_frequency(library: ForceLibrary, coefficients: Array, reference: float) -> tuple[float, Array]:
    """Frequency w sqrt(1 + alpha - zeta^2) at vanishing amplitude, and its gradient by (coefficients, w)."""
    value = dict(zip(library.symbols, coefficients, strict=True))
    gradient = np.zeros(len(library) + 1)
    squared = 1.0
    for formula, factor in (("x", None), ("2*v", 1.0), ("v", 0.5)):
        force = library.role(formula)
        if force is None:
            continue
        at = library.symbols.index(force.symbol)
        # Alpha enters linearly, the damping ratio by its square.
        squared += value[force.symbol] if factor is None else -((factor * value[force.symbol]) ** 2)
        gradient[at] = 1.0 if factor is None else -2.0 * factor**2 * value[force.symbol]
    squared = max(squared, 0.0)
    root = np.sqrt(squared)
    gradient *= reference / (2.0 * root) if root > 0 else np.nan
    gradient[-1] = root
    return float(reference * root), gradient


def with_contactless_frequency(result: xr.Dataset, omega0: float, standard_error: float = 0.0) -> xr.Dataset:
    """Add alpha = (w_inf/w0)^2 - 1 to an identification whose frequency was fitted.

    Parameters
    ----------
    result : an identification.
    omega0, standard_error : frequency of the oscillator without contact and its error, rad/s.

    Returns
    -------
    The identification with one force more (the library's force of formula `x`), which refers to `omega0`;
    the others stay referred to the fitted frequency. One that has it already is returned as it is.

    Raises
    ------
    UsageError
        The library has no force of formula `x`.

    Notes
    -----
    Le Bot et al. 2019, Sec. 2.3; errors of both frequencies propagated to first order.
    """
    library = library_of(result, whole=True)
    force = library.role("x")
    if force is None:
        raise UsageError(
            f"Library '{library.title}' has no force of formula x, so omega0 has nothing to give."
        )
    if force.symbol in result.force:
        return result
    limit = result.asymptotic_frequency.item()
    slope = 2.0 * limit / omega0**2
    variance = (slope * result.asymptotic_frequency_standard_error.item()) ** 2
    variance += (slope * limit / omega0 * standard_error) ** 2
    added = xr.Dataset(
        {
            "coefficient": ("force", [(limit / omega0) ** 2 - 1.0]),
            "standard_error": ("force", [np.sqrt(variance)]),
            "frequency_covariance": (
                "force",
                [slope * result.asymptotic_frequency_standard_error.item() ** 2],
            ),
            "active": ("force", [True]),
            "refers_to": ("force", [omega0]),
        },
        {"force": [force.symbol]} | _labels([force]),
    )
    count = result.sizes["force"]
    covariance = np.zeros((count + 1, count + 1))
    covariance[:count, :count] = result.covariance
    covariance[count, :count] = covariance[:count, count] = slope * result.frequency_covariance
    covariance[count, count] = variance
    per_force = [name for name in result.variables if result[name].dims == ("force",) and name != "force"]
    longer = xr.concat(
        [result[per_force], added], "force", combine_attrs="override", data_vars="all", coords="all"
    )
    order = [s for s in library.symbols if s in longer.force]
    rest = result.drop_vars([*per_force, "force", "other_force", "covariance"])
    whole = rest.assign(longer.data_vars).assign_coords(other_force=longer.force.values)
    whole["covariance"] = (("force", "other_force"), covariance, result.covariance.attrs)
    whole["omega0"] = ((), omega0, {"units": "rad/s", "long_name": "frequency without contact"})
    whole["omega0_standard_error"] = (
        (),
        standard_error,
        {"units": "rad/s", "long_name": "its standard error"},
    )
    return whole.sel(force=order, other_force=order)


def library_of(result: xr.Dataset, whole: bool = False) -> ForceLibrary:
    """The force library of an identification: the forces it holds, or the whole file it was read from."""
    library = library_of_text(result.attrs["library"], result.attrs["library_source"])
    return library if whole else library.select(result.force.values.tolist())


def model_of(result: xr.Dataset) -> Model:
    """The identified model: active forces that refer to the reference frequency.

    Parameters
    ----------
    result : an identification.

    Returns
    -------
    Model with the coefficients, frequency (rad/s) and shape parameters found, without their errors.
    """
    frequency = result.reference_frequency.item()
    kept = result.active.values & np.isclose(result.refers_to.values, frequency, rtol=1e-12)
    coefficients = dict(
        zip(result.force.values[kept].tolist(), result.coefficient.values[kept].tolist(), strict=True)
    )
    return Model(library_of(result), coefficients, frequency, shape_values_of(result))


def shape_values_of(result: xr.Dataset) -> dict[str, float]:
    """Shape parameters of an identification by name, such as `dahl.s`."""
    if "shape" not in result:
        return {}
    return dict(zip(result.shape_parameter.values.tolist(), result["shape"].values.tolist(), strict=True))


def map_identifications(tree: xr.DataTree, change: Callable[[xr.Dataset], xr.Dataset]) -> xr.DataTree:
    """The tree with `change` applied to each group that is an identification."""
    groups = {k: node.to_dataset() for k, node in tree.children.items()}
    return xr.DataTree.from_dict({k: change(d) if "coefficient" in d else d for k, d in groups.items()})
