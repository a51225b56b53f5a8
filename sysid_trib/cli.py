"""The program: it runs a command and reports an error in one line.

Only few modules are imported before it handles Ctrl-C, which may come while the commands are imported.
"""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130
OUT_OF_MEMORY = "Out of memory; take a shorter window or a lower sampling rate, or raise the limit."
# Bytes of memory needed to load the largest binary libraries.
LIBRARY_SIZE = 2**28


def main() -> None:
    """Run the command line: errors in one line on stderr, exit status as documented.

    The process ends with this function, so it ignores further interrupts.
    """
    came: list[int] = []

    # If the import of a library is interrupted, it may suppress the interrupt, or raise another error.
    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        came.append(number)
        raise KeyboardInterrupt

    status, message = INTERRUPTED, ""
    try:
        signal.signal(signal.SIGINT, interrupt)
        sys.unraisablehook = _pass_interrupts_over
        status, message = _outcome()
    except KeyboardInterrupt:
        # The interrupt came before the command began, or was the second one.
        came.append(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if came or status == INTERRUPTED:
        status, message = INTERRUPTED, "interrupted."
    if message:
        from sysid_trib.errors import printable

        print(f"sysid-trib: {printable(message)}", file=sys.stderr)
    # Python ends by a signal, whatever the exit status, if an interrupt came during the last text passed to
    # `exec`, as in the import of a dataclass. This is a new last text.
    exec("")
    sys.exit(status)


def _pass_interrupts_over(unraisable: "sys.UnraisableHookArgs") -> None:
    """Suppress the message of an interrupt that arrived where no exception can be raised."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


def _outcome() -> tuple[int, str]:
    """Run the command; return its exit status and, if it failed, the line for stderr."""
    import warnings

    from sysid_trib.errors import internal_error_text

    # A closed stream is None.
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (as long as the process)
    if sys.stdout is None:
        return 1, "standard output is closed; send it to a file, or to /dev/null."
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe without UTF-8 must not raise an exception for ±.
        stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    with warnings.catch_warnings():
        # Warnings of numerical libraries are too technical; relevant ones are in the result, or are errors
        # here.
        warnings.showwarning = lambda *_, **__: None
        try:
            return _run()
        except MemoryError:
            return 1, OUT_OF_MEMORY
        except Exception as error:
            return 1, OUT_OF_MEMORY if _memory_is_short() else internal_error_text(error)


def _run() -> tuple[int, str]:
    """Run the command; return its exit status and the error that ended it."""
    import typer

    from sysid_trib.commands.app import app
    from sysid_trib.errors import SysidTribError

    # Depending on its version, typer contains click or uses the installed one: this finds the class.
    click_error: type[Exception] = next(
        k for k in typer.BadParameter.__mro__ if k.__name__ == "ClickException"
    )
    try:
        status = app(prog_name="sysid-trib", standalone_mode=False) or 0
        sys.stdout.flush()
        return status, ""
    except SysidTribError as error:
        return error.exit_status, str(error)
    except click_error as error:
        said = error.format_message()  # type: ignore[attr-defined]
        return 2, f"{said}{'' if said.endswith(('.', '?')) else '.'} See sysid-trib --help."
    except typer.Abort:
        return INTERRUPTED, ""
    except SystemExit as end:
        # Completion in a shell ends with 0. Typer ends with 1 if the reader of a pipe has closed it.
        if end.code:
            _leave_standard_output()
        return 0, ""
    except OSError as error:
        if error.filename is not None:
            return 1, f"{error.filename}: {error.strerror}; choose another file."
        _leave_standard_output()
        if isinstance(error, BrokenPipeError):
            return 0, ""
        return 1, f"standard output cannot be written: {error.strerror or error}."


def _leave_standard_output() -> None:
    """Redirect standard output, so that buffered text cannot fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _memory_is_short() -> bool:
    """Return true if memory is almost used up. Imports of libraries then fail with various errors."""
    try:
        bytearray(LIBRARY_SIZE)
    except MemoryError:
        return True
    return False
