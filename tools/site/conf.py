"""Sphinx: how the pages of the repository become the site (`make site`).

The pages in docs/ in the order of docs/index.md; those of docs/reference are made of the EDS files, the
configuration classes, the command line and the docstrings. A page that is not in the order, a link or an
anchor that leads nowhere, and anything else that Sphinx warns of is an error. It needs no server.
"""

from __future__ import annotations

from typing import Any

import canfb
from tools.site.reference import commands_page, keys_page, objects_page
from tools.site.text import as_rst

MADE = {
    "docs/reference/objects": objects_page,
    "docs/reference/keys": keys_page,
    "docs/reference/commands": commands_page,
}
project = "canfb"
version = release = canfb.__version__
copyright = "canfb contributors, MIT licence"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
root_doc = "docs/index"
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**.md"]
# The anchors that a reader of the repository sees, too; a link to one that is missing is an error.
myst_heading_anchors = 6
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
html_theme = "furo"
html_title = f"canfb {release}"
html_static_path = ["static"]
html_extra_path = ["root"]  # its index.html leads to that of the pages
html_css_files = ["canfb.css"]
html_show_sphinx = False
html_copy_source = False
pygments_style = "friendly"
pygments_dark_style = "native"


def made(_app: Any, page: str, source: list[str]) -> None:
    if page in MADE:
        source[0] = MADE[page]()


def as_written(_app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    """Docstrings of ours are plain text with columns."""
    lines[:] = as_rst(list(lines))


def setup(app: Any) -> None:
    app.connect("source-read", made)
    app.connect("autodoc-process-docstring", as_written)
