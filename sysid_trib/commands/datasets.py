"""The command `datasets`: a list of the records that anybody can have."""

from collections.abc import Callable
from functools import partial

from sysid_trib.commands.options import DatasetsOptions
from sysid_trib.commands.terminal import print_json, print_table
from sysid_trib.datasets.registry import DATASET, registry, table
from sysid_trib.errors import Tell
from sysid_trib.printing.layout import text_table


def datasets(tell: Tell, given: DatasetsOptions) -> Callable[[], None]:
    """List the datasets."""
    if given.as_json:
        rows = table().reset_index().to_dict("records")
        known = {name: record.known for name, record in registry().items()}
        return partial(print_json, {"datasets": [{**row, "known": known[row["name"]]} for row in rows]})
    return _print


def _print() -> None:
    heads = ("RECORD", "kind", "licence", "title")
    rows = [
        dict(zip(heads, (f"{DATASET}{name}", record.kind, record.licence, record.title), strict=True))
        for name, record in registry().items()
    ]
    print_table(text_table(rows, heads))
    print("\nSources, citations and what is known beforehand: sysid-trib datasets --json")
    print("Next: sysid-trib look dataset:certified/three_frictions_1e-3")
