"""Sphinx configuration: Markdown pages, notebooks, parts that are generated while building, no network."""

import os
import re
import sys
from pathlib import Path

import latex2mathml.converter
import numpydoc.xref
from docutils import nodes
from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import generated  # noqa: E402
import notebook_pages  # noqa: E402

import sysid_trib  # noqa: E402

project = "sysid_trib"
author = "sysid_trib contributors"
copyright = author
version = release = sysid_trib.__version__

PAGES = "https://sysid-trib.github.io/sysid_trib/"

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx_copybutton",
    "sphinxext.opengraph",
]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
templates_path = ["_templates"]
highlight_language = "none"
# Primes of derivatives and options of commands stay as written.
smartquotes = False
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

# Notebooks: shorter runs, once for each state of the package; one that fails fails the build.
os.environ.setdefault("SYSID_TRIB_QUICK", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
notebook_pages.copy_notebooks()
nb_execution_mode = "cache"
nb_execution_cache_path = str(notebook_pages.cache_folder())
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
# Interactive widgets would be loaded from another host.
nb_ipywidgets_js: dict[str, dict[str, str]] = {}

# Names of other packages are links where SYSID_TRIB_INTERSPHINX=1 allows the build to go online.
LINKED = {
    "matplotlib": "https://matplotlib.org/stable/",
    "numpy": "https://numpy.org/doc/stable/",
    "pandas": "https://pandas.pydata.org/docs/",
    "pysindy": "https://pysindy.readthedocs.io/en/latest/",
    "scipy": "https://docs.scipy.org/doc/scipy/",
    "xarray": "https://docs.xarray.dev/en/stable/",
}
ONLINE = os.environ.get("SYSID_TRIB_INTERSPHINX") == "1"
intersphinx_mapping = {name: (address, None) for name, address in LINKED.items() if ONLINE}
intersphinx_timeout = 30
# Types in docstrings that are links then; other words of a type stay words.
numpydoc_xref_param_type = ONLINE
numpydoc_xref_ignore = "all"
# Those that numpydoc links itself need the inventory of Python as well.
numpydoc.xref.DEFAULT_LINKS.clear()
numpydoc_xref_aliases = {
    "Axes": "matplotlib.axes.Axes",
    "DataArray": "xarray.DataArray",
    "DataFrame": "pandas.DataFrame",
    "DataTree": "xarray.DataTree",
    "Dataset": "xarray.Dataset",
    "Figure": "matplotlib.figure.Figure",
    "Series": "pandas.Series",
    "ndarray": "numpy.ndarray",
}

# `$` before a command and prompts of Python are not copied, nor is what a command prints.
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

html_theme = "furo"
html_title = f"sysid_trib {release}"
html_baseurl = f"{PAGES}latest/"
html_logo = "_static/logo.svg"
html_favicon = "_static/logo.svg"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_js_files = ["versions.js"]
html_theme_options = {
    "source_repository": "https://github.com/sysid-trib/sysid_trib",
    "source_branch": "main",
    "source_directory": "docs/",
}
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
        "sidebar/versions.html",
    ]
}
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"

ogp_site_url = html_baseurl
ogp_description_length = 160
ogp_image = "_images/example_overview.png"
ogp_image_alt = "Result of an identification: backbone, residuals, shares of the forces, and coefficients"
ogp_social_cards = {"enable": False}


def setup(app: Sphinx) -> None:
    """Connect what is generated, and formulas as MathML, which browsers show without any script."""
    app.connect("source-read", _expand)
    app.connect("doctree-read", _fold)
    app.connect("doctree-read", _describe)
    app.connect("doctree-read", _thumbnails)
    # Before the theme makes its links to the source.
    app.connect("html-page-context", _source, priority=100)
    # Before numpydoc reads them.
    app.connect("autodoc-process-docstring", _readable, priority=400)
    app.add_html_math_renderer("mathml", (_math, None), (_math, None))


def _expand(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace each `<!-- generated: ... -->` of a page by what `generated` makes of it, and set its links."""
    if not docname.startswith("notebooks/"):
        source[0] = notebook_pages.with_links_of_the_site(generated.expand(source[0]), HERE, HERE)


def _fold(app: Sphinx, doctree: nodes.document) -> None:
    """Let a browser fold the long lines of what a command prints where they are sentences, not tables."""
    for block in doctree.findall(nodes.literal_block):
        if "python" in block.get("language", ""):
            continue
        long = [line.strip() for line in block.astext().splitlines() if len(line) > 100]
        if long and not any("   " in line for line in long):
            block["classes"].append("sentences")


def _describe(app: Sphinx, doctree: nodes.document) -> None:
    """Let the title of its section stand for a figure of a notebook where pictures are not seen."""
    for section in doctree.findall(nodes.section):
        for image in section.findall(nodes.image):
            # Sections come from the outside in: the innermost title remains.
            if "alt" not in image or image["alt"].startswith("Figure: "):
                image["alt"] = f"Figure: {section[0].astext()}"


def _thumbnails(app: Sphinx, doctree: nodes.document) -> None:
    """Put small copies of the figures of the gallery at its top, each with a link to its code."""
    if app.env.docname != "gallery":
        return
    shown = nodes.bullet_list(classes=["thumbnails"])
    for section in doctree.findall(nodes.section):
        image = next((child for child in section.findall(nodes.image)), None)
        if image is None or any(isinstance(child, nodes.section) for child in section):
            continue
        name = section[0].astext()
        link = nodes.reference("", "", refuri=f"#{section['ids'][0]}", internal=True)
        link += image.deepcopy()
        link += nodes.literal(text=name)
        shown += nodes.list_item("", nodes.paragraph("", "", link))
    title = next(doctree.findall(nodes.title))
    # Below the title and the sentence that says what the page shows.
    title.parent.insert(title.parent.index(title) + 2, shown)


def _source(app: Sphinx, page: str, template: str, context: dict[str, object], doctree: object) -> None:
    """Let the links to the source of a notebook lead to the folder of the notebooks, not to the copy."""
    if page.startswith("notebooks/"):
        context["theme_source_directory"] = ""


def _math(translator: "object", node: nodes.math) -> None:
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    translator.body.append(latex2mathml.converter.convert(node.astext(), display=display))  # type: ignore[attr-defined]
    raise nodes.SkipNode


def _readable(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Show a bar as a modulus, never as a substitution; examples are shown as they run."""
    start = lines.index("Examples") if "Examples" in lines else len(lines)
    lines[:start] = [re.sub(r"(``.*?``)|\|", lambda bar: bar[1] or r"\|", line) for line in lines[:start]]
