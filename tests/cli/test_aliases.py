"""Old commands and options: the same as the new ones, and one line that says which."""

from __future__ import annotations

import pytest

from canfb.cli.aliases import current
from canfb.cli.commands import SUMMARIES
from canfb.cli.main import build_parser, main

LINES = {
    "dump 0x20 --log x.asc --pdo": "monitor --frames 0x20 --log x.asc --pdo",
    "--debug scope x.yaml": "--debug monitor --web x.yaml",
    "scope --demo": "try",
    "diagnose feedback.yaml --answer-within 2": "why --bundle feedback.yaml --timeout 2",
    "bus scan -c can0": "node list -c can0",
    "why 5 --answer-within=2": "why 5 --timeout=2",
    "nmt start all": "node start all",
    "nmt reset-comm 5": "node reset --communication 5",
    "reset 0x20 --force": "node reset 0x20 --force",
    "record bus.log": "log record bus.log",
    "replay bus.log --module 5": "log replay 5 bus.log",
    "interface adc.yaml": "run adc.yaml",
    "table upload 32 t.yaml": "table write 32 t.yaml",
    "table download 32 t.yaml": "table read 32 t.yaml",
    "backup 0x20 b.yaml": "backup save 0x20 b.yaml",
    "restore b.yaml --node=0x21": "backup restore 0x21 b.yaml",
    "calibrate f.yaml --module 0x20 --sync 100 --no-save": "calibrate 0x20 f.yaml --rate 100",
    "calibrate --samples a.csv --rate 1000": "calibrate --samples a.csv --sample-rate 1000",
    "calibrate --rate=1000 --samples=a.csv": "calibrate --sample-rate=1000 --samples=a.csv",
    "calibrate 5 --rate 1000": "calibrate 5 --rate 1000",
    "commission --module 5 --sync 100": "commission 5 --rate 100",
    "simulate f.yaml --module 33": "simulate 33 f.yaml",
    "config dcf --node 3": "config dcf 3",
    "monitor --rate 5": "monitor --updates 5",
    "try --no-scope": "try --no-page",
    "demo --json": "try --story --json",
}


@pytest.mark.parametrize("old", LINES)
def test_an_old_line_is_a_new_one(old: str) -> None:
    words, said = current(old.split())
    assert " ".join(words) == LINES[old]
    assert build_parser().parse_args(words).command in SUMMARIES
    assert not said or said.startswith("'canfb ")
    assert current(words) == (words, "")


def test_the_line_goes_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nmt", "fly"]) == 2
    assert capsys.readouterr().err.startswith("canfb: 'canfb nmt' is now 'canfb node'\n")
