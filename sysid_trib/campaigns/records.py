"""The records of a campaign: files, decays in memory, or a study."""

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.campaigns.study import Study
from sysid_trib.campaigns.task import Task
from sysid_trib.errors import UsageError, readable

# Of what a store holds; one of another format is of another version.
STORE_FORMAT = 2


@dataclass(frozen=True)
class CampaignRecords:
    """Files, decays in memory, or the numbers of a study, each with its name.

    Parameters
    ----------
    items : sequence of path or Dataset, or Study

    Raises
    ------
    UsageError
        There are none.
    """

    items: Sequence[Any] | Study

    def __post_init__(self) -> None:
        if isinstance(self.items, str | os.PathLike | xr.Dataset) or not len(self.items):
            raise UsageError("A campaign wants a list of records, of one at least.")

    def __len__(self) -> int:
        return len(self.items)

    @property
    def simulated(self) -> bool:
        """True if the truth of each is known."""
        return isinstance(self.items, Study)

    @property
    def names(self) -> list[str]:
        """The names of the records in the store."""
        if isinstance(self.items, Study):
            return [str(at) for at in range(len(self))]
        return [
            readable(
                str(item.attrs.get("source", f"record {at}")) if isinstance(item, xr.Dataset) else str(item)
            )
            for at, item in enumerate(self.items)
        ]

    def record(self, at: int) -> Any:
        """A record as `rows_of` takes it."""
        if isinstance(self.items, Study):
            return self.items, int(at)
        item = self.items[at]
        return item if isinstance(item, xr.Dataset) else os.fspath(item)

    def fingerprint(self, task: Task) -> str:
        """What a store must have been begun with to be gone on with: version, task, names, content."""
        return _digest([self.fingerprint_of_task(task), self.names, self._content()])

    def fingerprint_of_task(self, task: Task) -> str:
        """A checksum without the records: of files and of a study more may come."""
        libraries = [library.to_toml() for library in (task.library, task.candidates) if library is not None]
        methods = {label: repr(method) for label, method in task.methods.items()}
        asked = [task.name, task.judged, methods, repr(task.constraints), repr(task.contactless)]
        options = sorted((name, repr(value)) for name, value in task.options.items())
        study = asdict(self.items) | {"records": None} if isinstance(self.items, Study) else None
        in_memory = self._content() if study is None else []
        return _digest(
            [
                __version__,
                STORE_FORMAT,
                study,
                in_memory,
                libraries,
                asked,
                options,
                _callable_text(task.read),
            ]
        )

    def _content(self) -> Any:
        """What a study, or what is in memory, holds; files say themselves when they change."""
        if isinstance(self.items, Study):
            return asdict(self.items)
        in_memory = [item for item in self.items if isinstance(item, xr.Dataset)]
        return [hashlib.sha256(item["angle"].values.tobytes()).hexdigest() for item in in_memory]


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _callable_text(read: Any) -> str:
    """What is called, without its address in memory."""
    inner = getattr(read, "func", read)
    given = (getattr(read, "args", ()), getattr(read, "keywords", {}))
    return f"{inner.__module__}.{inner.__qualname__} {given!r}"
