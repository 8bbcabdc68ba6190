"""Settings for all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# No deadlines: a loaded machine is no finding. CI draws the same examples each time, so that a run can be
# repeated; everywhere else they are drawn anew.
settings.register_profile("default", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")
