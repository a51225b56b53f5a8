"""The one schema of an identification: plain xarray, with provenance, saved and read back equal."""

import json
import os
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.errors import RecordError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.library_files import parse_library
from sysid_trib.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """What a method found, before it is labelled.

    Attributes
    ----------
    coefficients : (force,); covariance : (force + 1, force + 1), the last row and column belong to the
        reference frequency (zero where it was given).
    reference_frequency : rad/s.
    noise : rad.
    extra : further scalars with (value, units, long_name).
    """

    coefficients: Array
    covariance: Array
    reference_frequency: float
    noise: float
    extra: Mapping[str, tuple[float, str, str]] = field(default_factory=dict)


def identification(
    method: object,
    decay: xr.Dataset,
    library: ForceLibrary,
    estimate: Estimate,
    *,
    offered: ForceLibrary,
    active: NDArray[np.bool_] | None = None,
) -> xr.Dataset:
    """Label an estimate: the Dataset that every method returns, provenance in its attrs.

    Parameters
    ----------
    library : the forces that were unknowns, in the order of the estimate; offered : all there were to choose from.
    active : which forces were kept; the others have coefficient 0 and the error they would have had.
    """
    symbols = list(library.symbols)
    count = len(symbols)
    covariance = estimate.covariance[:count, :count]
    asymptotic, gradient = asymptotic_frequency(library, estimate.coefficients, estimate.reference_frequency)
    error = float(np.sqrt(max(0.0, gradient @ estimate.covariance @ gradient)))
    shapes = {f"{f.symbol}.{k}": s.default for f in library for k, s in f.shape.items()}
    shapes |= dict(getattr(method, "shapes", None) or {})
    used = np.ones(count, bool) if active is None else np.asarray(active, bool)

    def scalar(value: float, units: str, long_name: str) -> tuple[tuple[()], float, dict[str, str]]:
        return (), float(value), {"units": units, "long_name": long_name}

    scalars = {
        "reference_frequency": scalar(estimate.reference_frequency, "rad/s", "reference frequency w"),
        "reference_frequency_standard_error": scalar(
            np.sqrt(max(0.0, estimate.covariance[count, count])), "rad/s", "its standard error, 0 if given"
        ),
        "asymptotic_frequency": scalar(asymptotic, "rad/s", "frequency at vanishing amplitude"),
        "asymptotic_frequency_standard_error": scalar(error, "rad/s", "its standard error"),
        "noise": scalar(estimate.noise, "rad", "standard deviation of the noise"),
    }
    per_force = {"units": "1", "comment": "unit of each force's coefficient in the coordinate `unit`"}
    variables = {
        "coefficient": ("force", np.where(used, estimate.coefficients, 0.0), per_force | {"long_name": "coefficient"}),
        "standard_error": (
            "force",
            np.sqrt(np.diag(covariance)),
            per_force | {"long_name": "standard error of the coefficient"},
        ),
        "covariance": (("force", "other_force"), covariance, {"units": "1", "long_name": "covariance"}),
        "frequency_covariance": (
            "force",
            (estimate.covariance @ gradient)[:count],
            {"units": "rad/s", "long_name": "covariance with the asymptotic frequency"},
        ),
        "active": ("force", used, {"long_name": "kept in the model"}),
        "refers_to": (
            "force",
            np.full(count, float(estimate.reference_frequency)),
            {"units": "rad/s", "long_name": "frequency to which the coefficient refers"},
        ),
        "shape": ("shape_parameter", list(shapes.values()), {"long_name": "shape parameter", "units": "1"}),
        "shape_standard_error": (
            "shape_parameter",
            np.full(len(shapes), np.nan),
            {"long_name": "standard error, nan where the shape was held", "units": "1"},
        ),
    }
    coords = {
        "force": symbols,
        "other_force": symbols,
        "shape_parameter": np.array(list(shapes), dtype=str),
        "name": ("force", [f.name for f in library]),
        "formula": ("force", [f.formula.text for f in library]),
        "unit": ("force", [f.units for f in library]),
    }
    if not shapes:
        variables = {k: v for k, v in variables.items() if v[0] != "shape_parameter"}
        del coords["shape_parameter"]
    extra = {k: scalar(*v) for k, v in estimate.extra.items()}
    return xr.Dataset(variables | scalars | extra, coords, provenance(method, decay, offered))


