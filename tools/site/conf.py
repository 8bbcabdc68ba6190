"""Sphinx: how the pages of the repository become the site (`make site`).

The pages in docs/ follow the order of docs/index.md; the pages of docs/reference come from EDS files,
configuration classes, command line and docstrings. A page missing in that order, a broken link or anchor, and
all other warnings of Sphinx are errors. The site needs no server.
"""

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
# The same anchors as in the repository; a link to a missing one is an error.
myst_heading_anchors = 6
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
html_theme = "furo"
html_title = f"canfb {release}"
html_static_path = ["static"]
html_extra_path = ["root"]  # its index.html redirects to the first page
html_css_files = ["canfb.css"]
html_show_sphinx = False
html_copy_source = False
pygments_style = "friendly"
pygments_dark_style = "native"


def made(_app: Any, page: str, source: list[str]) -> None:
    if page in MADE:
        source[0] = MADE[page]()


def as_written(_app: Any, _what: str, _name: str, _thing: Any, _options: Any, lines: list[str]) -> None:
    """Convert docstrings of canfb, plain text with columns, to reStructuredText."""
    lines[:] = as_rst(list(lines))


def setup(app: Any) -> None:
    app.connect("source-read", made)
    app.connect("autodoc-process-docstring", as_written)
