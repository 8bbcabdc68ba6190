"""Print the names of the tests that `make check` leaves out: those that take long.

    python -m tools.suite.long_tests > build/long.txt && mv build/long.txt tests/long_tests.txt
    python -m tools.suite.long_tests tests/signal

In one process, on an idle machine; all tests take ten minutes. What a fixture of a test or of a module takes
is added to the tests that use it, in equal parts.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Generator
from contextlib import redirect_stdout
from typing import Any

import pytest

LONG_S = 0.05


class Stopwatch:
    """A plugin of pytest: what each test takes, by its name without parameters."""

    def __init__(self) -> None:
        self._calls: defaultdict[str, float] = defaultdict(float)  # the longest case, s
        self._fixtures: defaultdict[tuple[str, str], float] = defaultdict(float)  # by file and name, s
        self._uses: defaultdict[tuple[str, str], list[str]] = defaultdict(list)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, Any, Any]:
        began = time.perf_counter()
        try:
            return (yield)
        finally:
            name = name_of(item.nodeid)
            self._calls[name] = max(self._calls[name], time.perf_counter() - began)
            for fixture in getattr(item, "fixturenames", ()):
                self._uses[file_of(item.nodeid), fixture].append(name)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, Any, Any]:
        began = time.perf_counter()
        try:
            return (yield)
        finally:
            self._fixtures[file_of(request.node.nodeid), fixturedef.argname] += time.perf_counter() - began

    def long(self, limit_s: float = LONG_S) -> list[str]:
        """Names of the tests that take longer, with their part of the fixtures, in alphabetical order."""
        takes = dict(self._calls)
        shares: defaultdict[tuple[str, str], float] = defaultdict(float)
        for place, spent in self._fixtures.items():
            users = self._uses[place]
            for name in set(users):
                shares[place[0], name] += spent / len(users)
        for (_, name), share in shares.items():
            takes[name] = max(takes[name], share)
        return sorted(name for name, taken in takes.items() if taken > limit_s)


def file_of(nodeid: str) -> str:
    return nodeid.partition("::")[0]


def name_of(nodeid: str) -> str:
    """As tests/conftest.py looks it up: whatever the file and the parameters are."""
    return nodeid.partition("::")[2].partition("[")[0]


def main(arguments: list[str]) -> int:
    watch = Stopwatch()
    chosen = ["-m", "not socketcan", "--hypothesis-profile", "check", "-p", "no:xdist"]
    with redirect_stdout(sys.stderr):
        status = pytest.main(["-q", *chosen, *arguments], [watch])
    sys.stdout.write("".join(f"{name}\n" for name in watch.long()))
    return int(status)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
