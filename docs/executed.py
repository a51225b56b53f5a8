"""The notebooks as pages: copies in docs/notebooks, and a cache of their outputs that cannot go stale."""

import hashlib
import os
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = ROOT / "notebooks"
# Git ignores it: Sphinx reads only files below its own folder.
COPIES = ROOT / "docs" / "notebooks"
CACHE = ROOT / "build" / "notebooks"
REPOSITORY = "https://github.com/sysid-trib/sysid_trib/blob/main"
# A link of Markdown to a file.
LINK = re.compile(r"\]\(([\w./-]+)(#[\w-]+)?\)")
# What decides the outputs of a notebook, besides its own cells.
PATTERNS = ("sysid_trib/**/*.py", "libraries/*.toml", "notebooks/*.py")
VARIABLES = ("SYSID_TRIB_QUICK", "SYSID_TRIB_DATA", "SYSID_TRIB_FETCH")


def copy_notebooks() -> None:
    """Copy every notebook into the folder of the pages, and let its kernel import the modules beside it."""
    COPIES.mkdir(exist_ok=True)
    originals = {path.name: path for path in sorted(NOTEBOOKS.glob("[0-9][0-9]_*.ipynb"))}
    for copy in COPIES.iterdir():
        if copy.name not in originals:
            copy.unlink()
    for name, path in originals.items():
        text = LINK.sub(_from_the_copy, path.read_text(encoding="utf-8"))
        (COPIES / name).write_text(text, encoding="utf-8", newline="\n")
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(NOTEBOOKS), *([before] if before else [])])


def _from_the_copy(link: re.Match[str]) -> str:
    """Return a link that leads from the copy to the page, or to the file in the repository."""
    target = (NOTEBOOKS / link[1]).resolve()
    if not target.is_file() or target.suffix == ".ipynb":
        return link[0]
    name = target.relative_to(ROOT).as_posix()
    address = f"../{name.removeprefix('docs/')}" if name.startswith("docs/") else f"{REPOSITORY}/{name}"
    return f"]({address}{link[2] or ''})"


def cache_folder() -> Path:
    """Return the folder for the outputs of today's package; those of other states are deleted."""
    state = hashlib.sha256()
    for pattern in PATTERNS:
        for path in sorted(ROOT.glob(pattern)):
            state.update(f"{path.relative_to(ROOT).as_posix()}\n".encode())
            state.update(path.read_bytes())
    for name in VARIABLES:
        state.update(f"{name}={os.environ.get(name, '')}\n".encode())
    folder = CACHE / state.hexdigest()[:16]
    for other in CACHE.glob("*"):
        if other != folder:
            shutil.rmtree(other)
    return folder
