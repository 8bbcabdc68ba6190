"""Reading by SDO against the server of a real module: requests out, answers in, nobody waits."""

from __future__ import annotations

import struct
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

import canfb
from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.monitoring.layout import SETTINGS, Origin, layout_of
from canfb.monitoring.sdo_reading import ANSWER_S, MOST_UNANSWERED, QUIET_S, REPEATED, SdoReading
from canfb.objects import Multiplexer
from canfb.view.pdo_map import Number

NODE = 0x20


def exchange(
    reading: SdoReading, module: canfb.FeedbackModule, begin: float, seconds: float
) -> dict[Multiplexer, Number]:
    """So long with the module at the other end."""
    values: dict[Multiplexer, Number] = {}
    for k in range(round(seconds * 1000)):
        now = begin + k * 1e-3
        request = reading.next(now)
        if request is not None:
            for answer in module.receive(request, now):
                values.update(reading.receive(answer))
    return values


def test_mapping_and_counters_are_those_of_the_module() -> None:
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE, cycles_per_revolution=1024, adc_bits=14))
    module.start(0.0)
    module.dictionary.entry(*od.COUNTER_MISSED).value = 7
    reading = SdoReading(NODE)
    assert not reading.complete
    values = exchange(reading, module, 0.0, 0.5)
    assert reading.complete
    assert set(reading.settings) == set(SETTINGS)
    assert values[od.COUNTER_MISSED] == 7
    assert set(values) == set(REPEATED)
    layout = layout_of(NODE, reading.settings.get, Origin.MODULE)
    assert layout.cycles_per_revolution == 1024
    assert layout.full_scale_counts == 8192
    assert [pdo.can_id for pdo in layout.tpdos] == [0x180 + NODE]
    assert [place for place, _, _ in layout.tpdos[0].places] == [
        od.POSITION_VALUE,
        od.FEEDBACK_STATUS,
        od.FEEDBACK_RESIDUAL,
    ]
    assert [pdo.can_id for pdo in layout.inputs] == [0x190]
    module.dictionary.entry(*od.COUNTER_MISSED).value = 9
    assert exchange(reading, module, 1.0, 1.5)[od.COUNTER_MISSED] == 9, "and again every second"


def test_a_node_that_does_not_answer_is_left_alone() -> None:
    reading = SdoReading(NODE)
    sent = [now for k in range(20_000) if reading.next(now := k * 1e-3) is not None]
    assert len(sent) <= 20.0 / (QUIET_S + MOST_UNANSWERED * ANSWER_S) * MOST_UNANSWERED + MOST_UNANSWERED
    assert min(after - before for before, after in pairwise(sent)) >= ANSWER_S
    assert not reading.complete
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE))
    module.start(0.0)
    exchange(reading, module, 20.0, QUIET_S + 1.0)
    assert reading.complete, "it is asked again"


def test_only_uploads_are_sent() -> None:
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE))
    module.start(0.0)
    reading = SdoReading(NODE)
    for k in range(400):
        request = reading.next(k * 1e-3)
        if request is not None:
            assert request.can_id == 0x600 + NODE
            assert request.data[0] == 0x40
            for answer in module.receive(request, k * 1e-3):
                reading.receive(answer)


@given(st.lists(st.tuples(st.sampled_from([0x580 + NODE, 0x581, 0x1A0]), st.binary(max_size=8))))
def test_no_answer_raises(frames: list[tuple[int, bytes]]) -> None:
    reading = SdoReading(NODE)
    for k, (can_id, data) in enumerate(frames):
        request = reading.next(k * 1e-3)
        reading.receive(Frame(can_id, data))
        if request is not None:  # the right place, with whatever is in it
            reading.receive(
                Frame(0x580 + NODE, data[:1].ljust(1, b"\x43") + request.data[1:4] + data[:4].ljust(4))
            )


def test_the_answer_to_another_master_is_not_taken() -> None:
    reading = SdoReading(NODE)
    assert reading.next(0.0) is not None
    assert reading.receive(Frame(0x580 + NODE, struct.pack("<BHBI", 0x43, 0x2012, 1, 5))) == {}
    assert reading.next(ANSWER_S / 2) is None, "its own request still waits"
