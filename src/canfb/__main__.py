# PYTHON_ARGCOMPLETE_OK: argcomplete looks for it here
"""``python -m canfb``: the command line."""

import sys

from canfb.cli.main import main

sys.exit(main())
