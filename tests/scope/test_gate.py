"""Who may see the page, and who may write: token, tickets, code, host names, origins."""

from __future__ import annotations

import pytest

from canfb.scope.gate import (
    CODE_LENGTH,
    MOST_TICKETS,
    MOST_WRONG,
    SESSION,
    SOCKET,
    Gate,
    GateVerdict,
    Request,
    WriteCode,
    headers_of,
)

PORT = 8000
GATE = Gate(PORT, ["/", "/scope.js"])
HOST = {"host": f"127.0.0.1:{PORT}"}
OWN = {**HOST, "origin": f"http://127.0.0.1:{PORT}"}


def verdict(headers: dict[str, str], path: str = "/", method: str = "GET", gate: Gate = GATE) -> GateVerdict:
    return gate.judge(Request(method, path, headers))[0]


def asked(token: str, headers: dict[str, str] = OWN, kind: str = "Bearer") -> GateVerdict:
    return verdict({**headers, "authorization": f"{kind} {token}"}, SESSION, "POST")


def opened(protocols: str, headers: dict[str, str] = OWN, gate: Gate = GATE) -> GateVerdict:
    said = {"upgrade": "websocket", "sec-websocket-protocol": protocols}
    return verdict({**headers, **said}, SOCKET, gate=gate)


def test_the_page_is_for_everybody_and_the_token_for_a_ticket() -> None:
    assert verdict(HOST) is verdict(OWN) is verdict(HOST, "/scope.js") is GateVerdict.SERVED
    assert asked(GATE.token) is GateVerdict.TICKET
    assert GATE.address == f"http://127.0.0.1:{PORT}/#{GATE.token}"  # a fragment: it is in no request


@pytest.mark.parametrize(
    "token",
    ["", "x", GATE.token[:-1], GATE.token + "x", GATE.token.upper(), "\udcff"],
    ids=["none", "another", "shorter", "longer", "capitals", "no text"],  # the same in each process
)
def test_another_token_is_refused(token: str) -> None:
    assert asked(token) is GateVerdict.REFUSED


def test_the_token_is_taken_in_its_header_alone() -> None:
    assert asked(GATE.token, kind="Basic") is GateVerdict.REFUSED
    for kind in ("cookie", "referer", "sec-websocket-protocol"):
        for text in (GATE.token, f"canfb-scope-{PORT}={GATE.token}", f"bokeh, {GATE.token}"):
            assert verdict({**OWN, kind: text}, SESSION, "POST") is GateVerdict.REFUSED
            assert opened("bokeh, x", {**OWN, kind: text}) is GateVerdict.REFUSED


def test_a_ticket_opens_one_websocket() -> None:
    gate = Gate(PORT, [])
    ticket = gate.issue("one.ticket")
    assert opened(f"bokeh, {ticket}x", gate=gate) is GateVerdict.REFUSED
    assert opened(f"other, {ticket}", gate=gate) is GateVerdict.REFUSED
    assert opened(ticket, gate=gate) is GateVerdict.REFUSED
    assert opened(f"bokeh, {ticket}", {**HOST, "origin": "http://127.0.0.1:9"}, gate) is GateVerdict.REFUSED
    assert opened(f"bokeh, {ticket}", gate=gate) is GateVerdict.CONNECTED
    assert opened(f"bokeh, {ticket}", gate=gate) is GateVerdict.REFUSED


def test_tickets_that_nobody_uses_are_bounded() -> None:
    gate = Gate(PORT, [])
    tickets = [gate.issue(f"ticket {n}") for n in range(MOST_TICKETS + 1)]
    assert opened(f"bokeh, {tickets[0]}", gate=gate) is GateVerdict.REFUSED
    assert all(opened(f"bokeh, {one}", gate=gate) is GateVerdict.CONNECTED for one in tickets[1:])


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "evil.example:8000", "127.0.0.1", "127.0.0.1:8001", "127.0.0.1:8000.evil.example", "",
        "localhost:8000", "[::1]:8000",
    ],
)  # fmt: skip
def test_another_host_name_is_refused(host: str) -> None:
    """localhost too: it may be [::1], where somebody else may listen."""
    for path in ("/", "/scope.js"):
        assert verdict({"host": host}, path) is GateVerdict.REFUSED
    assert asked(GATE.token, {**OWN, "host": host}) is GateVerdict.REFUSED
    assert verdict({}) is GateVerdict.REFUSED


