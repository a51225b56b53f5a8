"""Sphinx configuration: Markdown pages, parts that are generated while building, no network."""

import re
import sys
from pathlib import Path

import latex2mathml.converter
from docutils import nodes
from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import generated  # noqa: E402

import sysid_trib  # noqa: E402

project = "sysid_trib"
author = "sysid_trib contributors"
copyright = author
version = release = sysid_trib.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
highlight_language = "none"
# A name in backticks is a link where the API has it, and code elsewhere.
default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
# What scikit-learn adds to every estimator.
autodoc_default_options = {"exclude-members": "set_fit_request, set_score_request, set_transform_request"}
# Docstrings state the types; unions of all forms of a record would fill a screen.
autodoc_typehints = "none"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"sysid_trib {release}"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"


def setup(app: Sphinx) -> None:
    """Connect what is generated, and formulas as MathML, which browsers show without any script."""
    app.connect("source-read", _expand)
    app.connect("doctree-read", _fold)
    # Before numpydoc reads them.
    app.connect("autodoc-process-docstring", _readable, priority=400)
    app.add_html_math_renderer("mathml", (_math, None), (_math, None))


def _expand(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace each `<!-- generated: ... -->` of a page by what `generated` makes of it."""
    source[0] = generated.expand(source[0])


def _fold(app: Sphinx, doctree: nodes.document) -> None:
    """Let a browser fold the long lines of what a command prints where they are sentences, not tables."""
    for block in doctree.findall(nodes.literal_block):
        long = [line.strip() for line in block.astext().splitlines() if len(line) > 100]
        if long and not any("   " in line for line in long):
            block["classes"].append("sentences")


def _math(translator: "object", node: nodes.math) -> None:
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    translator.body.append(latex2mathml.converter.convert(node.astext(), display=display))  # type: ignore[attr-defined]
    raise nodes.SkipNode


def _readable(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Bring what numpydoc reads otherwise into the form that it shows well.

    `name : what it is, in SI units` becomes a name and its description, not a type; an entry whose next line
    begins a sentence of its own has both, and stays as it is. What is returned becomes one line: numpydoc
    takes each line for another thing returned.
    """
    kept: list[str] = []
    # Examples are shown as they run.
    start = lines.index("Examples") if "Examples" in lines else len(lines)
    text, examples = lines[:start], lines[start:]
    section = ""
    for before, line, after in zip(["", *text[:-1]], text, [*text[1:], ""], strict=True):
        if re.fullmatch(r"-{3,}", line):
            section = before
        entry = re.fullmatch(r"(\w[\w, ]*) : (.+)", line) if section in ("Parameters", "Attributes") else None
        goes_on = section == "Returns" and before[:1].strip(" -") and line[:1].strip(" -")
        if entry and (entry[2].endswith(".") or not re.match(r"    ([A-Z]|``)", after)):
            kept += [entry[1], f"    {entry[2]}"]
        elif goes_on:
            kept[-1] += f" {line}"
        else:
            kept.append(line)
    # A bar is a modulus here, never a substitution.
    bare = [re.sub(r"(``.*?``)|\|", lambda bar: bar[1] or r"\|", line) for line in kept]
    lines[:] = bare + examples
