"""The page: its server, what a peer can do to it, and what its pictures are drawn from."""

import contextlib
import http.client
import json
import math
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import canfb
from canfb import CanfbError, Config, objects as od
from canfb.monitoring.layout import known_layouts
from canfb.monitoring.lines import MachineUnits
from canfb.monitoring.sdo_reading import ModuleReading
from canfb.monitoring.snapshot import ModuleSnapshot
from canfb.scope import page_server
from canfb.scope.page_server import (
    FILES,
    HEADERS,
    MOST_CONNECTIONS,
    MOST_WAITING,
    OPEN_ADDRESS,
    STREAM,
    LivePage,
    PageServer,
    event,
)
from canfb.scope.traces import EVERY_S, LEAST_SAMPLES, LONGEST_S, ModuleTraces
from canfb.signal.correction import NO_CORRECTION, Correction
from folding import each
from monitored_network import NODE, MonitoredNetwork

PATIENCE_S = 60.0
PAST = event("past", "{}")


@pytest.fixture(scope="module")
def page() -> Iterator[PageServer]:
    with PageServer(0, lambda: PAST) as server:
        yield server


def connected(page: PageServer) -> http.client.HTTPConnection:
    return http.client.HTTPConnection(page.host, timeout=PATIENCE_S)


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


@each("path, headers, status, said", [
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
])  # fmt: skip
def test_it_is_refused(page: PageServer, path: str, headers: dict[str, str], status: int, said: str) -> None:
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
        with contextlib.suppress(http.client.HTTPException, OSError):
            status, _ = answer(page, "/")


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


UNITS = MachineUnits(5.0, "mm")


class Traced:
    """A network whose module is looked at five times a second."""

    def __init__(self) -> None:
        self.network, self.traces = MonitoredNetwork(), ModuleTraces(UNITS)

    def run(self, seconds: float) -> None:
        end = self.network.bus.now + seconds
        while self.network.bus.now < end:
            self.network.run(0.2)
            self.traces.take(self.network.bus.now, self.network.module())


def test_position_velocity_residual_amplitude_and_faults_are_followed() -> None:
    traced = Traced()
    traced.run(3.0)
    points = np.array(traced.traces.points, float)
    assert len(points) == 15
    time_s, position, velocity, residual, limit, amplitude, raw, faults, invalid = points[-5:].T
    assert np.ptp(time_s) == pytest.approx(0.8)
    assert velocity == pytest.approx(63.7 / 60 * 5.0, rel=0.02)
    assert np.diff(position) == pytest.approx(0.2 * 63.7 / 60 * 5.0, rel=0.02)
    assert (residual > 0.0).all()
    assert limit == pytest.approx(1 / 3, abs=1e-4)
    assert np.isnan(amplitude).all(), "2011:05 is not read"
    assert (np.abs(raw - 1500) < 200).all()
    assert not np.concatenate([faults, invalid]).any()
    traced.network.source.lost = True
    traced.run(0.2)
    _, position, velocity, *_, faults, invalid = traced.traces.points[-1]
    assert (position, velocity, invalid) == (None, None, 1)
    assert faults
    assert faults > 0


def test_what_is_remembered_is_bounded_and_a_clock_that_is_set_begins_again() -> None:
    traces, module = ModuleTraces(UNITS), ModuleSnapshot("EDS", age_s=0.0, position_revolutions=1.0)
    for k in range(2000):
        traces.take(0.2 * k, module)
    assert traces.points[-1][0] == pytest.approx(399.8)
    assert LONGEST_S - 0.5 < 399.8 - (traces.points[0][0] or 0.0) <= LONGEST_S
    traces.take(1.0, module)
    assert len(traces.points) == 1


def test_the_deviation_is_that_of_the_encoder_and_nearly_gone_with_its_table() -> None:
    traced = Traced()
    traced.run(4.0)
    traces, now = traced.traces, traced.network.bus.now
    before = traces.deviation(now, 2048)
    assert before is not None
    assert traces.deviation(now + 0.9 * EVERY_S, 2048) is None
    rms = np.sqrt(np.mean(np.square(before["before"])))
    assert 0.5 < rms < 3.0  # % of a cycle: the encoder of the demo has 1.2
    assert set(before["mean"]) == {None}
    assert before["text"].startswith("no table is active: ")
    _, sine, cosine = np.array(traces._samples).T
    found = canfb.calibrate_from_motion(sine, cosine)
    traces.read = Correction(found.table, found.conditioning)
    traces.take(now, replace(traced.network.module(), table_active=True, table_crc32=found.table.crc32))
    after = traces.deviation(now, 2048)
    assert after is not None, "at once"
    assert np.abs(after["mean"]).max() < 0.2 * np.abs(after["before"]).max()
    assert f"with the active table {found.table.crc32:08X}h 0.0" in after["text"]


