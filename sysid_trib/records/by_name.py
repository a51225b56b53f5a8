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
    >>> record = st.datasets.load("ship_roll")  # doctest: +SKIP
    >>> decay = st.free_decay(record, window=(25.0, None))  # doctest: +SKIP
    """
    return read_record(f"{DATASET}{name}")