def provenance(method: object, decay: xr.Dataset, library: ForceLibrary) -> dict[str, str]:
    """How a result came about: package version, method and options, library text, record."""
    from sysid_trib import __version__

    options = {f.name: getattr(method, f.name) for f in fields(method)} if hasattr(method, "__dataclass_fields__") else {}  # type: ignore[arg-type]
    return {
        "method": type(method).__name__.lower(),
        "options": json.dumps(options, default=str),
        "sysid_trib_version": __version__,
        "library_title": library.title,
        "library_source": library.source,
        "library": library.to_toml(),
        "record_source": str(decay.attrs.get("source", "")),
        "record_checksum": str(decay.attrs.get("record_checksum", "")),
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
    omega0, standard_error : frequency of the oscillator without contact and its error, rad/s.

    Returns
    -------
    The identification with one force more (the library's force of formula `x`), which refers to `omega0`;
    the others stay referred to the fitted frequency. An identification that has it already is returned as it is.

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
        raise UsageError(f"Library '{library.title}' has no force of formula x, so omega0 has nothing to give.")
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
            "frequency_covariance": ("force", [slope * result.asymptotic_frequency_standard_error.item() ** 2]),
            "active": ("force", [True]),
            "refers_to": ("force", [omega0]),
        },
        {
            "force": [force.symbol],
            "name": ("force", [force.name]),
            "formula": ("force", [force.formula.text]),
            "unit": ("force", [force.units]),
        },
    )
    count = result.sizes["force"]
    covariance = np.zeros((count + 1, count + 1))
    covariance[:count, :count] = result.covariance
    covariance[count, :count] = covariance[:count, count] = slope * result.frequency_covariance
    covariance[count, count] = variance
    per_force = [name for name in result.variables if result[name].dims == ("force",) and name != "force"]
    longer = xr.concat([result[per_force], added], "force", combine_attrs="override", data_vars="all", coords="all")
    order = [s for s in library.symbols if s in longer.force]
    rest = result.drop_vars([*per_force, "force", "other_force", "covariance"])
    whole = rest.assign(longer.data_vars).assign_coords(other_force=longer.force.values)
    whole["covariance"] = (("force", "other_force"), covariance, result.covariance.attrs)
    whole["omega0"] = ((), omega0, {"units": "rad/s", "long_name": "frequency without contact"})
    whole["omega0_standard_error"] = ((), standard_error, {"units": "rad/s", "long_name": "its standard error"})
    return whole.sel(force=order, other_force=order)


def library_of(result: xr.Dataset, whole: bool = False) -> ForceLibrary:
    """The force library of an identification: the forces it holds, or the whole file it was read from."""
    library = parse_library(tomllib.loads(result.attrs["library"]), result.attrs["library_source"])
    return library if whole else library.select(result.force.values.tolist())


def model_of(result: xr.Dataset) -> Model:
    """The identified model: active forces that refer to the reference frequency."""
    frequency = result.reference_frequency.item()
    kept = result.active.values & np.isclose(result.refers_to.values, frequency, rtol=1e-12)
    coefficients = dict(zip(result.force.values[kept].tolist(), result.coefficient.values[kept].tolist(), strict=True))
    shapes: dict[str, float] = {}
    if "shape" in result:
        shapes = dict(zip(result.shape_parameter.values.tolist(), result.shape.values.tolist(), strict=True))
    return Model(library_of(result), coefficients, frequency, shapes)


def map_identifications(tree: xr.DataTree, change: Callable[[xr.Dataset], xr.Dataset]) -> xr.DataTree:
    """The tree with `change` applied to each group that is an identification."""
    groups = {k: node.to_dataset() for k, node in tree.children.items()}
    return xr.DataTree.from_dict({k: change(d) if "coefficient" in d else d for k, d in groups.items()})


def save(result: xr.Dataset | xr.DataTree, path: str | os.PathLike[str]) -> None:
    """Write a result as netCDF: beside its place first, then renamed, so that no half file is left."""
    target = Path(path)

    write_beside(target, lambda beside: result.to_netcdf(beside, engine="h5netcdf"))


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure as PDF and PNG beside each other, its folder made if need be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{path.parent}: cannot be made ({error.strerror}); choose another folder.") from None
    for suffix in (".pdf", ".png"):
        write_beside(path.with_suffix(suffix), lambda beside: figure.savefig(beside, dpi=200))


def write_beside(target: Path, write: Callable[[str], Any]) -> None:
    """Call `write(temporary path)` in the target's folder and rename the file to `target`."""
    try:
        handle, beside = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}-", suffix=target.suffix)
        os.close(handle)
    except OSError as error:
        reason = error.strerror or error
        raise RecordError(f"{target}: cannot be written ({reason}); choose another place with -o.") from None
    try:
        write(beside)
        # mkstemp makes files that only their owner may read.
        os.chmod(beside, 0o666 & ~_umask())
        os.replace(beside, target)
    except OSError as error:
        reason = error.strerror or error
        raise RecordError(f"{target}: cannot be written ({reason}); choose another place with -o.") from None
    finally:
        Path(beside).unlink(missing_ok=True)


def load(path: str | os.PathLike[str]) -> xr.DataTree:
    """Read a result back from netCDF; RecordError if it is none."""
    try:
        tree = xr.open_datatree(path, engine="h5netcdf")
    except FileNotFoundError:
        raise UsageError(f"There is no file {path}.") from None
    except (OSError, ValueError) as error:
        raise RecordError(f"{Path(path).name}: not a result in netCDF ({error}).") from None
    with tree:
        return tree.load()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
