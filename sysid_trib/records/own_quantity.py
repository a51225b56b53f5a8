"""Driven records whose rate or acceleration is itself compared with the motion."""

import xarray as xr

from sysid_trib.records.inputs import integral_of_rate


def with_own_quantity(record: xr.Dataset) -> xr.Dataset:
    """Return a driven record whose measured rate or acceleration is the compared quantity.

    Parameters
    ----------
    record : Dataset
        Record as it was read, with `angle(time)`, and `rate(time)` or `acceleration(time)` (attribute
        `measured`).

    Returns
    -------
    Dataset
        `measured(measured_time)`, the measured quantity. For a rate, `angle(time)` is its plain integral,
        which keeps a slow driven motion; for another quantity it is that of the record.
    """
    name = record.attrs.get("measured")
    if not record.attrs.get("integrations"):
        return record
    measured = record[name]
    time = record.time.values.astype(float)
    attrs = dict(measured.attrs) | {"long_name": f"{name} as measured"}
    at = {"measured_time": ("measured_time", time, {"units": "s", "long_name": "time"})}
    record = record.assign(measured=xr.DataArray(measured.values, at, "measured_time", attrs=attrs))
    if name == "rate":
        record = record.assign(angle=record.angle.copy(data=integral_of_rate(time, measured.values)))
    said = f"the {name} itself is compared with the motion; its integral is where the fit begins"
    return record.assign_attrs(integration=said)
