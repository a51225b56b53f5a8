"""The page: rendered as a whole, figures as SVG, written to a temporary file and then renamed."""

import io
import os
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import matplotlib as mpl
import xarray as xr
from jinja2 import Environment, PackageLoader
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from sysid_trib.errors import RecordError, SysidTribError, UsageError
from sysid_trib.reporting import provenance
from sysid_trib.reporting.contents import Part, contents_of
from sysid_trib.results.files import write_file
from sysid_trib.results.kinds import contents_text, identifications_of, kind_of

SVG, LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
# Letters are outlines, because their positions depend on a font that few readers have installed.
SETTINGS: dict[Any, Any] = {"svg.fonttype": "path", "path.simplify_threshold": 0.2}
# Dots per inch of parts drawn as an image: cells of a map, each of one colour.
IMAGE_DPI = 200
# Decimal digits of a coordinate in points; a figure of full width has 518 points.
COORDINATE_DIGITS = 2
DECIMAL = re.compile(r"-?\d+\.\d+")
# Attributes that refer to an element by its id, and their names in HTML; an image contains its own data.
REFERRING = {LINK: "href", "clip-path": "clip-path"}
ID_REFERENCE = re.compile(r"#([^)]+)")
PLACES = ("d", "x", "y", "width", "height")
# Pixels per inch of the figure. On a narrower screen, the figure is scrolled sideways, not reduced.
LEAST_PIXELS, MOST_PIXELS = 92, 138


def inline_svg(figure: Figure, name: str, caption: str) -> str:
    """Return a figure as an element `svg` of a page.

    Parameters
    ----------
    figure : Figure
    name : str
        Prefix of its ids, beginning with a letter: figures of one page must have different prefixes.
    caption : str
        Id of the element with the caption.
    """
    written = io.BytesIO()
    # The footnote is part of the caption.
    figure.supxlabel("")
    figure.dpi = IMAGE_DPI
    with mpl.rc_context(SETTINGS | {"svg.hashsalt": name}):
        # `savefig` would draw a figure twice.
        FigureCanvasSVG(figure).print_svg(written, metadata={"Date": None})
    root = ElementTree.fromstring(written.getvalue())
    # The creator, and a style of all elements that would apply to the whole page.
    left_out = [root.find(f"{SVG}metadata"), root.find(f"{SVG}defs[{SVG}style]")]
    root[:] = [part for part in root if part not in left_out]
    for element in root.iter():
        element.tag, element.text, element.tail = element.tag.removeprefix(SVG), None, None
        for key in PLACES:
            if key in element.attrib:
                element.set(key, _short(element.attrib[key]))
    _rename(root, name)
    inches = figure.get_size_inches()[0]
    size = f"min-width:{LEAST_PIXELS * inches:.0f}px;max-width:{MOST_PIXELS * inches:.0f}px"
    root.attrib = {"viewBox": root.attrib["viewBox"], "role": "img"}
    root.attrib |= {"aria-labelledby": caption, "style": size}
    return ElementTree.tostring(root, encoding="unicode")


def _short(places: str) -> str:
    """Return coordinates with the visible digits; in a polygon only the first point needs a letter."""
    rounded = DECIMAL.sub(
        lambda number: f"{float(number[0]):.{COORDINATE_DIGITS}f}".rstrip("0").rstrip("."), places
    )
    if not {"C", "Q"} & set(rounded):
        rounded = rounded.replace("L", " ")
    return re.sub(r"\s*([A-Za-z])\s*|\s+", lambda match: match[1] or " ", rounded).strip()


def _rename(root: Element, name: str) -> None:
    """Rename the ids in this figure, and the references to them."""
    elements = list(root.iter())
    used = [ID_REFERENCE.search(element.get(key, "")) for element in elements for key in REFERRING]
    ids = dict.fromkeys(match[1] for match in used if match)
    new = {old: f"{name}-{at}" for at, old in enumerate(ids)}
    for element in elements:
        if (old := element.attrib.pop("id", "")) in new:
            element.set("id", new[old])
        for key, attribute in REFERRING.items():
            if key in element.attrib:
                text = element.attrib.pop(key)
                element.set(attribute, ID_REFERENCE.sub(lambda match: f"#{new[match[1]]}", text))


def report(result: xr.DataTree | xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a result as one self-contained page: text, tables, figures.

    Parameters
    ----------
    result : xr.DataTree or xr.Dataset
        Result of `identify`, `cross_check`, `laws`, `compare`, `discover` or `difference`.
    path : path-like
        Path of the HTML page. It loads nothing from the network and contains no script.

    Raises
    ------
    UsageError
        The object is not such a result.
    RecordError
        The result lacks a part, as results of another version may, or the page cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3).angle
    >>> angle = angle + np.random.default_rng(0).normal(0.0, 1e-4, 400)
    >>> st.report(st.identify(angle, "zeta"), "report.html")
    >>> "The model explains the record" in Path("report.html").read_text(encoding="utf-8")
    True
    """
    write_page(page(result), Path(path))


def write_page(text: str, path: Path) -> None:
    """Write a page; an existing file is replaced only by a complete one."""
    write_file(path, text.encode())


def page(result: xr.DataTree | xr.Dataset) -> str:
    """Return the page as text (see `report`)."""
    tree = xr.DataTree(result) if isinstance(result, xr.Dataset) else result
    if not isinstance(tree, xr.DataTree) or not kind_of(tree):
        raise UsageError(
            "A report is of a result of identify, cross_check, laws, compare, discover or difference, not of "
            f"{contents_text(result)}; that of a campaign is made by the command: sysid-trib report STORE."
        )
    if kind_of(tree) == "difference" and not identifications_of(tree):
        raise UsageError(
            "This difference of two identifications has none of their records, which its page shows; make it "
            "of the records: difference(record, other)."
        )
    try:
        title, summary, sections = contents_of(tree)
        following = [f"Next: {tree.attrs['next']}"] if tree.attrs.get("next") else []
        unkept = [{"source": "; ".join(tree.attrs.get("record_source", []))}]
        return rendered(
            {
                "title": title,
                "records": provenance.kept_records(tree) or unkept,
                "summary": [*summary, *following],
                "sections": sections,
                "facts": provenance.facts(tree),
                "methods": provenance.method_table(tree),
                "texts": provenance.libraries(tree),
                "command": tree.attrs.get("command", ""),
                "python": provenance.python_text(tree),
            }
        )
    except SysidTribError:
        raise
    # An edited result may lack any part, or have it in another form.
    except Exception as error:
        reason = " ".join(str(error).split())
        raise RecordError(f"The result is not whole ({reason}); make it again with this version.") from error


def rendered(content: Part) -> str:
    """Return a page as text.

    Parameters
    ----------
    content : mapping
        Title, attributes of the records (their `source`), summary (sentences above all sections), sections.
        Also the provenance: facts as terms and texts, methods with their options, texts of libraries by
        title, and the command and the Python code that reproduce the result.
    """
    environment = Environment(
        loader=PackageLoader("sysid_trib", "reporting"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals["inline_svg"] = inline_svg
    return environment.get_template("page.html").render(content)
