"""Pages of results: what is on them, that they ask for nothing, and what is refused; no browser."""

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_csv
from helpers import lengthened, sentences_of

import sysid_trib as st
from sysid_trib.plots.figure import figures_of
from sysid_trib.printing.comparison import comparison_blocks
from sysid_trib.printing.discovery import discovery_blocks
from sysid_trib.printing.identification import identification_blocks
from sysid_trib.printing.layout import value_with_error
from sysid_trib.records.drawn import MOST_POINTS
from sysid_trib.reporting.page import page
from sysid_trib.reporting.provenance import python_text

KINDS = ("identify", "cross_check", "runs", "compare", "discover")

HEADINGS = {
    "identify": ["Coefficients"],
    "cross_check": ["At a glance", "Coefficients"],
    "compare": ["At a glance", "Coefficients by method", "Prediction of the held-out part"],
    "discover": ["At a glance", "Residual of the start model", "Missing effects"],
}
SVG = re.compile(r"<svg.*?</svg>", re.DOTALL)


class Page(HTMLParser):
    """Tags, ids and addresses of a page, and its rows of tables as text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.addresses, self.rows, self.in_cell = [], [], [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
            self.in_cell = True
        self.tags.append(tag)
        self.ids += [v for k, v in attrs if k == "id"]
        self.addresses += [v for k, v in attrs if k in ("src", "srcset", "data", "action", "poster")]
        self.addresses += [v for k, v in attrs if k.endswith("href")]

    def handle_endtag(self, tag):
        self.in_cell = self.in_cell and tag not in ("td", "th")

    def handle_data(self, data):
        if self.in_cell:
            self.rows[-1][-1] += data.strip()


@pytest.mark.parametrize("kind", KINDS)
def test_page_asks_for_nothing(kind, pages):
    text, parsed = pages[kind], Page(pages[kind])
    assert [a for a in parsed.addresses if not a.startswith(("data:image/png;base64,", "#"))] == []
    assert not {"script", "link", "iframe", "object"} & set(parsed.tags)
    assert "default-src 'none'" in text
    assert not re.search(r"url\(\s*['\"]?https?:|@import", text)


@pytest.mark.parametrize("kind", ["identify", "cross_check", "compare", "discover"])
def test_each_figure_is_an_svg_with_a_caption(kind, pages, results):
    text = pages[kind]
    declared = [one for f in figures_of(kind) if f.block for one in f.drawings(results[kind])]
    figures = re.findall(r"<figure>.*?</figure>", text, re.DOTALL)
    drawn = [ElementTree.fromstring(svg) for figure in figures for svg in SVG.findall(figure)]
    assert len(drawn) == len(figures) == len(declared)
    assert declared or kind == "identify"
    for svg, figure in zip(drawn, figures, strict=True):
        assert svg.attrib["role"] == "img"
        assert f'<figcaption id="{svg.attrib["aria-labelledby"]}">' in figure
        assert len(svg.attrib["viewBox"].split()) == 4
        # As wide as its place.
        assert not {"width", "height"} & set(svg.attrib)
        # Lines, not a picture of them.
        assert len(list(svg.iter("path"))) > 20
        # A style within a figure would be of the whole page.
        assert not list(svg.iter("style"))


@pytest.mark.parametrize("kind", KINDS)
def test_ids_are_of_one_element_and_each_reference_finds_its_own(kind, pages):
    text, parsed = pages[kind], Page(pages[kind])
    assert len(parsed.ids) == len(set(parsed.ids))
    named = re.findall(r'aria-labelledby="(.*?)"', text) + re.findall(r"url\(#(.*?)\)", text)
    assert {*named, *(a[1:] for a in parsed.addresses if a.startswith("#"))} <= set(parsed.ids)


@pytest.mark.parametrize("kind", HEADINGS)
def test_headings(kind, pages):
    found = [html.unescape(heading) for heading in re.findall(r"<h2>(.*?)</h2>", pages[kind])]
    assert found[: len(HEADINGS[kind])] == HEADINGS[kind]
    assert found[-2:] == ["Provenance", "Reproduce this result"]


@pytest.mark.parametrize("kind", ["cross_check", "runs", "compare", "discover"])
def test_sentences_are_those_that_the_command_prints(results, kind, pages):
    blocks = {"compare": comparison_blocks, "discover": discovery_blocks}.get(kind, identification_blocks)
    text = html.unescape(pages[kind])
    for sentence in sentences_of(blocks(results[kind])):
        assert f">{sentence}</p>" in text


@pytest.mark.parametrize(
    ("kind", "group"),
    [("identify", ""), ("cross_check", "direct"), ("runs", "averaging"), ("discover", "after")],
)
def test_numbers_are_those_of_the_result(results, pages, kind, group):
    result = (results[kind][group] if group else results[kind]).to_dataset()
    rows = [row for row in Page(pages[kind]).rows if row and row[0]]
    for symbol in result.force.values.tolist():
        one = result.sel(force=symbol)
        told = value_with_error(one.coefficient.item(), one.standard_error.item())
        assert any(row[0].split()[0] == symbol and told in row for row in rows)


def test_provenance(results, pages):
    text = html.unescape(pages["runs"])
    for at in (1, 2):
        attrs = results["runs"][f"record_{at}"].attrs
        assert attrs["record_checksum"] in text
        assert attrs["free_decay"] in text
    assert st.load_library().select(["zeta", "delta", "epsilon"]).to_toml() in text
    assert st.__version__ in text
    assert "sysid-trib discover" in pages["discover"]


def test_python_of_a_system_reads_the_library_on_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "swing.csv")
    usual, gravity = st.load_library(), st.load_library("candidate_effects").select(["gravity"])
    library = replace(usual, forces=(*usual.select(["zeta"]), *gravity))
    method = st.methods.Direct(constraints={"gravity": 1.0, "zeta": (0.0, float("inf"))})
    before = st.identify(st.free_decay(st.read_record("swing.csv")), library, method)
    (tmp_path / "library.toml").write_text(before.attrs["library"])
    names = {}
    exec(python_text(xr.DataTree(before)), names)
    np.testing.assert_array_equal(names["result"].coefficient, before.coefficient)


@pytest.mark.parametrize(
    "kind", ["identify", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("cross_check", "runs"))]
)
def test_python_on_the_page_makes_the_result_again(results, folder, kind, monkeypatch, pages):
    monkeypatch.chdir(folder)
    tree = results[kind]
    code = html.unescape(re.search(r'<pre id="python">(.*?)</pre>', pages[kind], re.DOTALL)[1])
    names = {}
    exec(code, names)
    again, before = (names["result"], tree) if kind == "identify" else (names["second"], tree["direct"])
    np.testing.assert_array_equal(again.coefficient, before.coefficient)
    if kind != "identify":
        assert names["tree"]["agreement"].p_value.item() == tree["agreement"].p_value.item()


def test_python_of_compare_and_discover_is_python(pages):
    for kind in ("compare", "discover"):
        code = html.unescape(re.search(r'<pre id="python">(.*?)</pre>', pages[kind], re.DOTALL)[1])
        compile(code, kind, "exec")
        assert f"st.{kind}(" in code


def test_hostile_names_are_text(results, without_figures):
    tree = results["cross_check"].copy()
    tree["record"].attrs["source"] = '</script><script>alert("x")</script><img src="http://a.b/c">'
    tree.attrs["command"] = "sysid-trib identify '<b>.csv'"
    parsed = Page(page(tree))
    assert [a for a in parsed.addresses if not a.startswith("#")] == []
    assert not {"script", "img", "b.csv"} & set(parsed.tags)


@pytest.mark.slow
def test_page_of_a_long_record_with_a_model_that_diverges(results, pages):
    """The page is small, says that it is decimated, and leaves that model out."""
    tree = lengthened(results["cross_check"], 50_000)
    record = tree["record"].to_dataset()
    record["simulated_angle"].loc[{"model": "averaging"}] = np.nan
    tree["record"] = xr.DataTree(record)
    text = page(tree)
    assert len(text.encode()) < 800_000
    assert f"{MOST_POINTS:,} of 50,000 samples" in text
    assert "curves are decimated" not in pages["cross_check"]
    # An image holds any letters.
    assert not [svg for svg in SVG.findall(text) if "nan" in re.sub(r"base64,[^\"]*", "", svg).lower()]


def test_command(folder):
    target = folder / "page.html"
    ending = run("report", folder / "identify.nc", "-o", target)
    assert (ending.status, ending.err, ending.out) == (0, "", f"Written: {target}\n")
    assert target.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert [p.name for p in folder.iterdir() if p.name.startswith(".")] == []


@pytest.mark.parametrize("what", ["record", "text", "truncated", "half", "folder"])
def test_bad_results_are_refused(folder, tmp_path, what, without_figures):
    source = tmp_path / "bad.nc"
    if what == "record":
        assert run("simulate", "-o", source, "--duration", "5").status == 0
    elif what == "text":
        write_csv(source)
    elif what == "truncated":
        source.write_bytes((folder / "cross_check.nc").read_bytes()[:60_000])
    elif what == "folder":
        source.mkdir()
    else:
        tree = st.load(folder / "cross_check.nc")
        tree["judged"] = xr.DataTree(tree["judged"].to_dataset().drop_vars("p_value"))
        st.save(tree, source)
    ending = run("report", source, "-o", tmp_path / "page.html")
    assert ending.status == 1
    assert "bad.nc" in ending.complaint
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    "thing", [None, xr.Dataset(), xr.Dataset({"angle": ("time", [0.0, 1.0])}), xr.DataTree()]
)
def test_what_is_no_result_is_refused(thing, tmp_path):
    with pytest.raises(st.errors.UsageError, match="result of identify"):
        st.report(thing, tmp_path / "page.html")
