"""The notebooks as pages: copies in docs/notebooks, and a cache of their outputs that cannot go stale.

Pages and notebooks have links that are right in the repository; here they become right on the site.
"""

import hashlib
import os
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
NOTEBOOKS = ROOT / "notebooks"
# Git ignores it: Sphinx reads only files below its own folder.
COPIES = DOCS / "notebooks"
CACHE = ROOT / "build" / "notebooks"
REPOSITORY = "https://github.com/sysid-trib/sysid_trib/blob/main"
NAMES = "[0-9][0-9]_*.ipynb"
# A link of Markdown to a file.
LINK = re.compile(r"\]\(([\w./-]+)(#[\w-]+)?\)")
# What decides the outputs of a notebook, besides its own cells.
PATTERNS = ("sysid_trib/**/*.py", "libraries/*.toml", "notebooks/*.py")
VARIABLES = ("SYSID_TRIB_QUICK", "SYSID_TRIB_DATA")


def copy_notebooks() -> None:
    """Copy every notebook into the folder of the pages, and let its kernel import the modules beside it."""
    COPIES.mkdir(exist_ok=True)
    originals = {path.name: path for path in sorted(NOTEBOOKS.glob(NAMES))}
    for copy in COPIES.iterdir():
        if copy.name not in originals:
            copy.unlink()
    for name, path in originals.items():
        text = with_links_of_the_site(path.read_text(encoding="utf-8"), NOTEBOOKS, COPIES)
        (COPIES / name).write_text(text, encoding="utf-8", newline="\n")
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(NOTEBOOKS), *([before] if before else [])])


def with_links_of_the_site(text: str, folder: Path, shown_in: Path) -> str:
    """Return a text of a folder of the repository with the links that it needs in a folder of the site.

    A link to a page or a notebook leads to its page, a link to another file of the repository to GitHub. A
    link to a file that does not exist stays, so that the build fails.
    """

    def link_of_the_site(link: re.Match[str]) -> str:
        target = (folder / link[1]).resolve()
        if not target.is_file() or not target.is_relative_to(ROOT):
            return link[0]
        if target.parent == NOTEBOOKS and target.match(NAMES):
            target = COPIES / target.name
        if target.is_relative_to(DOCS):
            address = Path(os.path.relpath(target, shown_in)).as_posix()
        else:
            address = f"{REPOSITORY}/{target.relative_to(ROOT).as_posix()}"
        return f"]({address}{link[2] or ''})"

    return LINK.sub(link_of_the_site, text)


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
