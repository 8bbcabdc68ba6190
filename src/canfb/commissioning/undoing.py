"""All of a change, or the state from before."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from canfb.commissioning.access import CommissioningError
from canfb.commissioning.guard import Guard
from canfb.errors import CanfbError


@contextlib.contextmanager
def all_or_nothing(guard: Guard, undo: Callable[[], str]) -> Iterator[None]:
    """Whatever fails or interrupts the change in here, ``undo`` puts back what was; then the error goes on.

    ``undo`` gives the words for that, and raises CanfbError where it does not work: the CommissioningError
    that comes of it says both. It is not interrupted.
    """
    try:
        yield
    except BaseException as error:
        with guard.held():
            try:
                said, undone = undo(), True
            except CanfbError as failure:
                said, undone = str(failure), False
        if isinstance(error, CanfbError) or not undone:
            raise CommissioningError(f"{str(error) or 'interrupted'}; {said}") from error
        raise
