"""Records of the registry: their files, read by its options unless the user gives others."""

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from sysid_trib.datasets.fetching import files
from sysid_trib.datasets.registry import DATASET, PublishedRecord, dataset_name, published
from sysid_trib.records.column import Column
from sysid_trib.records.reading import Reading
from sysid_trib.records.tables import FileTable


@dataclass(frozen=True)
class NamedFile:
    """A file as the user named it.

    Attributes
    ----------
    path : path
        The file.
    record : PublishedRecord, optional
        Entry of the registry, if it was named by `dataset:NAME`.
    """

    path: Path
    record: PublishedRecord | None = None

    def reading(self, how: Reading) -> Reading:
        """Return options for reading; those that are not given are taken from the registry."""
        if self.record is None:
            return how
        usual = Reading()
        names = (option.name for option in fields(how))
        given = {name for name in names if getattr(how, name) != getattr(usual, name)}
        if "sampling_rate" in given:
            given.add("time")
        stored = {name: value for name, value in self.record.reading.items() if name not in given}
        return replace(how, **stored)

    def whole(self, table: FileTable) -> FileTable:
        """Return the table with columns that the registry joins, and under the name of the record."""
        if self.record is None:
            return table
        source = f"{DATASET}{self.record.name}"
        if not self.record.joined:
            return replace(table, source=source)
        columns = [_joined(table, name, parts) for name, parts in self.record.joined.items()]
        count = max(map(len, self.record.joined.values()))
        said = (*table.said, f"joined from {count} parts")
        return replace(table, source=source, columns=(*columns, *table.columns), said=said)

    def attrs(self) -> dict[str, str]:
        """Return name, licence, citation and address of the source for the attrs of a record."""
        if self.record is None:
            return {}
        return {
            "name": self.record.name,
            "licence": self.record.licence,
            "citation": self.record.citation,
            "source_url": self.record.source,
        }


def _joined(table: FileTable, name: str, parts: tuple[str, ...]) -> Column:
    """Return a column that contains others end to end."""
    cells = np.concatenate([table.find(part).cells for part in parts])
    return Column.of_file(name, cells, table.source)


def named_file(path: str | os.PathLike[str]) -> NamedFile:
    """Return the file of a path, or of `dataset:NAME`, which is downloaded if need be.

    Raises
    ------
    UsageError, RecordError
        As in `datasets.files`.
    """
    name = dataset_name(path)
    if name is None:
        return NamedFile(Path(path))
    record = published(name)
    return NamedFile(files(name)[0], record)
