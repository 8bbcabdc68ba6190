"""The network behind canfb scope --demo: a module on a bus of its own, which answers as a module does."""

from __future__ import annotations

from canfb.bus.bus_master import BusMaster
from canfb.bus.frame_bus import PythonCanBus
from canfb.bus.opening import open_bus
from canfb.cia301 import cob
from canfb.hosting.trying import NODE, ScopeDemo

PATIENCE_S = 60.0


def test_it_sends_its_pdos_and_answers() -> None:
    with ScopeDemo() as demo, open_bus(demo.words) as bus:
        missing = {cob.SYNC, cob.TPDO1 + 0x10, cob.TPDO1 + NODE, cob.TPDO3 + NODE}
        while missing:
            message = bus.recv(PATIENCE_S)
            assert message is not None, f"not heard: {missing}"
            missing.discard(message.arbitration_id)
        with BusMaster(open_bus(demo.words), PATIENCE_S) as master:
            assert master.sdo(NODE).upload(0x1000, 0) == bytes.fromhex("96010400")
            assert master.sdo(NODE).upload(0x1A02, 1) == bytes.fromhex("20071120")  # velocity


def test_nothing_is_left_open() -> None:
    with ScopeDemo() as demo, ScopeDemo() as other:
        assert demo.words["channel"] != other.words["channel"]
        bus = demo._bus
    assert isinstance(bus, PythonCanBus)
    assert bus._bus._is_shutdown
    assert not demo._thread._thread.is_alive()
