"""Real buses: clock, sockets, and the runner of any device."""

import logging

# Here, as all that logs loads this: a command that is interrupted while it loads logging has no traceback.
logging.getLogger("canfb").addHandler(logging.NullHandler())
