"""The list of records by name: title, licence, source, checksums, and how each is read."""

import csv
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from sysid_trib.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    import pandas as pd

# Prefix of a name where a file is expected: `dataset:ship_roll`.
DATASET = "dataset:"
# Folder of the certified decays, and where the project publishes it.
CERTIFIED = Path(__file__).with_name("certified")
OWN_REPOSITORY = "sysid-trib/sysid_trib"


@dataclass(frozen=True, kw_only=True)
class RowsOfText:
    """Part of a text table that becomes a file with a clock.

    Attributes
    ----------
    columns : tuple of str
        Names of the columns in the source, in the order of the file that is written.
    header : str
        First line of that file.
    first, last : int
        First and last row of the source, counted from 0 below its header.
    rate : float, Hz
        Sampling rate from which the clock is written; it starts at 0 s.
    decimals : int
        Number of decimals of the clock.
    """

    columns: tuple[str, ...]
    header: str
    first: int
    last: int
    rate: float
    decimals: int


@dataclass(frozen=True, kw_only=True)
class RowOfCells:
    """Row of a MATLAB cell array, `{time, signal}`, that becomes a text table.

    Attributes
    ----------
    variable : str
        Name of the cell array.
    row : int
        Number of the row from 0.
    header : str
        First line of the file that is written.
    """

    variable: str
    row: int
    header: str


@dataclass(frozen=True, kw_only=True)
class PublishedFile:
    """A file of a record.

    Attributes
    ----------
    local : str
        Path within a folder of data, or within the cache.
    path : str
        Path within the repository of the source.
    sha256 : str
        Checksum of the local file; where the source is converted, of the file that this gives. Empty for a
        file of the package.
    bytes : int
        Size of the local file.
    rows, cells : RowsOfText, RowOfCells, optional
        Conversion of the source, if it is not used as it is.
    """

    local: str
    path: str
    sha256: str
    bytes: int
    rows: RowsOfText | None = None
    cells: RowOfCells | None = None


@dataclass(frozen=True, kw_only=True)
class PublishedRecord:
    """A record that anybody can have.

    Attributes
    ----------
    name, title : str
        Name in the registry, and description.
    kind : {"measured", "driven", "certified"}
        Free decay of an experiment, record with inputs, or simulated decay with exact truth.
    licence, citation : str
        Licence of the source, and how to cite it.
    known : str
        What is known beforehand.
    repository, commit : str
        Public repository on GitHub, and its state.
    files : tuple of PublishedFile
        Files; the first contains the signal.
    reading : mapping of str to object
        Options for reading, as fields of `Reading`.
    joined : mapping of str to (sequence of str)
        Columns that are joined end to end, by the name of the joined column.
    """

    name: str
    title: str
    kind: str
    licence: str
    citation: str
    known: str
    repository: str
    commit: str
    files: tuple[PublishedFile, ...]
    reading: Mapping[str, Any] = field(default_factory=dict)
    joined: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def source(self) -> str:
        """Page of the source: of its file, or of its folder if there are several."""
        paths = [file.path for file in self.files]
        kind, path = ("blob", paths[0]) if len(paths) == 1 else ("tree", str(PurePath(paths[0]).parent))
        return f"https://github.com/{self.repository}/{kind}/{self.commit}/{quote(path)}"

    def url(self, file: PublishedFile) -> str:
        """Return the address from which a file is downloaded."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{quote(file.path)}"


@cache
def registry() -> dict[str, PublishedRecord]:
    """Return the records by name."""
    text = Path(__file__).with_name("records.toml").read_text(encoding="utf-8")
    fetched = {name: _record_of(name, entry) for name, entry in tomllib.loads(text).items()}
    return fetched | {name: _certified_record(row) for name, row in certified_rows().items()}


@cache
def certified_rows() -> dict[str, dict[str, str]]:
    """Return the rows of the table of certified decays by their names."""
    with (CERTIFIED / "decays.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def _certified_record(row: Mapping[str, str]) -> PublishedRecord:
    local = f"{row['name']}.csv.gz"
    file = PublishedFile(
        local=local,
        path=f"sysid_trib/datasets/{local}",
        sha256="",
        bytes=(CERTIFIED.parent / local).stat().st_size,
    )
    return PublishedRecord(
        name=row["name"],
        title=row["title"],
        kind="certified",
        licence="BSD-3-Clause",
        citation="sysid_trib contributors, certified free decays",
        known=row["equation"],
        repository=OWN_REPOSITORY,
        commit="main",
        files=(file,),
    )


def _record_of(name: str, entry: dict[str, Any]) -> PublishedRecord:
    files = tuple(_file_of(file) for file in entry.pop("file"))
    joined = {column: tuple(parts) for column, parts in entry.pop("joined", {}).items()}
    return PublishedRecord(name=name, files=files, joined=joined, **entry)


def _file_of(entry: dict[str, Any]) -> PublishedFile:
    rows = entry.pop("rows", None)
    cells = entry.pop("cells", None)
    return PublishedFile(
        **entry,
        rows=None if rows is None else RowsOfText(**rows | {"columns": tuple(rows["columns"])}),
        cells=None if cells is None else RowOfCells(**cells),
    )


def published(name: str) -> PublishedRecord:
    """Return the record with a name.

    Raises
    ------
    UsageError
        There is no such record.
    """
    known = registry()
    if name not in known:
        nearest = did_you_mean(name, known)
        raise UsageError(f"There is no dataset '{name}'.{nearest} sysid-trib datasets lists them.")
    return known[name]


def dataset_name(path: str | os.PathLike[str]) -> str | None:
    """Return NAME for a path `dataset:NAME`; None for any other path."""
    text = path if isinstance(path, str) else PurePath(path).as_posix()
    return text.removeprefix(DATASET) if text.startswith(DATASET) else None


def names() -> list[str]:
    """Return the names of all records, which `load` and `dataset:NAME` take.

    Returns
    -------
    list of str
        Measured and driven records first, then the certified decays.

    Examples
    --------
    >>> import sysid_trib as st
    >>> names = st.datasets.names()
    >>> "ship_roll" in names, sum(name.startswith("certified/") for name in names)
    (True, 36)
    """
    return list(registry())


def table() -> "pd.DataFrame":
    """Return a table of all records.

    Returns
    -------
    DataFrame
        Index `name`; columns `title`, `kind` (measured, driven or certified), `licence`, `source` (address
        of its page), `citation`, `bytes` (size of its files).

    Examples
    --------
    >>> import sysid_trib as st
    >>> table = st.datasets.table()
    >>> table.loc["certified/viscous_1e-4", ["kind", "licence"]].tolist()
    ['certified', 'BSD-3-Clause']
    """
    import pandas as pd

    rows = {
        record.name: {
            "title": record.title,
            "kind": record.kind,
            "licence": record.licence,
            "source": record.source,
            "citation": record.citation,
            "bytes": sum(file.bytes for file in record.files),
        }
        for record in registry().values()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("name")
