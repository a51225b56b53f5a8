"""A record of the registry by its name."""

import xarray as xr

from sysid_trib.datasets.registry import DATASET
from sysid_trib.records.read import read_record


def load(name: str) -> xr.Dataset:
    """Read a record of the registry; the same as `read_record("dataset:NAME")`.

    Parameters
    ----------
    name : str
        Name of the record, one of `names()`.

    Returns
    -------
    Dataset
        As `read_record` returns it. Attrs also contain `name`, `licence`, `source` (`dataset:NAME`),
        `source_url` and `citation`.

    Raises
    ------
    UsageError, RecordError
        As in `files`.

    Examples
    --------
    A certified decay belongs to the package; a measured record, such as `ship_roll`, is downloaded once.

    >>> import sysid_trib as st
    >>> record = st.datasets.load("certified/viscous_1e-4")
    >>> found = st.identify(record, "zeta", "direct")
    >>> found.coefficient.round(5).item(), st.datasets.truth("certified/viscous_1e-4").value[0].item()
    (0.01, 0.01)
    """
    return read_record(f"{DATASET}{name}")
