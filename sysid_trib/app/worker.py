"""A process that does the work of one page, so that the page responds and the work can be stopped."""

import multiprocessing
import signal
import warnings
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from sysid_trib.app import messages, tasks

DONE = "done"
STOPPED = (
    "The computation was stopped by the system, probably because memory was short: choose a shorter window."
)


class Worker:
    """One process, started when it is first needed; a new request replaces the running one."""

    def __init__(self) -> None:
        self._process: Any = None
        self._pipe: Any = None
        self.busy = False

    def start(self, request: messages.Request) -> None:
        """Start a request; a running one ends at once."""
        if self.busy:
            self.stop()
        if self._process is None or not self._process.is_alive():
            self._start_process()
        self._pipe.send(request)
        self.busy = True

    def _start_process(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other,), daemon=True)
        # Ctrl-C goes to all processes of a terminal; the server ends this one.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            self._process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        other.close()

    def stop(self) -> None:
        """End the process at once."""
        self.busy = False
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def messages(self) -> Iterator[Any]:
        """Yield the messages that the process has sent since the last call."""
        try:
            while self.busy and self._pipe.poll():
                message = self._pipe.recv()
                self.busy = message != DONE
                if self.busy:
                    yield message
        except (EOFError, OSError):
            self.stop()
            yield messages.Failure(STOPPED)


def _work(pipe: Connection) -> None:
    """Do requests until the other end is closed."""
    import scipy.linalg  # noqa: F401 (its threads can be limited once it is loaded)
    from threadpoolctl import threadpool_limits

    def tell(activity: str, done: float | None = None) -> None:
        pipe.send(messages.Progress(activity, done))

    # The result states everything important that a warning says.
    warnings.simplefilter("ignore")
    with threadpool_limits(1, user_api="blas"):
        try:
            while True:
                request = pipe.recv()
                for message in tasks.messages_of(request, tell):
                    pipe.send(message)
                pipe.send(DONE)
        except (EOFError, OSError):
            return
