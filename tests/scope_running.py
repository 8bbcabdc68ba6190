"""``canfb scope --demo`` in a thread of the test, for tests that look at it from outside and from inside."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canfb.cli import printing, scope
from canfb.cli.main import build_parser
from canfb.hosting.trying import ScopeDemo

LINES_S = 300.0  # of one test, on a busy machine


class Running:
    """The command in a thread, on a demo network whose module the test looks into."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.ready = threading.Event()
        self.said: list[str] = []
        self.servers: list[Any] = []
        self.networks: list[ScopeDemo] = []
        self.parts: list[Any] = []
        self.error: BaseException | None = None
        arguments = ["scope", "--demo", "--ready-file", str(folder / "ready"), *options]
        self.options = build_parser().parse_args(arguments)
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            scope.scope(self.options)
        except BaseException as error:
            self.error = error
        finally:
            self.ready.set()

    @property
    def code(self) -> str:
        """Of the tasks that write, as the terminal says it."""
        return self.said[1].rpartition(" ")[2]

    @contextlib.contextmanager
    def started(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
        """Its address, with the token."""
        from canfb.cli import scope_parts
        from canfb.hosting import trying
        from canfb.scope import scope_server

        servers, networks, parts, ready = self.servers, self.networks, self.parts, self.ready

        class Server(scope_server.ScopeServer):
            def run(self) -> None:
                servers.append(self)
                ready.set()
                super().run()

        class Network(trying.ScopeDemo):
            def __init__(self) -> None:
                super().__init__()
                networks.append(self)

        class Parts(scope_parts.ScopeParts):
            def __init__(self, *arguments: Any) -> None:
                super().__init__(*arguments)
                parts.append(self)

        monkeypatch.setattr(scope_server, "ScopeServer", Server)
        monkeypatch.setattr(scope_parts, "ScopeParts", Parts)
        monkeypatch.setattr(trying, "ScopeDemo", Network)
        monkeypatch.setattr(printing, "say", self.said.append)
        monkeypatch.setattr(scope, "ending_on_signals", lambda stop: contextlib.nullcontext())
        self._thread.start()
        try:
            assert self.ready.wait(LINES_S)
            assert self.error is None, self.error
            yield self.said[0].removeprefix("open ")
        finally:
            for server in servers:
                server.stop()
            self._thread.join(LINES_S)
            assert not self._thread.is_alive()
            assert self.error is None, self.error
