"""Who may see the page: tokens, cookies, host names, origins."""

from __future__ import annotations

import pytest

from canfb.scope.gate import HEADERS, Gate, GateVerdict, Request

PORT = 8000
GATE = Gate(PORT)
HOST = {"host": f"127.0.0.1:{PORT}"}
COOKIE = {GATE.cookie: GATE.token}
WEBSOCKET = {"upgrade": "websocket"}


def verdict(
    headers: dict[str, str], cookies: dict[str, str] = COOKIE, token: str | None = None, method: str = "GET"
) -> GateVerdict:
    return GATE.judge(Request(method, headers, cookies, token))[0]


def test_the_token_lets_in_and_the_cookie_serves() -> None:
    assert verdict(HOST, {}, GATE.token) is GateVerdict.LET_IN
    assert verdict(HOST) is GateVerdict.SERVED
    assert GATE.token in GATE.address


@pytest.mark.parametrize(
    "token",
    ["", "x", GATE.token[:-1], GATE.token + "x", GATE.token.upper(), "\udcff"],
    ids=["none", "another", "shorter", "longer", "capitals", "no text"],  # the same in each process
)
def test_another_token_is_refused(token: str) -> None:
    assert verdict(HOST, {}, token) is GateVerdict.REFUSED
    assert verdict(HOST, COOKIE, token) is GateVerdict.REFUSED
    assert verdict(HOST, {GATE.cookie: token}) is GateVerdict.REFUSED


def test_the_cookie_of_another_port_is_refused() -> None:
    assert verdict(HOST, {"canfb-scope-8001": GATE.token}) is GateVerdict.REFUSED
    assert verdict(HOST, {}) is GateVerdict.REFUSED


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8000", "127.0.0.1", "127.0.0.1:8001", "127.0.0.1:8000.evil.example", ""],
)
def test_another_host_name_is_refused(host: str) -> None:
    assert verdict({"host": host}) is GateVerdict.REFUSED
    assert verdict({}) is GateVerdict.REFUSED


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "LocalHost"])
def test_the_names_of_loopback_are_served(name: str) -> None:
    assert verdict({"host": f"{name}:{PORT}"}) is GateVerdict.SERVED


@pytest.mark.parametrize(
    "origin", ["null", "", "http://evil.example", "https://127.0.0.1:8000", "http://127.0.0.1:8001"]
)
def test_another_origin_is_refused(origin: str) -> None:
    assert verdict({**HOST, "origin": origin}) is GateVerdict.REFUSED
    assert verdict({**HOST, **WEBSOCKET, "origin": origin}) is GateVerdict.REFUSED


def test_a_websocket_needs_an_origin() -> None:
    assert verdict({**HOST, **WEBSOCKET}) is GateVerdict.REFUSED
    assert verdict({**HOST, **WEBSOCKET, "origin": f"http://127.0.0.1:{PORT}"}) is GateVerdict.SERVED


@pytest.mark.parametrize("method", ["POST", "PUT", "OPTIONS", "CONNECT", ""])
def test_only_get_is_answered(method: str) -> None:
    assert verdict(HOST, method=method) is GateVerdict.REFUSED


def test_each_start_has_a_token_of_its_own() -> None:
    tokens = {Gate(PORT).token for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 43  # 256 bits


def test_at_port_80_browsers_leave_the_port_out() -> None:
    gate = Gate(80)
    assert gate.hosts == ["127.0.0.1", "127.0.0.1:80", "localhost", "localhost:80"]


def test_no_header_allows_scripts_of_others_inline_scripts_or_eval() -> None:
    rules = dict(one.strip().partition(" ")[::2] for one in HEADERS["Content-Security-Policy"].split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == rules["connect-src"] == "'self'"
    assert rules["frame-ancestors"] == rules["base-uri"] == rules["form-action"] == "'none'"
    assert not any("http" in rule or "*" in rule or "eval" in rule for rule in rules.values())
