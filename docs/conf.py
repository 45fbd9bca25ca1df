"""Sphinx makes the book from docs/_build/pages, which `make book` prepares (occlib/course/book)."""

import re
from importlib.metadata import files

from sphinx.util.inspect import TypeAliasForwardRef

import occlib

project = "occlib"
author = "the occlib contributors"
copyright = "the occlib contributors, BSD 3-Clause"
release = version = occlib.__version__
html_title = "See around the occluder"
language = "en"

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxcontrib.bibtex",
]
exclude_patterns = ["_extra", "files"]

# Texts: plain Markdown, with a few additions of MyST.
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
bibtex_bibfiles = ["references.bib"]  # beside this file
bibtex_reference_style = "author_year"

# Chapters: shown as `occlib reproduce` executed them, never executed here.
nb_execution_mode = "off"
nb_ipywidgets_js = {}  # else two scripts from a CDN on every page
nb_mime_priority_overrides = [("html", "text/html", 0)]  # before the view of a widget, which needs a kernel
nb_merge_streams = True

# Reference: one page a room; the docstrings are numpydoc.
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("FloatArray", "Image", "Mask")} | {"npt.ArrayLike": "ArrayLike"}
TypeAliasForwardRef.__repr__ = lambda self: self.name  # else Sequence[TypeAliasForwardRef('FloatArray')] is printed
maximum_signature_line_length = 88
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# The look. Everything that a page loads lies beside it: the book is read from file:// and without the network.
html_theme = "sphinx_book_theme"
html_static_path = ["_static"]
html_extra_path = ["_build/pages/_extra"]
html_css_files = ["book.css"]
html_js_files = [("book.js", {"defer": "defer"})]
html_context = {"default_mode": "auto"}  # light or dark as the reader's system is
html_theme_options = {
    "show_toc_level": 2,
    "home_page_in_toc": True,
    "navbar_persistent": [],  # the side bar has the search
    "use_download_button": False,
    "use_fullscreen_button": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # it is fetched, which a browser refuses from file://

# One file of MathJax 3 with its own letters; version 4 would fetch its fonts.
MATHJAX = "tex-svg-full.js"
mathjax_path = MATHJAX
mathjax3_config = {"options": {"enableMenu": False}}


def copy_mathjax(app, error):
    """Copy the one file that pages with mathematics load."""
    if error is None:
        (source,) = (path for path in files("sphinx-mathjax-offline") if path.name == MATHJAX)
        target = app.outdir / "_static" / MATHJAX
        if not target.exists():
            target.write_bytes(source.locate().read_bytes())


def drop_unread(app):
    """Leave modules that Sphinx could not parse (f-strings in annotations) out of the list of sources."""
    modules = getattr(app.env, "_viewcode_modules", {})
    for name in [name for name, entry in modules.items() if not entry]:
        del modules[name]
    return []


SIGNATURE = re.compile(r'<dl>\s*((?:<dd><em class="sig-param">.*?</dd>\s*)+)</dl>', re.S)


def mend_markup(app, page, template, context, doctree):
    """Mend what a screen reader stumbles over: lists of parameters without terms, roles that do not fit together."""
    body = context.get("body", "")
    body = SIGNATURE.sub(lambda found: re.sub("<(/?)dd>", r"<\1span>", found[1]), body)
    context["body"] = body.replace('<div role="list" class="citation-list">', '<div class="citation-list">').replace(
        ' role="doc-biblioentry"', ""
    )


def setup(app):
    app.connect("html-page-context", mend_markup)
    app.connect("html-collect-pages", drop_unread, priority=100)
    app.connect("build-finished", copy_mathjax)
