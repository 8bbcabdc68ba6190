"""tools/suite: what package.py finds in an sdist and a wheel, what mutate.py changes and reports."""

import ast
import io
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from documentation import ROOT
from tools.suite import mutate, package

GOOD = {
    "LICENSE": b"MIT",
    "PKG-INFO": b"",
    "README.md": b"",
    "eds/module.eds": b"",
    "src/canfb/__init__.py": b"",
    "src/canfb/signal/phase.py": b"",
}
TRACKED = set(GOOD) - {"PKG-INFO"}


def sdist(folder: Path, members: dict[str, bytes]) -> Path:
    path = folder / "canfb-1.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(f"canfb-1/{name}")
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return path


def wheel(folder: Path, members: set[str], description: str = "Text.\n", licence: bool = True) -> Path:
    path = folder / "canfb-1-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name in members:
            archive.writestr(name, "")
        archive.writestr("canfb-1.dist-info/METADATA", f"Name: canfb\n\n{description}")
        if licence:
            archive.writestr("canfb-1.dist-info/licenses/LICENSE", "MIT")
    return path


def found(monkeypatch: pytest.MonkeyPatch, tracked: set[str] | None, *archives: Path) -> list[str]:
    monkeypatch.setattr(package, "sources", lambda: tracked)
    return list(package.check_archives(*archives))


def test_every_difference_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    members = GOOD | {"build/report.html": b"", "large.bin": bytes((1 << 20) + 1)}
    archives = (
        sdist(tmp_path, members),
        wheel(
            tmp_path, {"canfb/__init__.py", "canfb/eds/module.eds", "tests/x.py"}, "[a](docs/a.md)\n", False
        ),
    )
    assert found(monkeypatch, {*TRACKED, "large.bin", "tests/y.py"}, *archives) == [
        "sdist: tests/y.py is missing",
        "sdist: build/report.html does not belong there",
        "sdist: large.bin has 1048577 bytes, at most 1048576 are allowed",
        "wheel: canfb/signal/phase.py is missing",
        "wheel: tests/x.py does not belong there",
        "wheel: LICENSE is missing",
        "description: the link to docs/a.md leads nowhere on an index",
    ]
    assert "sdist: build" not in "".join(found(monkeypatch, None, *archives))


def test_the_readme_without_its_links_is_the_description() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    text = readme
    hook = project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    for one in hook["substitutions"]:
        text = re.sub(one["pattern"], one["replacement"], text)
    assert len(package.links_to_nowhere(readme)) > 10
    assert package.links_to_nowhere(text) == []
    assert "](" not in re.sub(r"\]\((https?:|#)", "", text)
    blocks = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
    assert blocks.findall(text) == blocks.findall(readme)


def test_the_sources_are_those_of_git() -> None:
    names = package.sources()
    if names is None:
        pytest.skip("not in a git working tree")
    assert {"pyproject.toml", "src/canfb/__init__.py", "tests/tools/test_suite.py"} <= names
    assert not [name for name in names if "__pycache__" in name]


KNOWN = ROOT / "tests" / "signal" / "known_survivors.txt"
MODULE = '''"""A docstring is not changed."""

LIMIT = 3


class Check:
    __slots__ = ("seen",)

    def over(self, value: int | None = None) -> bool:
        """Nor is this one."""
        self.seen = value
        return value is not None and value > LIMIT
'''
CHANGES = [
    "small : 3 -> 2",
    "small : 3 -> 4",
    "small : LIMIT = 3 -> pass",
    "small Check.over: return value is not None and value > LIMIT -> return None",
    "small Check.over: self.seen = value -> pass",
    "small Check.over: value > LIMIT -> value >= LIMIT",
    "small Check.over: value is not None -> value is None",
    "small Check.over: value is not None and value > LIMIT -> value is not None or value > LIMIT",
]


def changes_of(name: str, text: str) -> list[str]:
    return sorted(name for name, _, _ in mutate.named_changes(name, ast.parse(text)))


def test_every_place_is_changed_once_and_annotations_and_docstrings_are_not() -> None:
    assert changes_of("small", MODULE) == CHANGES


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A module of two changes, and tests that miss one of them: each change is a run of pytest."""
    module = "def over(value: int) -> bool:\n    return value > len('abc')\n"
    test = "from small import over\ndef test_it():\n    assert (over(2), over(4)) == (False, True)\n"
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "small.py").write_text(module)
    (tmp_path / "test_small.py").write_text(test)
    return tmp_path


def run(project: Path, *options: str) -> tuple[int, list[str]]:
    command = [sys.executable, "-m", "tools.suite.mutate", "src/small.py", *options, "--", "test_small.py"]
    done = subprocess.run(
        command,
        cwd=project,
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{project / 'src'}"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return done.returncode, done.stdout.splitlines()


def test_survivors_are_printed(project: Path) -> None:
    status, printed = run(project)
    missed = ["small over: value > len('abc') -> value >= len('abc')"]
    assert status == 1
    assert sorted(line.split(": ", 1)[1] for line in printed if line.startswith("src")) == missed
    assert printed[-1] == "2 changes, 1 survived, 1 of them not known to change nothing"


def test_a_file_that_no_change_would_reach_is_refused(project: Path) -> None:
    assert [run(project, wrong) for wrong in ("test_small.py", "src/none.py")] == [(2, []), (2, [])]


def test_each_known_survivor_is_a_change_and_has_a_reason() -> None:
    lines = [line.split("  # ") for line in KNOWN.read_text(encoding="utf-8").splitlines()]
    modules = {name.split(" ")[0] for name, _ in lines}
    paths = [path for path in (ROOT / "src" / "canfb" / "signal").rglob("*.py") if path.stem in modules]
    changes = {name for path in paths for name in changes_of(path.stem, path.read_text(encoding="utf-8"))}
    assert [name for name, _ in lines if name not in changes] == []
    assert all(reason for _, reason in lines)
    assert len({name for name, _ in lines}) == len(lines)
