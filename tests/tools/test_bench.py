"""tools/bench: each piece of work does what it is compared for; the bus, its load and the picture."""

import re
from xml.etree import ElementTree

import pytest

import canfb
from canfb.cia301.frame import Frame
from canfb.simulation.embedded_bus import EmbeddedBus
from documentation import ROOT, page
from folding import each
from tools.bench import bus, bus_others, cycle
from tools.bench.bus_others import SdoClient, set_up
from tools.bench.cycle import NODE_ID

COMPARISON = cycle.Comparison("name", "ours", "other", 1.0)


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyperf has one in each process."""
    monkeypatch.setattr(cycle.pyperf.Runner, "_created", set())


@pytest.mark.parametrize("name", cycle.WORK)
def test_each_piece_of_work_checks_itself(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cycle, "SAMPLES", 1000)
    work = cycle.WORK[name].make()
    for _ in range(2):
        work()


def test_goals_are_those_of_the_page() -> None:
    shown = re.findall(r"^\| (cycle.*?) \| .*? \| < ([\d.]+): ", page("evidence"), re.MULTILINE)
    goals = {one.name: one.goal for one in cycle.comparisons() if one.name.startswith("cycle")}
    assert {name: float(goal) for name, goal in shown} == goals
    (arrays,) = re.findall(
        r"float64 .*goal ([\d.]+)\), int16 \S+ \(([\d.]+)\), .*\(([\d.]+):", page("evidence")
    )
    assert tuple(map(float, arrays)) == cycle.GOALS_AVX512
    assert {name for one in cycle.comparisons() for name in (one.ours, one.other)} == set(cycle.WORK)


@each("found, goals", [
    ({"found": ["X86_V3", "X86_V4"]}, cycle.GOALS_AVX512),
    ({"found": ["AVX2", "AVX512_SKX"]}, cycle.GOALS_AVX512),
    ({"found": ["X86_V3"], "not found": ["X86_V4"]}, cycle.GOALS_OTHER),
    ({}, cycle.GOALS_OTHER),
])  # fmt: skip
def test_the_goals_of_arrays_depend_on_avx512(
    found: dict[str, list[str]], goals: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cycle.np, "show_config", lambda mode: {"SIMD Extensions": found})
    assert cycle.array_goals() == goals


def test_the_command_prints_a_row_for_what_is_named(runner: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert cycle.main(["--only", "cycle, adapt", "--debug-single-value"]) == 0
    said = capsys.readouterr().out
    rows = [line for line in said.splitlines() if line.startswith("|")]
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| cycle, adapt"]
    assert "2002:08" in said


def test_wrong_use_is_refused(runner: None, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        cycle.main(["--only", "nothing"])
    assert error.value.code == 2
    assert "error:" in capsys.readouterr().err


@pytest.mark.parametrize(("ours", "status", "verdict"), [(0.99, 0, "met"), (1.0, 1, "MISSED")])
def test_check_reports_a_missed_goal_by_the_exit_status(
    ours: float, status: int, verdict: str, capsys: pytest.CaptureFixture[str]
) -> None:
    medians = {"ours": ours, "other": 1.0}
    assert cycle.report([COMPARISON], medians, check=True) == status
    assert cycle.report([COMPARISON], medians, check=False) == 0
    assert f"< 1: {verdict}" in capsys.readouterr().out


def test_each_node_answers_on_a_pair_of_sockets(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_others, "WARM_UP", 50)
    arguments = ["--cycles", "20", "--rounds", "1", "--rate", "100", "--loads", "full"]
    assert bus.main([*arguments, "--nodes", ",".join(bus.NODES)]) == 0
    out, err = capsys.readouterr()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in out.splitlines()[2:-2]]
    of_sync = [[*row[:3], row[5] == "-"] for row in rows]
    assert of_sync == [["full", kind, "no", kind == "stock"] for kind in bus.NODES], (
        "the stock node has no TPDO2"
    )
    assert all(len(row[6].split(" / ")) == 4 for row in rows)
    assert err.splitlines() == [f"round 1 of 1: full, {kind}, no" for kind in bus.NODES]


def test_each_percentile_is_a_value_that_so_many_do_not_exceed() -> None:
    assert bus.percentiles([float(n) for n in range(1000, 0, -1)]) == "500 / 990 / 999 / 1000"
    assert bus.percentiles([1.25, 1.25, 12.34, 5678.9]) == "1.2 / 5679 / 5679 / 5679"
    assert bus.percentiles([]) == "-"


def test_a_module_is_set_up_with_a_table() -> None:
    bus, load = EmbeddedBus(), SdoClient(set_up())
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE_ID))
    bus.attach(module)
    bus.observers.append(lambda frame, now: load.take(frame.can_id, frame.data))
    while load.frames:
        can_id, request = load.frames[0]
        load.sent()
        bus.send(Frame(can_id, request))
    assert load.done
    assert module.dictionary.entry(0x2020, 5).value == 256


@each("wrong", [
    *(["--cycles", "0"], ["--rate", "0"], ["--rate", "nan"], ["--rounds", "0"]),
    *(["--loads", "heavy"], ["--nodes", "floor,other"], ["--nodes", "floor", "--loads", "sdo"]),
])  # fmt: skip
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