@pytest.mark.parametrize(
    "origin", ["null", "", "http://evil.example", "https://127.0.0.1:8000", "http://127.0.0.1:8001"]
)
def test_another_origin_is_refused(origin: str) -> None:
    other = {**HOST, "origin": origin}
    assert verdict(other) is GateVerdict.REFUSED
    assert asked(GATE.token, other) is GateVerdict.REFUSED
    gate = Gate(PORT, [])
    assert opened(f"bokeh, {gate.issue('ticket')}", other, gate) is GateVerdict.REFUSED


def test_what_needs_a_secret_needs_an_origin() -> None:
    assert asked(GATE.token, HOST) is GateVerdict.REFUSED
    gate = Gate(PORT, [])
    assert opened(f"bokeh, {gate.issue('ticket')}", HOST, gate) is GateVerdict.REFUSED


@pytest.mark.parametrize("method", ["POST", "PUT", "OPTIONS", "CONNECT", "HEAD", ""])
def test_the_page_only_answers_get(method: str) -> None:
    assert verdict(OWN, method=method) is GateVerdict.REFUSED


@pytest.mark.parametrize("method", ["GET", "PUT", "OPTIONS", "HEAD", ""])
def test_a_ticket_is_asked_for_by_post(method: str) -> None:
    said = {**OWN, "authorization": f"Bearer {GATE.token}"}
    assert verdict(said, SESSION, method) is GateVerdict.REFUSED


@pytest.mark.parametrize("path", ["/live", "/live/", "/live/autoload.js", "/live/metadata", "/static/x"])
def test_nothing_else_is_served(path: str) -> None:
    """Bokeh's own page has the token of a session in it."""
    assert verdict(OWN, path) is GateVerdict.REFUSED


def test_each_start_has_secrets_of_its_own() -> None:
    tokens = {Gate(PORT, []).token for _ in range(100)}
    assert len(tokens) == len({WriteCode().code for _ in range(100)}) == 100
    assert min(map(len, tokens)) >= 43  # 256 bits


def test_at_port_80_browsers_leave_the_port_out() -> None:
    assert Gate(80, []).hosts == ["127.0.0.1", "127.0.0.1:80"]


def test_no_header_allows_what_others_bring() -> None:
    """No inline script or style, no eval, no other address; styles of Bokeh by the nonce of their page."""
    for nonce in ("", "abc"):
        policy = headers_of(nonce)["Content-Security-Policy"]
        rules = dict(one.strip().partition(" ")[::2] for one in policy.split(";"))
        assert rules["default-src"] == "'none'"
        assert rules["script-src"] == rules["connect-src"] == "'self'"
        assert rules["frame-ancestors"] == rules["base-uri"] == rules["form-action"] == "'none'"
        assert rules["style-src"] == ("'self' 'nonce-abc'" if nonce else "'self'")
        assert not any("http" in rule or "*" in rule or "unsafe" in rule for rule in rules.values())


def test_the_code_is_right_in_any_writing() -> None:
    code = WriteCode()
    assert len(code.code) == CODE_LENGTH
    for said in (code.code, str(code), f" {str(code).lower()} ", " ".join(code.code)):
        assert code.refusal(said) == ""
    for said in ("", "  ", code.code[1:], code.code + "A", "\udcff", code.code[::-1] + "A"):
        assert "code" in code.refusal(said)


def test_codes_cannot_be_tried_out() -> None:
    code = WriteCode()
    for _ in range(100):
        assert "type the code" in code.refusal("")  # is no attempt
    said = [code.refusal("AAAA-AAAA") for _ in range(MOST_WRONG)]
    assert "is not the code" in said[-2]
    assert "until canfb scope is started again" in said[-1]
    assert code.refusal(code.code) != ""
