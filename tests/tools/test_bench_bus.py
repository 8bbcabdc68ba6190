"""tools/bench/bus.py on very little work, its load against a module, and the picture of docs/latency.md."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

import canfb
from canfb.cia301.frame import Frame
from tools.bench import bus, bus_others
from tools.bench.bus_load import SDO_REQUEST, SdoClient, TransferFailed, set_up, tables
from tools.bench.bus_others import Times
from tools.bench.cycle import NODE_ID, encoder_table

ROOT = Path(__file__).parents[2]
ENTRIES = 100  # 400 bytes: 57 segments, two blocks of 31 down and one up, and a byte over
NODES = ["stock", "python-can", "canfb:alone", "floor"]


def test_each_node_answers_on_a_pair_of_sockets(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_others, "WARM_UP", 50)
    arguments = ["--cycles", "20", "--rounds", "1", "--rate", "100", "--loads", "full"]
    assert bus.main([*arguments, "--nodes", ",".join(NODES)]) == 0
    out, err = capsys.readouterr()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in out.splitlines()[2:-2]]
    assert [row[:3] for row in rows] == [["full", kind, "no"] for kind in NODES]
    for _, kind, _, _, _, from_sync, from_adc, _ in rows:
        assert (from_sync == "-") == (kind in ("stock", "canfb:alone")), "TPDO2"
        assert len(from_adc.split(" / ")) == 4
    assert err.splitlines() == [f"round 1 of 1: full, {kind}, no" for kind in NODES]


def test_each_percentile_is_a_value_that_so_many_do_not_exceed() -> None:
    assert bus.percentiles([float(n) for n in range(1000, 0, -1)]) == "500 / 990 / 999 / 1000"
    assert bus.percentiles([1.25, 1.25, 12.34, 5678.9]) == "1.2 / 5679 / 5679 / 5679"
    assert bus.percentiles([]) == "-"


def test_the_ratio_is_that_of_the_rounds() -> None:
    found = bus.Found(processor_us=[10.0, 30.0, 50.0])
    assert found.cells(bus.Found(processor_us=[20.0, 20.0, 20.0]))[:2] == ["30", "1.50"]
    assert found.cells(bus.Found(processor_us=[0.0, 0.0, 0.0]))[:2] == ["30", "nan"]


def test_a_position_that_comes_late_or_never_is_not_in_time() -> None:
    times = Times(
        sync_s={1: 1.0, 2: 1.01, 3: 1.02},
        adc_s={1: 1.001, 2: 1.011, 3: 1.021},
        at_once_s={1: 1.002, 2: 1.0215},
        with_sync_s={1: 1.0105, 3: 1.0305},
    )
    assert times.from_adc_us() == pytest.approx([1000.0, 10500.0])
    assert times.from_sync_us() == pytest.approx([500.0]), "the SYNC after the last sample is not known"
    assert times.not_in_time(0.01) == 2


class Module:
    """A module that is given requests, in simulated time."""

    def __init__(self) -> None:
        self.module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE_ID))
        self.module.start(0.0)
        self.now = 0.0

    def answers(self, request: bytes) -> Iterator[Frame]:
        self.now += 1e-4
        yield from self.module.receive(Frame(SDO_REQUEST, request), self.now)
        while (deadline := self.module.deadline()) is not None and deadline < self.now + 0.1:
            self.now = max(self.now, deadline)
            yield from self.module.tick(self.now)


def transfer(load: SdoClient, module: Module) -> None:
    while load.waits:
        can_id, request = load.frame
        assert can_id == SDO_REQUEST
        load.sent()
        for answer in module.answers(request):
            load.take(answer.can_id, answer.data)


def test_tables_are_transferred_and_in_force() -> None:
    load, module = SdoClient(tables(ENTRIES, rounds=2)), Module()
    transfer(load, module)
    assert module.module.dictionary.entry(0x2020, 5).value == ENTRIES
    assert module.module.dictionary.entry(0x2020, 4).value == encoder_table(ENTRIES, 0.001).crc32
    assert not load.waits


@pytest.mark.parametrize("alone", [False, True])
def test_a_module_is_set_up_with_a_table_and_without_tpdo_2(alone: bool) -> None:
    load, module = SdoClient(set_up(alone)), Module()
    transfer(load, module)
    assert load.done
    assert module.module.dictionary.entry(0x2020, 5).value == 256
    assert bool(module.module.dictionary.entry(0x1801, 1).value >> 31) is alone


def test_a_table_that_is_refused_is_no_load() -> None:
    load, module = SdoClient(tables(ENTRIES)), Module()
    module.module.dictionary.entry(0x2020, 1).access = "ro"
    with pytest.raises(TransferFailed, match="80 20 20 01"):
        transfer(load, module)


def test_the_table_of_the_load_corrects_table_1_of_the_paper() -> None:
    raw = canfb.phase_in_cycle(3.0, 4.0)
    assert encoder_table(4096, 0.0)(raw) == pytest.approx(0.10242, abs=2e-5)


@pytest.mark.parametrize(
    "wrong",
    [
        *(["--cycles", "0"], ["--rate", "0"], ["--rate", "nan"], ["--rounds", "0"]),
        *(["--loads", "heavy"], ["--nodes", "stock,other"]),
    ],
)
def test_wrong_use_is_told(wrong: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        bus.main(wrong)
    assert ended.value.code == 2


def test_an_interface_that_there_is_not_is_told() -> None:
    with pytest.raises(SystemExit, match="no interface nowhere0"):
        bus.main(["--channel", "nowhere0"])


def test_the_picture_names_the_objects_as_text() -> None:
    picture = ElementTree.parse(ROOT / "docs" / "latency.svg")
    texts = " ".join(text for node in picture.iter() if (text := node.text))
    for name in ("6004h", "6008h", "2011:07", "6030h", "6040h", "2011:02", "6300h", "EMCY", "predict"):
        assert name in texts
    assert "prefers-color-scheme: dark" in texts
