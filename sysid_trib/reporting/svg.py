"""A figure of matplotlib as SVG that stands in a page of HTML among others."""

import io
import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

SVG, LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
# Letters are outlines: they were placed by the widths of a font that few readers have.
SETTINGS: dict[Any, Any] = {"svg.fonttype": "path", "path.simplify_threshold": 0.2}
# Dots an inch of what is drawn as an image: cells of a map, each of one colour.
IMAGE_DPI = 200
# Of a point; a figure as wide as the page has 518 of them.
DIGITS = 2
NUMBER = re.compile(r"-?\d+\.\d+")
PLACES = ("d", "x", "y", "width", "height")
# Pixels for an inch of the figure. Where a screen has less room the figure is moved sideways, not shrunk.
LEAST_PIXELS, MOST_PIXELS = 92, 138


def inline_svg(figure: Figure, name: str, caption: str) -> str:
    """A figure as an element `svg` of a page.

    Parameters
    ----------
    figure : Figure
    name : str
        Its ids begin with it: those of the figures of a page must differ. A letter comes first.
    caption : str
        Id of the element that says what it shows.
    """
    written = io.BytesIO()
    # Its footnote is in the caption.
    figure.supxlabel("")
    figure.dpi = IMAGE_DPI
    with mpl.rc_context(SETTINGS | {"svg.hashsalt": name}):
        # By `savefig` a figure is drawn twice.
        FigureCanvasSVG(figure).print_svg(written, metadata={"Date": None})
    root = ElementTree.fromstring(written.getvalue())
    # It begins with who made it, and with a style of all elements: within a page, of all that the page holds.
    root[:] = root[2:]
    for element in root.iter():
        element.tag, element.text, element.tail = element.tag.removeprefix(SVG), None, None
        for key in PLACES:
            if key in element.attrib:
                element.set(key, _short(element.attrib[key]))
    _rename(root, name)
    _join(root)
    inches = figure.get_size_inches()[0]
    size = f"min-width:{LEAST_PIXELS * inches:.0f}px;max-width:{MOST_PIXELS * inches:.0f}px"
    root.attrib = {
        "viewBox": root.attrib["viewBox"],
        "role": "img",
        "aria-labelledby": caption,
        "style": size,
    }
    return ElementTree.tostring(root, encoding="unicode")


def _short(places: str) -> str:
    """Coordinates with the digits that show; of a polygon only the first point needs a letter."""
    rounded = NUMBER.sub(lambda number: f"{float(number[0]):.{DIGITS}f}".rstrip("0").rstrip("."), places)
    if not {"C", "Q"} & set(rounded):
        rounded = rounded.replace("L", " ")
    return re.sub(r"\s*([A-Za-z])\s*|\s+", lambda gap: gap[1] or " ", rounded).strip()


def _rename(root: Element, name: str) -> None:
    """Ids of this figure alone, where anything refers to them."""
    links = [element for element in root.iter() if LINK in element.attrib]
    clipped = [element for element in root.iter() if "clip-path" in element.attrib]
    named = {element.attrib["id"]: "" for element in root.iter() if "id" in element.attrib}
    used = dict.fromkeys(element.attrib[LINK].removeprefix("#") for element in links)
    used |= dict.fromkeys(element.attrib["clip-path"][len("url(#") : -1] for element in clipped)
    new = {old: f"{name}-{at}" for at, old in enumerate(old for old in used if old in named)}
    for element in root.iter():
        if old := element.attrib.pop("id", ""):
            element.attrib |= {"id": new[old]} if old in new else {}
    for element in links:
        link = element.attrib.pop(LINK)
        element.set("href", f"#{new[link[1:]]}" if link.startswith("#") else link)
    for element in clipped:
        element.set("clip-path", f"url(#{new[element.attrib['clip-path'][len('url(#') : -1]]})")


def _join(element: Element) -> None:
    """Groups without a meaning dissolved, marks of a style in one group, lines of a style in one path."""
    for part in element:
        _join(part)
    parts = [one for part in element for one in (part if part.tag == "g" and not part.attrib else [part])]
    # A line of which nothing is in sight has no points; so has a space, but letters refer to it.
    parts = [one for one in parts if one.tag != "path" or {"d", "id"} & one.attrib.keys()]
    element[:] = [one for _, alike in groupby(parts, _kind) for one in _joined(list(alike))]


def _kind(element: Element) -> tuple[str, str, str]:
    """What elements have in common that may be joined; empty of those that may not."""
    kept = element.attrib
    if (
        element.tag == "path"
        and "fill: none" in kept.get("style", "")
        and not {"id", "transform"} & set(kept)
    ):
        # Where lines that are not opaque cross, one path is paler than several.
        return (
            ("path", kept["style"], kept.get("clip-path", ""))
            if "opacity" not in kept["style"]
            else ("",) * 3
        )
    return ("use", kept["style"], "") if element.tag == "use" and "style" in kept else ("",) * 3


def _joined(alike: list[Element]) -> Iterator[Element]:
    kind, style, _ = _kind(alike[0])
    if kind == "path":
        alike[0].set("d", "".join(one.attrib["d"] for one in alike))
        yield alike[0]
    elif kind == "use" and len(alike) > 1:
        group = Element("g", style=style)
        for one in alike:
            del one.attrib["style"]
        group[:] = alike
        yield group
    else:
        yield from alike
