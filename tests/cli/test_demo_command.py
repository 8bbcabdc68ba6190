"""`canfb demo`: the same figures each time, pictures, and a clear word where there can be none."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from canfb.cli import demo
from canfb.cli.main import main
from canfb.demo.demo_pictures import fault_samples
from canfb.demo.story import FAULTS, LOST_SAMPLE, Story

PICTURES = ["tracks.png", "error-over-phase.png", "residual-over-time.png"]


class Run(NamedTuple):
    code: int
    figures: dict[str, Any]
    errors: str
    folder: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One run in a process of its own, as users do it, with pictures into a folder that is not there yet."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "pictures"
    done = subprocess.run(
        [sys.executable, "-m", "canfb", "demo", "--json", "--out", str(folder)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return Run(done.returncode, json.loads(done.stdout), done.stderr, folder)


def test_all_checks_held(run: Run) -> None:
    assert (run.code, run.errors) == (0, "")
    assert run.figures["held"] is True
    assert len(run.figures["checks"]) >= 11
    assert set(run.figures["checks"].values()) == {True}
    assert run.figures["wrong_cycle_counts"] == 0
    assert run.figures["faults_flagged_in_the_same_sample"] == run.figures["faults_provoked"] == 4


def test_it_tells_the_same_each_time(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--json"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    again = json.loads(said.out)
    assert again.pop("figures") == []
    assert again == {key: value for key, value in run.figures.items() if key != "figures"}


def test_three_pictures_are_written(run: Run) -> None:
    from matplotlib.image import imread

    assert run.figures["figures"] == [str(run.folder / name) for name in PICTURES]
    assert sorted(path.name for path in run.folder.iterdir()) == sorted(PICTURES)
    for name in PICTURES:
        data = (run.folder / name).read_bytes()
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        width, height = struct.unpack(">II", data[16:24])
        assert width >= 600
        assert height >= 400
        pixels = imread(run.folder / name)[..., :3].reshape(-1, 3)
        coloured = (pixels.max(axis=1) - pixels.min(axis=1) > 0.2).mean()
        assert 0.001 < coloured < 0.5, "something is drawn, and it is not all ink"


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the story may be told: what is wrong has to be found before."""

    def too_late() -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr(demo, "DemoNetwork", too_late)


@pytest.mark.usefixtures("no_work")
def test_without_matplotlib_it_says_so_before_the_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["demo", "--out", str(tmp_path / "pictures")]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == "canfb: figures need matplotlib: pip install 'canfb[plot]'\n"
    assert not (tmp_path / "pictures").exists()


def test_matplotlib_is_only_needed_for_pictures() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.modules['matplotlib'] = None\n"
            "from canfb.cli.main import main\n"
            "sys.exit(main(['config', 'example']) or main(['demo', '--out', '/nowhere/at/all']))",
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert done.stdout.startswith("# canfb run CONFIG.yaml")
    assert done.stderr == "canfb: figures need matplotlib: pip install 'canfb[plot]'\n"


@pytest.mark.usefixtures("no_work")
def test_a_folder_that_cannot_be_made_is_found_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a file"
    path.write_text("")
    assert main(["demo", "--out", str(path)]) == 1
    assert capsys.readouterr().err == f"canfb: cannot write figures to {path}: File exists\n"
    assert main(["demo", "--out", str(path / "below")]) == 1
    assert capsys.readouterr().err == f"canfb: cannot write figures to {path / 'below'}: Not a directory\n"


def test_a_story_that_does_not_hold_is_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    story = Story(checks={"it flies": False, "it floats": True})
    monkeypatch.setattr(demo, "tell", lambda network: story)
    monkeypatch.setattr(demo, "as_json", lambda told: {"held": told.held, "checks": told.checks})
    assert main(["demo", "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said == {"held": False, "checks": {"it flies": False, "it floats": True}, "figures": []}


def test_the_samples_that_are_labelled_are_those_of_the_faults() -> None:
    numbers = list(range(1000))
    numbers.remove(900 + LOST_SAMPLE)  # it is not in the log
    network: Any = SimpleNamespace(adc=SimpleNamespace(sine=numbers, cosine=[-n for n in numbers]))
    found = fault_samples(network, Story(fault_window=(900, 980)))
    assert found == [
        (name, 900 + place, -900 - place) for place, (name, _) in FAULTS.items() if place != LOST_SAMPLE
    ]
    assert len(found) == 3
