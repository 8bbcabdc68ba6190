"""The page of the monitor says what the snapshot holds; docs/monitor.md shows it."""

import dataclasses
import re
import struct

import pytest
from hypothesis import given, strategies as st
from rich.console import Console

from canfb.cia301.frame import Frame
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import NEEDED, assumed_layout
from canfb.monitoring.lines import MachineUnits, plain_lines
from canfb.monitoring.panels import Page, bar, dots, history
from canfb.monitoring.snapshot import BusSnapshot
from documentation import blocks, page
from folding import each
from monitored_network import MonitoredNetwork

SIZES = [(80, 24), (120, 40), (50, 24), (200, 60)]


@pytest.fixture(scope="module")
def good() -> BusSnapshot:
    network = MonitoredNetwork().run(3.0)
    return network.model.snapshot(network.bus.now)


@pytest.fixture(scope="module")
def lost() -> BusSnapshot:
    network = MonitoredNetwork().run(1.5)
    network.source.lost = True
    network.run(0.05)
    return network.model.snapshot(network.bus.now)


def printed(snapshot: BusSnapshot, size: tuple[int, int], plain: bool = False) -> list[str]:
    console = Console(width=size[0], height=size[1], color_system=None, force_terminal=True)
    with console.capture() as captured:
        console.print(Page(snapshot, MachineUnits(), "canfb monitor", plain=plain), height=size[1])
    lines = captured.get().rstrip("\n").splitlines()
    assert len(lines) <= size[1]
    assert max(map(len, lines)) <= size[0]
    return lines


@pytest.mark.parametrize("size", SIZES)
def test_a_good_module(good: BusSnapshot, lost: BusSnapshot, size: tuple[int, int]) -> None:
    assert printed(lost, size), "fits"
    text = "\n".join(printed(good, size))
    assert re.search(r"status +valid", text)
    assert "node 32 (20h)  OPERATIONAL" in text
    ((_, module),) = good.modules
    assert f"{module.position_revolutions:.5f} rev" in text
    speed = re.search(r"velocity +([0-9.]+) rpm", text)
    assert speed
    assert float(speed[1]) == pytest.approx(63.7, rel=2e-3)
    assert f"{module.residual_cycles:.3f} of assumed 0.333 cycle" in text
    assert re.search(r"SYNC +1000 Hz, jitter", text)
    assert "1000 kbit/s" in text
    assert re.search(r"EMCY +none", text)
    assert re.search(r"faults +none seen", text)
    assert ("⠀" in text) == (size[0] >= 80), "the tracks, where there is room"


@pytest.mark.parametrize("size", SIZES[:2])
def test_a_lost_position_says_why_and_since_when(lost: BusSnapshot, size: tuple[int, int]) -> None:
    text = "\n".join(printed(lost, size))
    assert re.search(r"status +lost, sample missed", text)
    assert re.search(r"why +canfb why 0x20: more samples in a row were ", text)
    assert re.search(r"faults +0\.0 s ago: missed [0-9]+.*lost 1", text)
    assert re.search(r"EMCY +7300h sensor: position not valid, 0\.0 s ago", text)
    plain = "\n".join(printed(lost, size, plain=True)).replace("µ", "u")
    assert plain.isascii()
    assert "*" in plain


def test_old_figures_are_not_shown_as_present(good: BusSnapshot) -> None:
    ((node, module),) = good.modules
    old = dataclasses.replace(node, module=dataclasses.replace(module, age_s=12.0))
    text = "\n".join(printed(dataclasses.replace(good, nodes=[old]), (80, 24)))
    assert re.search(r"status +no data for 12\.0 s", text)
    assert "valid" not in text


def test_many_modules_are_a_table_with_what_is_wrong() -> None:
    network = MonitoredNetwork((0x20, 0x21, 0x22, 0x23), known=(0x20, 0x21, 0x22, 0x23, 0x40)).run(1.2)
    network.source.lost = True
    network.run(0.02)
    snapshot = network.model.snapshot(network.bus.now)
    lines = printed(snapshot, (80, 24))
    rows = [line for line in lines if re.match(r" +(32|33|34|35|64) ", line)]
    assert len(rows) == 5
    assert all("OPERATIONAL" in row and "lost" in row for row in rows[:4])
    assert re.search("not heard +no module PDO", rows[4])
    assert sum("7300h sensor: position not valid" in line for line in lines) >= 4
    small = printed(snapshot, (80, 8))
    assert any("more: make the window higher" in line for line in small)
    assert "".join(lines).count("assumed where they were not read") == 1


def test_an_empty_bus_says_what_to_do() -> None:
    model = BusModel()
    assert any("no frame" in line for line in printed(model.snapshot(), (80, 24)))
    for k in range(100):
        model.receive(Frame(0x444, b""), k * 0.01)
    assert any("canfb monitor NODE" in line for line in printed(model.snapshot(), (80, 24)))


