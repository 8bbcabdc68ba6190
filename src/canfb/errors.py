"""The errors of the package, one tree.

CanfbError
├── ConfigError         an unusable configuration; names key and line
├── CalibrationError    a reference measurement that was refused
├── BusError            a bus that cannot be opened or has failed permanently
├── StateDirError       a state_dir that cannot be used (canfb.hosting.state_files)
├── SourceError         a source that cannot provide samples (canfb.sources.protocol)
└── EdsNotFoundError    a missing EDS file (canfb.eds_files)
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

LONGEST_REASON = 300  # Characters: the messages of others quote what they were given, of any length.


class CanfbError(Exception):
    """Root of all errors of this package."""


class CalibrationError(CanfbError):
    """A reference measurement that was refused.

    reason        a short stable word, one of :class:`canfb.calibration.result.Reason`
    calibration   the refused :class:`canfb.calibration.result.Calibration`, for diagnosis
                  only, if there is one; else None
    """

    def __init__(self, message: str, reason: str = "", calibration: Any = None) -> None:
        super().__init__(message)
        self.reason = reason
        self.calibration = calibration


class ConfigError(CanfbError):
    """An unusable configuration; the text names file, line and key."""


class BusError(CanfbError):
    """A bus that cannot be opened or has failed permanently."""


@contextlib.contextmanager
def saying(refuse: type[Exception], what: str, *kinds: type[Exception]) -> Iterator[None]:
    """``refuse`` says what failed and why, for ``kinds`` within."""
    try:
        yield
    except kinds as error:
        raise refuse(f"{what}: {reason(error)}") from error


def reason(error: Exception) -> str:
    """One line, LONGEST_REASON characters at most: what another library or the system says."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    text = str(error).strip().splitlines()
    return text[0][:LONGEST_REASON] if text else type(error).__name__


def meant(word: str, known: Sequence[str]) -> str:
    """Which of the ``known`` words an unknown ``word`` may mean; else all of them."""
    import difflib  # here: only a wrong word needs it

    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
