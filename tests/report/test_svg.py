"""A figure as an element of a page: the same bytes each time, ids of its own, less to read, nothing lost."""

import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from sysid_trib.plots import style
from sysid_trib.reporting.page import inline_svg


def figure():
    """Lines, marks with bars, a map, letters and a footnote."""
    made = style.new_figure(4.0, 3.0)
    lines, cells = made.subplots(1, 2)
    time = np.linspace(0.0, 1.0, 40)
    lines.errorbar(time, np.sin(9.0 * time), 0.1, fmt="o", label="<b>record & model</b>")
    lines.plot(time, np.cos(9.0 * time), color="red")
    lines.plot([5.0, 6.0], [np.nan, np.nan])
    lines.legend()
    cells.pcolormesh(np.outer(time, time), rasterized=True)
    style.footnote(made, "what was held out")
    return made


@pytest.fixture(scope="module")
def drawn():
    return inline_svg(figure(), "a", "caption")


@pytest.mark.slow
def test_bytes_are_the_same_each_time(drawn):
    assert inline_svg(figure(), "a", "caption") == drawn


def test_ids_are_those_of_the_figure_alone(drawn):
    ids = re.findall(r'\bid="(.*?)"', drawn)
    assert ids
    assert len(ids) == len(set(ids))
    assert all(name.startswith("a-") for name in ids)
    assert set(ids) == set(re.findall(r'(?:url\(|href=")#(.*?)["\)]', drawn))


def test_nothing_is_lost(drawn):
    written = io.BytesIO()
    figure().savefig(written, format="svg")
    before, after = (ElementTree.fromstring(text) for text in (written.getvalue(), drawn))

    def marks(root, tag):
        return len([element for element in root.iter() if element.tag.endswith(tag)])

    def moves(root):
        return "".join(element.get("d", "") for element in root.iter()).count("M")

    # Letters of the footnote are those that differ: it is in the caption.
    letters = len("what was held out")
    assert 0 <= marks(before, "use") - marks(after, "use") <= letters
    assert marks(after, "image") == marks(before, "image") == 1
    assert moves(before) - moves(after) <= letters
    assert len(drawn) < 0.6 * len(written.getvalue())


def test_lines_of_one_style_are_one_path(drawn):
    paths = [element.get("d", "") for element in ElementTree.fromstring(drawn).iter("path")]
    assert max(path.count("M") for path in paths) == 40


def test_texts_of_a_file_are_outlines(drawn):
    assert "record" not in drawn
    assert "<b>" not in drawn
