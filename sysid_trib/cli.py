"""The command line. Commands import what they need when they run, so that --help is quick."""

import os
import sys
import traceback
import warnings
from pathlib import Path

import typer

from sysid_trib._version import __version__
from sysid_trib.commands.backbone import backbone
from sysid_trib.commands.campaign import campaign
from sysid_trib.commands.compare import compare
from sysid_trib.commands.discover import discover
from sysid_trib.commands.forces import forces
from sysid_trib.commands.identify import identify
from sysid_trib.commands.look import look
from sysid_trib.commands.report import report
from sysid_trib.commands.simulate import simulate
from sysid_trib.errors import SysidTribError, printable

INTERRUPTED = 130
OUT_OF_MEMORY = "Out of memory; take a shorter window or a lower sampling rate, or raise the limit."
# Bytes; what the largest libraries of machine code take to be loaded.
LIBRARY_SIZE = 2**28

app = typer.Typer(
    no_args_is_help=False,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"sysid-trib {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_show_version, is_eager=True, help="Show the version."
    ),
) -> None:
    """Which forces act in an oscillator, learned from its free decay."""


for command in (look, backbone, identify, discover, compare, campaign, simulate, report, forces):
    app.command()(command)


def main() -> None:
    """Run the command line: errors in one line on stderr, exit status as documented."""
    # A closed stream is none.
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (as long as the process)
    if sys.stdout is None:
        sys.stderr.write("sysid-trib: standard output is closed; send it to a file, or to /dev/null.\n")
        sys.exit(1)
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe that is not UTF-8 must not turn ± into a traceback.
        stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    with warnings.catch_warnings():
        # Numerical libraries warn in their own terms; what matters of it is in the result, or an error here.
        warnings.showwarning = lambda *_, **__: None
        status, message = _outcome()
    if message:
        print(f"sysid-trib: {printable(message)}", file=sys.stderr)
    sys.exit(status)


def _memory_is_short() -> bool:
    """Whether next to no memory is left: libraries that cannot be loaded then end in errors of any kind."""
    try:
        bytearray(LIBRARY_SIZE)
    except MemoryError:
        return True
    return False


def _outcome() -> tuple[int, str]:
    """Exit status of the command, and the line for stderr if it failed."""
    # Typer brings its own click or uses the one installed, by its version: take the class from where it is.
    click_error: type[Exception] = next(
        k for k in typer.BadParameter.__mro__ if k.__name__ == "ClickException"
    )
    try:
        status = app(standalone_mode=False) or 0
        sys.stdout.flush()
        # Typer turns an interrupt into this status, silently.
        return status, "interrupted." if status == INTERRUPTED else ""
    except SysidTribError as error:
        return error.exit_status, str(error)
    except click_error as error:
        said = error.format_message()  # type: ignore[attr-defined]
        return 2, f"{said}{'' if said.endswith(('.', '?')) else '.'} See sysid-trib --help."
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED, "interrupted."
    except OSError as error:
        if error.filename is not None:
            return 1, f"{error.filename}: {error.strerror}; choose another file."
        # What is left in the buffer must not fail once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0, ""  # the reader has enough
        return 1, f"standard output cannot be written: {error.strerror or error}."
    except MemoryError:
        return 1, OUT_OF_MEMORY
    except Exception as error:
        if _memory_is_short():
            return 1, OUT_OF_MEMORY
        # A fault of this package, but still no traceback: a line that finds the place.
        frame = next(t for t in reversed(traceback.extract_tb(error.__traceback__)))
        place = f"{Path(frame.filename).name}:{frame.lineno}"
        return 1, f"Internal error ({type(error).__name__} in {place}: {error}); please report it."
