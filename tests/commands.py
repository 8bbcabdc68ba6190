"""Commands of canfb in this process, the files that they are given, and what they say."""

import json
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from canfb.cli.main import main


def yaml_file(folder: Path, text: str, name: str = "feedback.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


class Said(NamedTuple):
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.out.splitlines()

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    @property
    def objects(self) -> list[Any]:
        """JSON, one in each line."""
        return [json.loads(line) for line in self.lines]


class Command:
    """`canfb LINE WORD...`: the line is split as a shell does it, the other words are taken as they are."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def read(self) -> Said:
        """What was said since the last time; it stays in ``said``."""
        self.said = Said(*self._capsys.readouterr())
        return self.said

    def __call__(self, line: str, *words: object, code: int = 0) -> Said:
        self.read()
        found = main([*shlex.split(line), *map(str, words)])
        assert found == code, self.read()
        return self.read()
