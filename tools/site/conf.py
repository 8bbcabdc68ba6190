"""Sphinx: how the pages in build/site/source become the site (tools/site/build.py calls it)."""

from __future__ import annotations

from typing import Any

import canfb
from tools.site.api_page import as_rst

project = "canfb"
version = release = canfb.__version__
copyright = "canfb contributors, MIT licence"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
root_doc = "index"
# The anchors that a reader of the repository sees, too; a link to one that is missing is an error.
myst_heading_anchors = 6
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
html_theme = "furo"
html_title = f"canfb {release}"
html_static_path = ["static"]
html_css_files = ["canfb.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_last_updated_fmt = None
pygments_style = "friendly"
pygments_dark_style = "native"


def as_written(_app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    """Docstrings of ours are plain text with columns."""
    lines[:] = as_rst(list(lines))


def setup(app: Any) -> None:
    app.connect("autodoc-process-docstring", as_written)
