"""The errors of the package, one tree.

    CanfbError
    ├── ConfigError         a configuration that cannot be used; names key and line
    └── CalibrationError    a reference measurement that was refused
"""

from __future__ import annotations


class CanfbError(Exception):
    """Root of all errors of this package."""
