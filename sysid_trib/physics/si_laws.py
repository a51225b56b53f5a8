"""The laws of an identification in SI units, and the coefficient of friction against sliding speed."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import UsageError
from sysid_trib.physics.model_estimate import check_quantity
from sysid_trib.physics.si_units import Measured, check_angle_unit, check_length_unit, check_measured
from sysid_trib.records.unit_tables import METRES
from sysid_trib.results.judged import best
from sysid_trib.results.kinds import MU
from sysid_trib.results.law_curves import LAWS_SI, VARIABLE_OF_LAW
from sysid_trib.results.variables import described, signal_units
from sysid_trib.smooth_laws.bands import band
from sysid_trib.smooth_laws.calibration import slope

# Units of the laws of an angle, and of a displacement.
OF_DISPLACEMENT = {"N m": "N", "(N m)^2": "N^2", "rad/s": "m/s", "rad": "m"}


def laws_in_si(
    result: xr.Dataset | xr.DataTree,
    *,
    inertia: Measured | None = None,
    mass: Measured | None = None,
    load: Measured | None = None,
    radius: Measured | None = None,
) -> xr.Dataset:
    """Return friction and restoring force in SI units, and the coefficient of friction against speed.

    Parameters
    ----------
    result : Dataset or DataTree
        Result of `laws`, or one of its identifications: for an angle with an inertia, for a displacement with
        a mass.
    inertia : (float, float), kg m^2
        Moment of inertia and its standard error; the other pairs have the same form.
    mass : (float, float), kg
        Mass, for a displacement in a unit of length.
    load : (float, float), N
        Normal load of the contact.
    radius : (float, float), m
        Friction radius, for an angle, see `in_si_units`.

    Returns
    -------
    Dataset
        `friction(speed)`, N m over rad/s, or N over m/s; `restoring(displacement)`, N m over rad, or N over
        m; with a load also `friction_coefficient(speed)` (1) and the coordinate `sliding_speed(speed)` (m/s).
        Each has `_standard_error`, `_low`, `_high` (a simultaneous 95 % band over the visited range) and
        `_covariance`. Also `speed_visited`, `displacement_visited`, and the given quantities with their
        errors. attrs: `of_method`.

    Raises
    ------
    UsageError
        A result without laws, a quantity that is missing or not positive, or a unit of the signal that does
        not fit the inertia or the mass.

    Notes
    -----
    The laws of a result are forces divided by the inertia. Errors of inertia or mass, load and radius are
    common to all speeds. The error of the radius also changes the sliding speed of the contact: mu(u) =
    T(u/r)/(N r) changes by -(mu + u mu')/r. The error of the calibration is in the result
    (`with_scale_error`).

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3).angle
    >>> angle = angle + np.random.default_rng(0).normal(0.0, 1e-4, 400)
    >>> measured = {"inertia": (0.012, 0.0), "load": (2.0, 0.0), "radius": (0.01, 0.0)}
    >>> laws = st.physics.laws_in_si(st.laws(angle), **measured)
    >>> laws.friction_coefficient.interp(speed=1.0).round(2).item(), round(0.012 * 2 * 0.01 * 9.91 / 0.02, 2)
    (0.12, 0.12)
    """
    given = {"inertia": inertia, "mass": mass, "load": load, "radius": radius}
    known = {name: pair for name, pair in given.items() if pair is not None}
    check_measured(known.keys())
    for name, pair in known.items():
        check_quantity(name, *pair)
    laws = _with_laws(result)
    unit = signal_units(laws)
    if mass is not None:
        check_length_unit(unit)
    else:
        check_angle_unit(unit)
    length = 1.0 if mass is None else METRES[unit]
    size, error = known["inertia" if mass is None else "mass"]
    values: dict[str, Any] = {}
    for law, variable in VARIABLE_OF_LAW.items():
        if law not in laws:
            continue
        force = size * length * laws[law].values
        covariance = (size * length) ** 2 * laws[f"{law}_covariance"].values
        covariance = covariance + (error / size) ** 2 * np.outer(force, force)
        values |= _curve(law, force, covariance, laws[f"{variable}_visited"].values)
        values[variable] = length * laws[variable].values
        values[f"other_{variable}"] = values[variable]
        values[f"{variable}_visited"] = laws[f"{variable}_visited"].values
    if load is not None:
        arm = 1.0 if radius is None else radius[0]
        values["sliding_speed"] = arm * values["speed"]
        mu = values["friction"] / (load[0] * arm)
        covariance = values["friction_covariance"] / (load[0] * arm) ** 2
        covariance = covariance + (load[1] / load[0]) ** 2 * np.outer(mu, mu)
        if radius is not None:
            by_radius = (radius[1] / arm) * (mu + values["speed"] * slope(values["speed"], mu))
            covariance = covariance + np.outer(by_radius, by_radius)
        values |= _curve(MU, mu, covariance, values["speed_visited"])
    data = xr.Dataset(described(LAWS_SI, values | known), attrs={"of_method": str(laws.attrs["method"])})
    if mass is not None:
        for name in map(str, data.variables):
            units = data[name].attrs.get("units")
            data[name].attrs |= {"units": OF_DISPLACEMENT[units]} if units in OF_DISPLACEMENT else {}
    return data.set_coords([name for name in ("sliding_speed",) if name in data])


def law_table(data: xr.Dataset, law: str = "friction") -> pd.DataFrame:
    """Return a law as a table, one row per speed or displacement, for CSV (`to_csv`) or LaTeX (`to_latex`).

    Parameters
    ----------
    data : Dataset
        Result of `laws_in_si`, or an identification of `laws`.
    law : {"friction", "restoring", "friction_coefficient"}
        Name of the law.

    Returns
    -------
    DataFrame
        Columns with their units: speed (for a coefficient of friction the sliding speed) or displacement, the
        law, its standard error, the ends of its band, and whether the record visits this point.

    Raises
    ------
    UsageError
        The data do not contain this law.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3).angle
    >>> angle = angle + np.random.default_rng(0).normal(0.0, 1e-4, 400)
    >>> table = st.physics.law_table(st.best(st.laws(angle)), "friction")
    >>> print(table.iloc[[-5, -1], :2].round(2).to_string(index=False))
     speed (rad/s)  friction (rad/s^2)
              3.37                0.69
              3.66                0.77
    """
    if f"{law}_low" not in data:
        raise UsageError(
            f"These data contain no {law}(...): identify the laws, and give the quantities for SI units."
        )
    variable = str(data[law].dims[0])
    along = "sliding_speed" if law == MU else variable
    names = [along, law, *(f"{law}_{end}" for end in ("standard_error", "low", "high"))]
    columns = {f"{name} ({data[name].attrs.get('units', '1')})": data[name].values for name in names}
    return pd.DataFrame(columns | {"visited": data[f"{variable}_visited"].values})


def _curve(name: str, values: Array, covariance: Array, visited: Mask) -> dict[str, Array]:
    return {name: values, f"{name}_covariance": covariance} | band(name, values, covariance, visited)


def _with_laws(result: xr.Dataset | xr.DataTree) -> xr.Dataset:
    """Return the preferred identification, which must contain laws.

    Raises
    ------
    UsageError
        It contains no laws.
    """
    laws = best(result)
    if "friction_covariance" not in laws:
        raise UsageError(
            "This result contains no friction law; identify the laws first (sysid-trib laws, st.laws)."
        )
    return laws