def test_the_table_has_one_state() -> None:
    """What was read counts only while bit 7 and 2020:04 agree with it."""
    table = canfb.CorrectionTable(np.arange(64) / 64)
    read = Correction(table)
    module = ModuleSnapshot("module", age_s=0.0, status=1)
    active = replace(module, table_active=True, table_crc32=table.crc32)
    for was_read, looks_like, known in (
        (None, module, NO_CORRECTION),
        (None, active, None),
        (read, active, read),
        (read, replace(active, table_crc32=7), None),
        (read, replace(active, table_active=False), NO_CORRECTION),
        (NO_CORRECTION, replace(module, table_crc32=0), NO_CORRECTION),
        (NO_CORRECTION, replace(active, table_crc32=0), None),
        (None, replace(module, status=None), None),
        (read, replace(module, status=None, table_crc32=table.crc32), read),
    ):
        traces = ModuleTraces(UNITS)
        if was_read is not None:
            traces.read = was_read
        traces.take(1.0, looks_like)
        assert traces.correction == known


def test_there_is_no_deviation_of_few_samples_nor_at_standstill() -> None:
    traces = ModuleTraces(UNITS)
    module = ModuleSnapshot("EDS", full_scale_counts=2048)
    for n, why in enumerate([f"of {LEAST_SAMPLES} samples", *["only while the machine turns"] * 9]):
        for k in range(1 if n == 0 else 6):
            heard = 100 * (10 * n + k + 1)
            tracks = [(1000 + j % 3, 1000 - j % 2) for j in range(100)]
            traces.take(10.0 * n, replace(module, tracks_counts=tracks, tracks_heard=heard))
        curve = traces.deviation(10.0 * n, module.full_scale_counts)
        assert curve is not None
        assert why in curve["text"]


def told(events: bytes | None) -> dict[str, Any]:
    """The data of these events, by name."""
    assert events is not None
    found = {}
    for one in events.decode().split("\n\n")[:-1]:
        name, data = one.split("\n")
        found[name.removeprefix("event: ")] = json.loads(data.removeprefix("data: "))
    return found


def test_a_page_gets_the_past_then_each_look_with_what_was_read() -> None:
    network = MonitoredNetwork()
    page = LivePage(0, UNITS)
    with page.server:
        for _ in range(5):
            network.run(0.2)
            page.show(network.model.snapshot(network.bus.now))
        with page.server.viewer() as events:
            begin = told(events.get_nowait())
            assert begin["past"]["units"] == {"position": "mm", "velocity": "mm/s"}
            assert len(begin["past"]["points"][str(NODE)]) == 5
            assert begin["look"]["modules"][0]["point"] == begin["past"]["points"][str(NODE)][-1]
            (layout,) = known_layouts(Config(), [NODE])
            page.know(ModuleReading({}, layout, NO_CORRECTION))
            network.model.learn(layout).put(od.COUNTER_LOST, 4, network.bus.now)
            network.model.learn(layout).put(od.FEEDBACK_VELOCITY, math.nan, network.bus.now + 0.2)
            network.run(0.2)
            page.show(network.model.snapshot(network.bus.now))
            look = told(events.get_nowait())["look"]
    assert "NaN" not in json.dumps(look), "no JSON, and the page would stand still"
    (module,) = look["modules"]
    assert (module["node"], module["tone"]) == (NODE, "good")
    assert module["point"][0] == pytest.approx(1.2)
    assert dict(module["lines"])["status"] == [["valid", "good"]]
    assert ["lost", 4, 0] in module["counters"]
    assert len(module["tracks"]) == 400
    assert look["others"] == "16 OPERATIONAL"
    assert begin["look"]["modules"][0]["deviation"]["text"].startswith("no table is active")
