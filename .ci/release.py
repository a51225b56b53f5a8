"""Check that a release is consistent, and print its section of the change log.

python .ci/release.py v0.1.0 > notes.md
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HEADING = re.compile(r"## \[(\S+)\](?: - (\d{4}-\d\d-\d\d))?\n")


def read(name: str) -> str:
    """Return the text of a file of the repository."""
    return (ROOT / name).read_text(encoding="utf-8")


def found(pattern: str, name: str) -> str:
    """Return what the group of a pattern matches in a file."""
    match = re.search(pattern, read(name), re.MULTILINE)
    if match is None:
        sys.exit(f"{name}: there is no line {pattern}.")
    return match[1]


def sections() -> dict[str, tuple[str | None, str]]:
    """Return the date and the text of each version in the change log."""
    _, *parts = HEADING.split(read("CHANGELOG.md"))
    return {
        version: (date, text.strip())
        for version, date, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True)
    }


def main() -> None:
    """Compare the tag with the versions in the repository; print the notes of the release."""
    if len(sys.argv) != 2:
        sys.exit(str(__doc__))
    tag = sys.argv[1]
    version = found(r'^__version__ = "(.+)"$', "sysid_trib/_version.py")
    if tag != f"v{version}":
        sys.exit(
            f"The tag is {tag}, but sysid_trib/_version.py has {version}: "
            f"tag v{version}, or change the version."
        )
    cited = found(r"^version: (.+)$", "CITATION.cff")
    if cited != version:
        sys.exit(f"CITATION.cff has version {cited}, sysid_trib/_version.py {version}: make them equal.")
    date, notes = sections().get(version, (None, ""))
    if date is None or not notes:
        sys.exit(
            f"CHANGELOG.md needs a section `## [{version}] - YYYY-MM-DD` with the changes of this version."
        )
    released = found(r"^date-released: (.+)$", "CITATION.cff")
    if released != date:
        sys.exit(f"CITATION.cff was released on {released}, by CHANGELOG.md on {date}: make them equal.")
    print(notes)


if __name__ == "__main__":
    main()
