"""The server of the page: it listens on this machine only, and ends at Ctrl-C."""

import signal
import socket
import tempfile
import webbrowser
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import sysid_trib as st

ADDRESS = "127.0.0.1"


def serve(file: Path | None, port: int, *, open_browser: bool) -> None:
    """Serve the page until Ctrl-C.

    Parameters
    ----------
    file : Path or None
        A record that each new page shows first.
    port : int
        The next free port is taken if this one is in use.
    open_browser : bool
        True to open the page in the browser.

    Raises
    ------
    SysidTribError
        Panel is not installed, or there is no free port.
    UsageError
        There is no such file.
    """
    if find_spec("panel") is None:
        raise st.errors.SysidTribError("The app needs panel: pip install -e '.[app]' in a clone.")
    if file is not None and not file.is_file():
        raise st.errors.UsageError(f"{file}: there is no such file.")
    import panel

    from sysid_trib.app.page import Page

    port = _free_port(port)
    url = f"http://{ADDRESS}:{port}/"
    with tempfile.TemporaryDirectory(prefix="sysid-trib-") as folder:
        server: Any = panel.serve(
            {"/": lambda: Page(Path(tempfile.mkdtemp(dir=folder)), file).template},
            port=port,
            address=ADDRESS,
            # A page of another origin must not talk to this server.
            websocket_origin=[f"{ADDRESS}:{port}", f"localhost:{port}"],
            title="sysid_trib",
            show=False,
            start=False,
            verbose=False,
        )
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: server.io_loop.add_callback_from_signal(server.io_loop.stop))
        print(f"The app runs at {url} and ends with Ctrl-C.", flush=True)
        if open_browser:
            server.io_loop.call_later(0.1, webbrowser.open, url)
        server.start()
        server.io_loop.start()
        server.stop()


def _free_port(wanted: int) -> int:
    """Return this port, or another one if it is in use."""
    for port in (wanted, 0):
        with socket.socket() as tried:
            try:
                tried.bind((ADDRESS, port))
            except OSError:
                continue
            return int(tried.getsockname()[1])
    raise st.errors.SysidTribError(f"There is no free port on {ADDRESS}; end another program.")
