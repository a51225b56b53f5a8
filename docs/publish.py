"""Put built pages among the published versions: python docs/publish.py PAGES SITE VERSION.

SITE is the folder that the web server shows, PAGES the result of `make docs`. VERSION is `main`, which
becomes SITE/latest, or a tag such as v1.2.3, which becomes SITE/v1.2; the newest of these is SITE/stable too.
The list `versions.json` serves the choice in the sidebar, and the first page of SITE leads to `stable`, or to
`latest` before the first tag.
"""

import json
import re
import shutil
import sys
from pathlib import Path

TAG = re.compile(r"v(\d+)\.(\d+)\.\d+")
LEADS_ON = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>sysid_trib</title>
<meta http-equiv="refresh" content="0; url={first}/">
</head>
<body><p>The documentation is at <a href="{first}/">{first}</a>.</p></body>
</html>
"""


def publish(pages: Path, site: Path, version: str) -> None:
    """Copy the pages of a version into the site, and write its list of versions and its first page."""
    site.mkdir(parents=True, exist_ok=True)
    _replace(pages, site / _folder_of(version))
    released = _released(site)
    if released:
        _replace(site / released[0], site / "stable")
    versions = ["latest"] if (site / "latest").is_dir() else []
    versions += ["stable", *released] if released else []
    (site / "versions.json").write_text(json.dumps(versions) + "\n", encoding="utf-8")
    first = "stable" if released else "latest"
    (site / "index.html").write_text(LEADS_ON.format(first=first), encoding="utf-8")
    # Folders that begin with an underscore are shown only with this file.
    (site / ".nojekyll").touch()


def _folder_of(version: str) -> str:
    if version == "main":
        return "latest"
    if tag := TAG.fullmatch(version):
        return f"v{tag[1]}.{tag[2]}"
    raise SystemExit(f"{version} is neither main nor a tag such as v1.2.3.")


def _released(site: Path) -> list[str]:
    """Return the folders of released versions, the newest first."""
    numbers = [
        (int(m[1]), int(m[2])) for m in (re.fullmatch(r"v(\d+)\.(\d+)", p.name) for p in site.iterdir()) if m
    ]
    return [f"v{major}.{minor}" for major, minor in sorted(numbers, reverse=True)]


def _replace(source: Path, target: Path) -> None:
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(source, target)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        raise SystemExit("Usage: python docs/publish.py PAGES SITE VERSION")
    publish(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
