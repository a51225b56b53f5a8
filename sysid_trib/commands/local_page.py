"""Command `app`: a page in the browser for people without a terminal."""

from collections.abc import Callable
from functools import partial

from sysid_trib.app.server import serve
from sysid_trib.commands.options import AppOptions
from sysid_trib.errors import Tell


def app(tell: Tell, given: AppOptions) -> Callable[[], None]:
    """Serve the page until Ctrl-C."""
    return partial(serve, given.record, given.port, open_browser=not given.no_browser)
