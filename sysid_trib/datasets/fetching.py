"""Files of records: in a folder of the user, in the cache, or downloaded; each is checked."""

import hashlib
import http.client
import os
import sys
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from sysid_trib.datasets.conversion import converted
from sysid_trib.datasets.registry import CERTIFIED, PublishedFile, PublishedRecord, published
from sysid_trib.errors import RecordError, UsageError

# Environment variable with the folder that already has files of records.
FOLDER_VARIABLE = "SYSID_TRIB_DATA"
# Size in bytes beyond which a download is stopped; the largest source has some 3 MB.
LARGEST_DOWNLOAD = 2**25
# Time in s without an answer after which a download is given up.
LONGEST_WAIT = 20.0


def files(name: str) -> list[Path]:
    """Return the files of a record, downloaded if need be; each has the published checksum.

    A file is looked for in the folder that the environment variable SYSID_TRIB_DATA names, then in the
    user's cache, then at its source. A download is announced on stderr.

    Parameters
    ----------
    name : str
        Name of the record, one of `names()`.

    Returns
    -------
    list of Path
        The file with the signal, then those of its inputs.

    Raises
    ------
    UsageError
        There is no such record, or SYSID_TRIB_DATA names no folder.
    RecordError
        A file is not the published one, or cannot be downloaded: no connection, or pooch is not installed.

    Examples
    --------
    >>> import sysid_trib as st
    >>> [path.name for path in st.datasets.files("certified/viscous_1e-4")]
    ['viscous_1e-4.csv.gz']
    """
    record = published(name)
    if record.kind == "certified":
        return [CERTIFIED.parent / file.local for file in record.files]
    return [_own(record, file) or _cached(record, file) for file in record.files]


def _own(record: PublishedRecord, file: PublishedFile) -> Path | None:
    """Return the file in the user's folder; None if there is no folder, or no such file in it."""
    given = os.environ.get(FOLDER_VARIABLE)
    if not given:
        return None
    folder = Path(given)
    if not folder.is_dir():
        raise UsageError(
            f"{FOLDER_VARIABLE} is '{given}', which is no folder; correct it, or unset it to download."
        )
    own = folder / file.local
    if not own.is_file():
        return None
    checksum = _checksum(own)
    if checksum != file.sha256:
        raise RecordError(
            f"dataset {record.name}: {own} is not the published file (SHA-256 {checksum[:12]}..., not "
            f"{file.sha256[:12]}...); restore it, or unset {FOLDER_VARIABLE} to download it."
        )
    return own


def _cached(record: PublishedRecord, file: PublishedFile) -> Path:
    """Return the file in the cache, where it is downloaded to."""
    try:
        import pooch
    except ImportError:
        raise RecordError(
            f"dataset {record.name}: to download it the package pooch is needed: pip install -e "
            f"'.[datasets]' in a clone; or name the folder that has {file.local} by {FOLDER_VARIABLE}."
        ) from None
    pooch.get_logger().setLevel("WARNING")
    kept = Path(pooch.os_cache("sysid_trib")) / file.local
    if kept.is_file() and _checksum(kept) == file.sha256:
        return kept
    print(f"Downloading dataset {record.name} from {record.url(file)}", file=sys.stderr)
    is_converted = file.rows is not None or file.cells is not None
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        # The checksum of a source that is converted is not known; that of the result is.
        fetched = pooch.retrieve(
            record.url(file),
            known_hash=None if is_converted else f"sha256:{file.sha256}",
            fname=f"{kept.name}.source" if is_converted else kept.name,
            path=kept.parent,
            downloader=_bounded_download,
        )
        if is_converted:
            kept.write_bytes(_whole(record, file, Path(fetched)))
    except (OSError, http.client.HTTPException) as error:
        raise RecordError(_why_not(record, file, error)) from error
    except ValueError as error:
        # pooch raises it for another checksum; the package's own errors are of this class, too.
        if isinstance(error, RecordError):
            raise
        raise RecordError(
            f"dataset {record.name}: the file at {record.url(file)} is not the published one (its SHA-256 "
            f"differs); try again later, or name the folder that has {file.local} by {FOLDER_VARIABLE}."
        ) from error
    return kept


def _whole(record: PublishedRecord, file: PublishedFile, fetched: Path) -> bytes:
    """Return the converted source; remove the source, and raise an error if the result is another file."""
    try:
        content = converted(fetched, file)
    finally:
        fetched.unlink(missing_ok=True)
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise RecordError(
            f"dataset {record.name}: what {record.url(file)} contains is not the published record (the "
            f"SHA-256 of its part differs); name the folder that has {file.local} by {FOLDER_VARIABLE}."
        )
    return content


def _why_not(record: PublishedRecord, file: PublishedFile, error: Exception) -> str:
    """Describe a download that failed."""
    if isinstance(error, PermissionError):
        return (
            f"dataset {record.name}: {error.filename} cannot be written; set XDG_CACHE_HOME, or "
            f"{FOLDER_VARIABLE}."
        )
    return (
        f"dataset {record.name}: {record.url(file)} cannot be downloaded ({_reason(error)}); connect to the "
        f"internet, or name the folder that has {file.local} by {FOLDER_VARIABLE}."
    )


def _reason(error: Exception) -> str:
    """Return the reason that the system gives, without the number of the error."""
    cause = getattr(error, "reason", error)
    return str(getattr(cause, "strerror", None) or cause) or type(error).__name__


def _bounded_download(url: str, output_file: str, pooch: Any, check_only: bool = False) -> None:
    """Download a file of bounded size, in the form in which pooch calls it."""
    with urlopen(url, timeout=LONGEST_WAIT) as answer:
        content = answer.read(LARGEST_DOWNLOAD + 1)
    if len(content) > LARGEST_DOWNLOAD:
        raise OSError(f"it is larger than {LARGEST_DOWNLOAD // 2**20} MB")
    Path(output_file).write_bytes(content)


def _checksum(file: Path) -> str:
    """Return the SHA-256 of a file."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()
