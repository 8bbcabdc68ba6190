"""Build the documentation site, strictly.

    python -m tools.site.build [--to build/site]

The pages in docs/ in the order of docs/index.md; those of docs/reference are made of the EDS files, the
configuration classes, the command line and the docstrings. Exit status 1 for a page that is not in the order,
a link or an anchor that leads nowhere, or anything else that Sphinx warns of. It needs no server.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
MISSING = "make site needs Sphinx, MyST and Furo: pip install 'canfb[site]'"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.site.build", description="build the documentation site"
    )
    parser.add_argument("--to", type=Path, default=ROOT / "build" / "site", help="folder (build/site)")
    to = parser.parse_args(arguments).to.resolve()
    try:
        from sphinx.cmd.build import main as sphinx
    except ModuleNotFoundError:
        sys.exit(MISSING)
    shutil.rmtree(to, ignore_errors=True)
    options = ["-E", "-q", "-W", "--keep-going", "-b", "html", "-c", str(Path(__file__).parent)]
    if sphinx([*options, "-d", str(to / "doctrees"), str(ROOT), str(to / "html")]):
        return 1
    print(to / "html" / "index.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
