"""Build the documentation site, strictly.

    python -m tools.site.build [--to build/site]

The pages in docs/ in the order of docs/nav.yaml, and those that are made of the EDS files, the configuration
classes, the command line and the docstrings (tools/site/made.py). Exit status 1, with a line for each fault,
for a page that is not in the order, a link or an anchor that leads nowhere, or anything that Sphinx warns of.
Open build/site/html/index.html; it needs no server.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from tools.site.made import MADE
from tools.site.nav import SiteError
from tools.site.pages import write_source

ROOT = Path(__file__).parents[2]
MISSING = "make site needs Sphinx, MyST and Furo: pip install 'canfb[site]'"


def main(arguments: Sequence[str] | None = None) -> int:
    """0, or 1 with the faults on stderr."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.site.build", description="build the documentation site"
    )
    parser.add_argument("--to", type=Path, default=ROOT / "build" / "site", help="folder (build/site)")
    to = parser.parse_args(arguments).to.resolve()
    try:
        write_source(ROOT, {page: make() for page, make in MADE.items()}, to / "source")
        run_sphinx(to / "source", to / "html")
    except SiteError as error:
        print(error, file=sys.stderr)
        return 1
    print(to / "html" / "index.html")
    return 0


def run_sphinx(source: Path, to: Path) -> None:
    """The site from its source; every warning is an error, all of them are shown."""
    try:
        from sphinx.cmd.build import main as sphinx
    except ModuleNotFoundError:
        raise SiteError(MISSING) from None
    shutil.rmtree(to, ignore_errors=True)
    options = ["-E", "-q", "-W", "--keep-going", "-b", "html", "-c", str(Path(__file__).parent)]
    if sphinx([*options, "-d", str(to.parent / "doctrees"), str(source), str(to)]):
        raise SiteError("the site was not built: see the warnings above")


if __name__ == "__main__":
    sys.exit(main())
