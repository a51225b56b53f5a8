"""Files that are not tables: archives (a .zip with a single file is read), documents, pictures, sounds."""

import re
import zipfile
from pathlib import Path

from sysid_trib.errors import RecordError, readable

EXPORT = "export the data as CSV or .xlsx"
UNPACK = "unpack it, and name a file of numbers in it"
# First bytes of files, the kind of file, and what to do.
SIGNATURES = (
    (b"%PDF", "a PDF document", EXPORT),
    (b"\x89PNG", "a picture", EXPORT),
    (b"\xff\xd8\xff", "a picture", EXPORT),
    (b"GIF8", "a picture", EXPORT),
    (b"RIFF", "a sound or a video (WAV, AVI)", EXPORT),
    (b"fLaC", "a sound", EXPORT),
    (b"MDF  ", "a measurement file MDF", EXPORT),
    (b"SQLite format 3", "a database (SQLite)", EXPORT),
    (b"BZh", "packed by bzip2", UNPACK),
    (b"\xfd7zXZ", "packed by xz", UNPACK),
    (b"7z\xbc\xaf", "an archive (7z)", UNPACK),
    (b"Rar!", "an archive (RAR)", UNPACK),
)
# Position and bytes of the mark of a tar archive, and of a video.
TAR = slice(257, 262), b"ustar"
VIDEO = slice(4, 8), b"ftyp"
# Dataset 58 of the universal file format: a function over time or frequency.
UNIVERSAL_FILE = re.compile(rb"\s*-1\s*\n\s*(\d+)[b\s]")
# Names in archives that are documents.
DOCUMENTS = {"word/": "a document of Word", "ppt/": "slides", "content.xml": "a file of OpenDocument"}


def refuse_other_kinds(path: Path, head: bytes) -> None:
    """Raise an error for a file that is not a table, by its first bytes.

    Raises
    ------
    RecordError
        The file is of another kind; the message names it, and what to do.
    """
    kinds = [(what, remedy) for start, what, remedy in SIGNATURES if head.startswith(start)]
    if head[TAR[0]] == TAR[1]:
        kinds.append(("an archive (tar)", UNPACK))
    if head[VIDEO[0]] == VIDEO[1]:
        kinds.append(("a video", "track the motion in it, and export the track as CSV"))
    if UNIVERSAL_FILE.match(head):
        kinds.append(("a universal file (UFF)", "export the signal over time as CSV or .mat"))
    for what, remedy in kinds:
        raise RecordError(f"{path.name}: this is {what}, not a table; {remedy}.")


def single_file(path: Path) -> zipfile.ZipInfo | None:
    """Return the only file in a .zip; None for a workbook or for arrays of NumPy.

    Raises
    ------
    RecordError
        The archive is damaged or locked, or contains no file, several files, or a document.
    """
    name = readable(path.name)
    try:
        with zipfile.ZipFile(path) as archive:
            files = [member for member in archive.infolist() if not member.is_dir()]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise RecordError(f"{name}: cannot be read, it seems damaged or cut off ({error}).") from None
    # Files added by the operating system when packing are not the user's.
    files = [file for file in files if not re.match(r"__MACOSX/|(?:.*/)?\.[^/]*$", file.filename)]
    names = [file.filename for file in files]
    if any(entry.startswith("xl/") or entry.endswith(".npy") for entry in names):
        return None
    for mark, what in DOCUMENTS.items():
        if any(entry.startswith(mark) for entry in names):
            raise RecordError(f"{name}: this is {what}, not a table; {EXPORT}.")
    if len(files) != 1:
        listed = ", ".join([*names[:5], *["..."] * (len(names) > 5)]) or "no file"
        raise RecordError(f"{name}: this archive contains {listed}; {UNPACK}.")
    if files[0].flag_bits & 1:
        raise RecordError(f"{name}: this archive is locked by a password; unpack it.")
    return files[0]
