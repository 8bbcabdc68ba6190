from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import ID, OK, Bench

from canfb.cia301.codes import AbortCode
from canfb.cia301.nmt import NmtState
from canfb.device.od.dictionary import Dictionary

COMMANDS = {1: NmtState.OPERATIONAL, 2: NmtState.STOPPED, 128: NmtState.PRE_OPERATIONAL}
STATES = {state: command for command, state in COMMANDS.items()}


def test_autostart(sample_path: Path) -> None:
    bench = Bench(Dictionary.load(sample_path, ID), autostart=True)
    states: list[tuple[NmtState, NmtState]] = []
    bench.application.react(state_changed=lambda old, new, now, why: states.append((old, new)))
    assert bench.start() == ["720#00"]
    assert states == [
        (NmtState.INITIALISING, NmtState.PRE_OPERATIONAL),
        (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL),
    ]
    assert bench.nmt(129) == ["720#00"]
    assert bench.node.state is NmtState.OPERATIONAL


def test_autostart_is_the_default_of_1f80(sample_path: Path) -> None:
    bench = Bench(Dictionary.load(sample_path, ID), autostart=True)
    bench.start()
    assert bench.read(0x1F80) == 0
    assert bench.node.autostart
    assert bench.write(0x1F80, 0, 4, 4) == OK
    assert not bench.node.autostart
    bench.nmt(130)
    assert bench.read(0x1F80) == 0
    assert bench.node.state is NmtState.OPERATIONAL


def test_1f80_without_autostart(bench: Bench) -> None:
    assert bench.read(0x1F80) == 4
    assert bench.write(0x1F80, 0, 0, 4) == OK
    assert bench.node.autostart
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    bench.nmt(129)
    assert bench.node.state is NmtState.PRE_OPERATIONAL  # the default is back


@pytest.mark.parametrize("command", [129, 130])
def test_a_stored_1f80_starts_the_node(silent: Bench, command: int) -> None:
    entry = silent.dictionary.entry(0x1F80)
    entry.default = entry.value = 0
    assert silent.start() == ["720#00"]
    assert silent.node.state is NmtState.OPERATIONAL
    silent.nmt(128)
    assert silent.nmt(command) == ["720#00"]
    assert silent.node.state is NmtState.OPERATIONAL


@pytest.mark.parametrize("bit", sorted(set(range(32)) - {2}))
@pytest.mark.parametrize("more", [0, 4])
def test_bits_of_1f80_for_masters_are_refused(bench: Bench, bit: int, more: int) -> None:
    assert bench.write(0x1F80, 0, 1 << bit | more, 4) is AbortCode.INVALID_VALUE
    assert bench.read(0x1F80) == 4


@pytest.mark.parametrize("subindex", [1, 2])
@pytest.mark.parametrize("value", [0, 1, 2, 3, 255])
def test_the_error_behaviour_takes_0_to_2(bench: Bench, subindex: int, value: int) -> None:
    expected = OK if value <= 2 else AbortCode.INVALID_VALUE
    assert bench.write(0x1029, subindex, value, 1) == expected


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("addressed", [0, ID])
def test_every_command_in_every_state(bench: Bench, state: NmtState, command: int, addressed: int) -> None:
    bench.nmt(STATES[state])
    bench.application.calls.clear()
    assert bench.nmt(command, addressed) == []
    assert bench.node.state is COMMANDS[command]
    told = [] if COMMANDS[command] is state else [(state, COMMANDS[command], bench.now, "")]
    assert bench.application.told("state_changed") == told


def test_nothing_is_served_before_start(silent: Bench) -> None:
    assert silent.nmt(1) == []
    assert silent.sdo("40001000") == []
    assert silent.sync() == []
    assert silent.node.state is NmtState.INITIALISING
    assert silent.node.counters.unknown_cob_ids == 3


def test_reset_communication_keeps_the_application(bench: Bench) -> None:
    bench.dictionary.entry(0x2010, 7).value = 99
    bench.write(0x1006, 0, 5000, 4)
    seen: list[object] = []
    bench.application.react(
        reset_done=lambda only, now: seen.append((only, bench.dictionary.entry(0x1006).value))
    )
    bench.nmt(130)
    assert seen == [(True, 0)]
    assert bench.dictionary.entry(0x2010, 7).value == 99
    bench.nmt(129)
    assert seen == [(True, 0), (False, 0)]
    assert bench.dictionary.entry(0x2010, 7).value == -5


def test_start_keeps_what_was_set_before(silent: Bench) -> None:
    silent.dictionary.entry(0x2010, 7).value = 99
    silent.start()
    assert silent.application.told("reset_done") == [(False, silent.now)]
    assert silent.dictionary.entry(0x2010, 7).value == 99


def test_the_order_of_a_reset(bench: Bench) -> None:
    bench.operational()
    seen: list[object] = []
    bench.application.react(
        state_changed=lambda old, new, now, why: seen.append(new),
        reset_done=lambda only, now: seen.append("reset"),
    )
    bench.nmt(129)
    assert seen == [NmtState.INITIALISING, "reset", NmtState.PRE_OPERATIONAL]


def test_stopped_serves_only_nmt_and_heartbeat(bench: Bench) -> None:
    bench.write(0x1800, 5, 10, 2)
    bench.operational()
    bench.write(0x1017, 0, 100, 2)
    bench.run(0.0)
    bench.nmt(2)
    bench.node.trigger_tpdo(1, bench.now)
    bench.node.emergency(0x7300, 0x20, now=bench.now)
    assert bench.sdo("40001000") == []
    assert bench.sync() == []
    assert bench.send(0x190, "01000200") == []
    assert bench.dictionary.entry(0x2000, 1).value == 0
    assert [text for _, text in bench.run(0.35)] == ["720#04"] * 3
    assert bench.nmt(128) == ["0A0#0073210000000000"]
    assert bench.write(0x1017, 0, 0, 2) == OK


@pytest.mark.parametrize("node_id", [0, 128])
def test_node_id_range(silent: Bench, node_id: int) -> None:
    with pytest.raises(ValueError, match="1 to 127"):
        type(silent.node)(silent.dictionary, node_id)


def test_the_values_of_the_states() -> None:
    """CiA 301, 7.2.8.3.2."""
    assert [int(state) for state in NmtState] == [0, 4, 5, 127]