def test_plain_lines_say_the_same(good: BusSnapshot, lost: BusSnapshot) -> None:
    (line,) = plain_lines(good, MachineUnits(5.0, "mm"))
    assert re.match(
        r"3\.000 node 32 \(20h\): OPERATIONAL \(by PDO\), status valid, "
        r"position [0-9.]+ mm  [0-9]+ units \(scale assumed\), "
        r"velocity 5\.3[0-9]+ mm/s \(scale assumed\), ",
        line,
    )
    (line,) = plain_lines(lost, MachineUnits())
    why = "canfb why 0x20: more samples in a row were bad or missing than 2010:03 allows"
    assert "lost, sample missed" in line
    assert why in line
    ((_, module),) = lost.modules
    assert module.lost_by == "more samples in a row were bad or missing than 2010:03 allows"
    assert all(one.lost_by is None for _, one in good.modules)
    assert "EMCY 7300h sensor: position not valid" in line


def test_what_was_read_is_not_marked(good: BusSnapshot) -> None:
    """In each output; what was not is, by the name that the JSON has."""
    ((node, module),) = good.modules
    for assumed in ([], *([name] for name in NEEDED)):
        shown = dataclasses.replace(module, layout="module", assumed=assumed)
        snapshot = dataclasses.replace(good, nodes=[dataclasses.replace(node, module=shown)])
        text, (line,) = "\n".join(printed(snapshot, (132, 43))), plain_lines(snapshot, MachineUnits())
        marks = assumed not in ([], ["full_scale_counts"])
        assert text.count("assumed") == line.count("assumed") == marks
        assert snapshot.to_json()["nodes"][0]["module"]["assumed"] == assumed


@given(
    st.lists(
        st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 0xFFFF), st.integers(0, 0xFFFF)), max_size=10
    ),
    st.sampled_from([(20, 7), (40, 12), (80, 24), (132, 43)]),
)
def test_whatever_comes_is_printed(values: list[tuple[int, int, int]], size: tuple[int, int]) -> None:
    model = BusModel([assumed_layout(32), assumed_layout(5)])
    for k, given_ in enumerate(values):
        model.receive(Frame(0x1A0, struct.pack("<IHH", *given_)), k * 0.1)
        model.receive(Frame(0x190, struct.pack("<HH", *given_[1:])), k * 0.1)
    assert printed(model.snapshot(), size)


@given(st.floats(allow_nan=True), st.integers(0, 50))
def test_a_bar_has_its_width(part: float, width: int) -> None:
    assert len(bar(part, width)) == width


def test_drawings() -> None:
    assert bar(0.5, 4, plain=True) == "##.."
    assert bar(0.01, 4, plain=True) == "#...", "not nothing"
    assert bar(7.0, 4, plain=True) == "####"
    assert history([0.0, None, 0.5, 1.0, 2.0], 1.0, 6) == " ▁ ▅██"
    assert dots([(-1.0, 1.0)], 1.0, 2, 1) == ["⠁⠀"]
    assert dots([(1.0, -1.0)], 1.0, 2, 2) == ["⠀⠀", "⠀⢀"]
    assert dots([(0.0, 0.0)], 0.0, 3, 1, plain=True) == [" * "]


@each("text, units", [("5 mm", (5.0, "mm")), ("-360deg", (-360.0, "deg")), ("1e3 µm", (1e3, "µm"))])
def test_units(text: str, units: tuple[float, str]) -> None:
    assert dataclasses.astuple(MachineUnits.parse(text)) == units
    for wrong in ("", "mm", "5", "0 mm", "nan mm", "1e999 mm", "5 mm 6", ". mm", "1.2.3 mm"):
        with pytest.raises(ValueError, match="not a distance per revolution"):
            MachineUnits.parse(wrong)


PAGE = page("monitor")


def without_figures(text: str) -> str:
    """Lines without what depends on the moment: figures, bars, dots."""
    return "\n".join(
        re.sub(r"[0-9.]+|[\u2581-\u2593\u2800-\u28ff]+|\s+", " ", line).strip() for line in text.splitlines()
    )


def test_the_page_is_that_of_the_program() -> None:
    network = MonitoredNetwork(jitter_us=20.0).run(2.0)
    network.source.lost = True
    network.run(0.0035)
    network.source.lost = False
    network.run(1.0)
    shown = blocks(PAGE, "text")[0]
    real = "\n".join(printed(network.model.snapshot(network.bus.now), (80, 24)))
    assert re.sub(r" +", " ", without_figures(shown)) == re.sub(r" +", " ", without_figures(real))


def test_the_program_runs(capsys: pytest.CaptureFixture[str]) -> None:
    program = blocks(PAGE, "python")[0]
    exec(compile(program, "monitor.md", "exec"), {})
    assert capsys.readouterr().out == "OPERATIONAL valid 0.008636474609375\n"
