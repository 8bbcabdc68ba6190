"""Work of a campaign in several processes: results in the order of the work, whatever their number."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Work = TypeVar("Work")
Result = TypeVar("Result")


def side_by_side(
    function: Callable[[Work], Result], work: Iterable[Work], processes: int
) -> Iterator[Result]:
    """``function`` of each piece of ``work``; both must be importable or picklable."""
    if processes == 1:
        yield from map(function, work)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(function, work)
