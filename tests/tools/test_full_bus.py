"""tools/bench/full_bus.py for some cycles, and with a bus that loses a frame."""

from __future__ import annotations

import pytest

from tools.bench import full_bus


def test_nothing_is_lost_on_a_full_bus(capsys: pytest.CaptureFixture[str]) -> None:
    assert full_bus.main(["--cycles", "3000"]) == 0
    out = capsys.readouterr().out
    assert "3000 cycles of 285 us, 3509 Hz; 3000 samples" in out
    assert "3000 positions, 0 not valid" in out


def test_a_lost_frame_is_not_hidden(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    receive = full_bus.FullBus.receive

    def deaf(bus: full_bus.FullBus, wait_s: float) -> object:
        frames = receive(bus, wait_s)
        return receive(bus, wait_s) if bus._cycle == 500 and frames and frames[0][0] != 0x80 else frames

    monkeypatch.setattr(full_bus.FullBus, "receive", deaf)
    assert full_bus.main(["--cycles", "1000"]) == 1
    assert "missed 1," in capsys.readouterr().out
