"""The format of results: its version, and which attributes are lists of texts."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import RecordError

# Goes up with every change of variables, groups or attributes. Files without it are of version 1.
FORMAT_VERSION = 2

# netCDF gives a list of one text back as the text, and an empty list as an array.
LISTS = (
    *("record_source", "record_checksum", "first_record", "second_record"),
    *("left_out", "failed_fits", "parts", "decimated"),
)


def as_list(value: Any) -> list[str]:
    """A list of texts as netCDF gives it back."""
    return [value] if isinstance(value, str) else np.asarray(value).astype(str).tolist()


def current_format(tree: xr.DataTree, path: Path) -> xr.DataTree:
    """A tree as it was before it was written.

    Parameters
    ----------
    tree : DataTree
        What netCDF gave back.
    path : path
        Its file, for the message.

    Raises
    ------
    RecordError
        The file is of another version of the format.
    """
    for node in tree.subtree:
        version = node.attrs.get("format_version", 1)
        if "sysid_trib_version" in node.attrs and version != FORMAT_VERSION:
            raise RecordError(
                f"{path.name}: a result in format {version}, and this version of sysid_trib reads format "
                f"{FORMAT_VERSION}; make the result again."
            )
        # A record and its envelope have one source, as one text.
        lists = [name for name in LISTS if name in node.attrs and "source" not in node.attrs]
        node.attrs |= {name: as_list(node.attrs[name]) for name in lists}
    return tree
