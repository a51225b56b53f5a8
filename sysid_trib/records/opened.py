"""What stands for a file: standard input, or the content of a .gz, as a file that readers can open."""

import gzip
import shutil
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from sysid_trib.errors import RecordError

STANDARD_INPUT = "-"
# Bytes; more is no record but a bomb.
LARGEST_CONTENT = 2**30


@contextmanager
def opened(path: Path) -> Iterator[Path]:
    """The file itself; of `-` what comes by standard input, of a .gz its content, in a folder of its own.

    Raises
    ------
    RecordError
        The .gz is damaged, or its content vast.
    """
    if str(path) != STANDARD_INPUT and not _is_gzip(path):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        if str(path) == STANDARD_INPUT:
            copy = Path(folder) / "standard input"
            _copy(sys.stdin.buffer, copy, copy.name)
        else:
            copy = Path(folder) / path.name.removesuffix(".gz")
            try:
                with gzip.open(path) as file:
                    _copy(file, copy, path.name)
            except (OSError, EOFError, zlib.error) as error:
                raise RecordError(f"{path.name}: cannot be unpacked, it seems damaged ({error}).") from None
        yield copy


def _is_gzip(path: Path) -> bool:
    try:
        # A pipe would be waited for.
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(2) == b"\x1f\x8b"
    except (OSError, ValueError):
        # The reader says why it cannot be read.
        return False


def _copy(file: "IO[bytes] | gzip.GzipFile", copy: Path, name: str) -> None:
    with copy.open("wb") as target:
        shutil.copyfileobj(_Bounded(file, name), target)


class _Bounded:
    """A stream that refuses to go on beyond the largest content."""

    def __init__(self, file: "IO[bytes] | gzip.GzipFile", name: str) -> None:
        self.file, self.name, self.left = file, name, LARGEST_CONTENT

    def read(self, size: int = -1) -> bytes:
        part = self.file.read(size)
        self.left -= len(part)
        if self.left < 0:
            raise RecordError(f"{self.name}: holds more than {LARGEST_CONTENT:,} bytes: no record does.")
        return part
