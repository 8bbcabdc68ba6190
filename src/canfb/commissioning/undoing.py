"""All of a change, or the state from before."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from canfb.commissioning.access import CommissioningError, NodeAccess
from canfb.commissioning.guard import Guard
from canfb.commissioning.node_state import without_restart
from canfb.errors import CanfbError

PAUSE_S = 1.0  # before the second attempt: a bus that is away for a moment, a node that starts
ATTEMPTS = 2


@contextlib.contextmanager
def all_or_nothing(module: NodeAccess, guard: Guard, undo: Callable[[], str]) -> Iterator[None]:
    """Whatever fails or interrupts the change in here, ``undo`` puts back what was; then the error goes on.

    A module that is restarted meanwhile counts as a failure: it has lost what was not saved.

    ``undo`` gives the words for that, and raises CanfbError where it does not work: the CommissioningError
    that comes of it says both. It is not interrupted.
    """
    try:
        with without_restart(module):
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


def put_back(module: NodeAccess, what: str, act: Callable[[], None], *, saving: bool = False) -> None:
    """``act`` writes ``what`` from before, and proves it; once more after a moment, if the bus fails.

    CommissioningError, which says how things stand and what to do, if that does not work either; with
    ``saving`` it may have been saved already.
    """
    for attempt in range(ATTEMPTS):
        try:
            if attempt:
                module.master.wait(PAUSE_S)
            with without_restart(module):
                act()
            return
        except CanfbError as error:
            if attempt < ATTEMPTS - 1:
                continue
            saved = (
                "either what was saved before or the new values, whole" if saving else "what is saved in it"
            )
            raise CommissioningError(
                f"{what} could not be put back ({error}): switch {module.name} off and on, which brings back "
                f"{saved}"
            ) from error
