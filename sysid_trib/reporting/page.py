"""The page itself: rendered whole, written beside its place and renamed."""

import os
from pathlib import Path

import xarray as xr
from jinja2 import Environment, PackageLoader

from sysid_trib.errors import RecordError, SysidTribError, UsageError
from sysid_trib.reporting import provenance, reproducing
from sysid_trib.reporting.contents import contents_of
from sysid_trib.reporting.parts import Page
from sysid_trib.reporting.svg import inline_svg
from sysid_trib.results.files import write_file
from sysid_trib.results.kinds import kind_of


def report(result: xr.DataTree | xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a result as one self-contained page: text, tables, figures.

    Parameters
    ----------
    result : xr.DataTree or xr.Dataset
        Result of `cross_check`, `compare`, `discover` or `identify`.
    path : path-like
        The page, HTML. It asks the network for nothing, and holds no script.

    Raises
    ------
    UsageError
        Not such a result.
    RecordError
        A result that lacks a part, as one of another version may; a page that cannot be written.
    """
    write_page(page(result), Path(path))


def write_page(text: str, path: Path) -> None:
    """Write a page; an older file is replaced only by a whole one."""
    write_file(path, text.encode())


def page(result: xr.DataTree | xr.Dataset) -> str:
    """The page as text (see `report`)."""
    tree = xr.DataTree(result) if isinstance(result, xr.Dataset) else result
    if not isinstance(tree, xr.DataTree) or not kind_of(tree):
        raise UsageError(
            f"A report is of a result of identify, cross_check, compare or discover, not of {_named(result)}."
        )
    try:
        return _rendered(tree)
    except SysidTribError:
        raise
    # Of a result that was edited any part may be missing, or of another form.
    except Exception as error:
        reason = " ".join(str(error).split())
        raise RecordError(f"The result is not whole ({reason}); make it again with this version.") from error


def _rendered(tree: xr.DataTree) -> str:
    title, summary, sections = contents_of(tree)
    return rendered(
        Page(
            title,
            provenance.kept_records(tree) or [{"source": "; ".join(tree.attrs.get("record_source", []))}],
            [*summary, *_next(tree)],
            sections,
            provenance.facts(tree),
            provenance.method_table(tree),
            provenance.libraries(tree),
            tree.attrs.get("command", ""),
            reproducing.python_text(tree),
        )
    )


def rendered(content: Page) -> str:
    """A page as text, with all that it shows."""
    environment = Environment(
        loader=PackageLoader("sysid_trib", "reporting"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals["inline_svg"] = inline_svg
    return environment.get_template("page.html").render(**vars(content))


def _next(tree: xr.DataTree) -> list[str]:
    """The command that follows, where a command made the result."""
    return [f"Next: {tree.attrs['next']}"] if tree.attrs.get("next") else []


def _named(result: object) -> str:
    if isinstance(result, xr.DataTree | xr.Dataset):
        parts = [*getattr(result, "children", ()), *result.data_vars]
        return f"data with {', '.join(map(str, parts[:6])) or 'nothing in it'}"
    return type(result).__name__
