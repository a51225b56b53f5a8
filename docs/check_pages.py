"""Check built pages without a network: no dead link between pages, nothing loaded from another host.

python docs/check_pages.py FOLDER
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Relations of a `link` for which a browser loads the address.
LOADED = {"stylesheet", "icon", "preload", "modulepreload", "prefetch", "manifest"}


class _Page(HTMLParser):
    """The identities of a page, the addresses that it links to, and those that a browser loads with it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.identities: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Keep the identity and the addresses of an element."""
        has = {name: value or "" for name, value in attributes}
        self.identities.update(has[key] for key in ("id", "name") if has.get(key))
        if tag == "a" and "href" in has:
            self.links.append(has["href"])
        if tag == "link" and LOADED & set(has.get("rel", "").split()):
            self.loaded.append(has["href"])
        if "src" in has:
            self.loaded.append(has["src"])


def faults_of(folder: Path) -> list[str]:
    """Return a sentence for each dead link within the pages of a folder, and for each foreign source."""
    pages = {path.resolve(): _Page(path) for path in sorted(folder.rglob("*.html"))}
    faults = []
    for path, page in pages.items():
        name = path.relative_to(folder.resolve()).as_posix()
        for address in page.loaded:
            if urlsplit(address).netloc:
                faults.append(f"{name} loads {address}, which is on another host.")
        for address in [*page.links, *page.loaded]:
            if not _leads_somewhere(address, path, pages):
                faults.append(f"{name} links to {address}, which does not exist.")
    return list(dict.fromkeys(faults))


def _leads_somewhere(address: str, path: Path, pages: dict[Path, _Page]) -> bool:
    parts = urlsplit(address)
    if parts.scheme or parts.netloc:
        return True
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if target in pages and parts.fragment:
        return unquote(parts.fragment) in pages[target].identities
    return target.exists()


def main() -> int:
    """Print the faults of the pages in a folder; the exit status is 1 if there are any."""
    faults = faults_of(Path(sys.argv[1]))
    print(*faults, sep="\n", end="\n" if faults else "")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
