"""The server of the page: who gets what, and what a peer can do to it."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
from collections.abc import Iterator
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.errors import CanfbError
from canfb.scope import page_server
from canfb.scope.page_server import (
    FILES,
    HEADERS,
    MOST_CONNECTIONS,
    MOST_WAITING,
    OPEN_ADDRESS,
    STREAM,
    PageServer,
    event,
)

PATIENCE_S = 60.0
PAST = event("past", "{}")


@pytest.fixture(scope="module")
def page() -> Iterator[PageServer]:
    with PageServer(0, lambda: PAST) as server:
        yield server


def connected(page: PageServer) -> http.client.HTTPConnection:
    host, _, port = page.host.partition(":")
    return http.client.HTTPConnection(host, int(port), timeout=PATIENCE_S)


def answer(page: PageServer, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    with closing(connected(page)) as connection:
        connection.request(method, path, headers=headers)
        got = connection.getresponse()
        assert {name: got.headers[name] for name in HEADERS} == HEADERS
        return got.status, got.read()


@pytest.mark.parametrize("path", FILES)
def test_files_are_for_everybody_and_have_no_secret(page: PageServer, path: str) -> None:
    status, content = answer(page, path)
    assert status == 200
    assert content
    assert page.token.encode() not in content


@pytest.mark.parametrize(
    ("path", "headers", "status", "said"),
    [
        ("/", {"Host": "localhost:{port}"}, 403, "another host name"),
        ("/", {"Host": "evil.example:{port}"}, 403, "another host name"),
        ("/", {"Origin": "http://evil.example"}, 403, "another site"),
        ("/events?{token}", {"Origin": "http://localhost:{port}"}, 403, "another site"),
        ("/events", {}, 403, OPEN_ADDRESS),
        ("/events?", {}, 403, OPEN_ADDRESS),
        ("/events?{token}x", {}, 403, OPEN_ADDRESS),
        ("/events", {"Cookie": "token={token}"}, 403, OPEN_ADDRESS),
        ("/events?%FF%C3", {}, 403, OPEN_ADDRESS),
        ("/page.py", {}, 404, "no such page"),
        ("/../pyproject.toml", {}, 404, "no such page"),
        ("http://evil.example/", {}, 403, "another host name"),
    ],
)
def test_what_is_refused(
    page: PageServer, path: str, headers: dict[str, str], status: int, said: str
) -> None:
    known = {"token": page.token, "port": page.host.partition(":")[2]}
    filled = {name: value.format(**known) for name, value in headers.items()}
    got, content = answer(page, path.format(**known), **filled)
    assert (got, said in content.decode()) == (status, True)


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "HEAD", "OPTIONS"])
def test_it_only_answers_get(page: PageServer, method: str) -> None:
    assert answer(page, f"{STREAM}?{page.token}", method)[0] == 501


@given(st.text(max_size=20), st.one_of(st.none(), st.text(max_size=30)), st.text(max_size=50))
def test_nobody_gets_the_stream_without_the_token(
    page: PageServer, host: str, origin: str | None, token: str
) -> None:
    assert page.refusal([host], origin, STREAM, token)
    assert page.refusal([page.host, page.host], None, STREAM, page.token)
    assert page.refusal([page.host], None, STREAM, token)
    assert not page.refusal([page.host], f"http://{page.host}", STREAM, page.token)


def test_the_stream_has_the_past_and_then_what_is_published(page: PageServer) -> None:
    with closing(connected(page)) as connection:
        connection.request("GET", f"{STREAM}?{page.token}")
        got = connection.getresponse()
        assert got.headers["Content-Type"] == "text/event-stream"
        assert got.read(len(PAST)) == PAST
        assert page.is_seen()
        look = event("look", json.dumps({"text": "a\nb"}))
        page.publish(look)
        assert got.read(len(look)) == look == b'event: look\ndata: {"text": "a\\nb"}\n\n'
        got.close()
    while page.is_seen():  # it notices at the next event
        page.publish(look)


def test_a_page_that_takes_nothing_is_cut_off_and_the_others_go_on(page: PageServer) -> None:
    with page.viewer() as slow, page.viewer() as good:
        for _ in range(2 * MOST_WAITING):
            page.publish(PAST)
            assert good.get_nowait() == PAST
        assert None in [slow.get_nowait() for _ in range(slow.qsize())]


def test_connections_beyond_the_most_are_closed_and_later_ones_served(
    page: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server._Handler, "timeout", PATIENCE_S)
    host, _, port = page.host.partition(":")
    idle = [socket.create_connection((host, int(port)), PATIENCE_S) for _ in range(MOST_CONNECTIONS)]
    with closing(socket.create_connection((host, int(port)), PATIENCE_S)) as one_more:
        assert one_more.recv(1) == b""
    for one in idle:
        one.close()
    status = 0
    while status != 200:
        try:
            status, _ = answer(page, "/")
        except (http.client.HTTPException, OSError):
            continue


def test_whatever_is_sent_it_goes_on(page: PageServer) -> None:
    host, _, port = page.host.partition(":")
    for data in (
        b"\0\xff\n\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET " + b"a" * 100_000,
        b"GET /\r\nHost\r\n\r\n",
    ):
        peer = socket.create_connection((host, int(port)), PATIENCE_S)
        with closing(peer), contextlib.suppress(OSError):  # it may be cut off before its end
            peer.sendall(data)
            peer.shutdown(socket.SHUT_WR)
            while peer.recv(4096):
                pass
    assert answer(page, "/")[0] == 200


@pytest.mark.parametrize("port", [70_000, None])
def test_a_port_that_cannot_be_had_is_one_line(page: PageServer, port: int | None) -> None:
    taken = int(page.host.partition(":")[2]) if port is None else port
    with pytest.raises(CanfbError, match=f"cannot listen at 127.0.0.1:{taken}: .+"):
        PageServer(taken, lambda: PAST)
    with PageServer(0, lambda: PAST) as other:
        assert other.address == f"http://{other.host}/#{other.token}"
        assert other.token != page.token
