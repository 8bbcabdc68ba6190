"""tools/suite/package.py: what it finds in an sdist and a wheel; and the README as an index shows it."""

from __future__ import annotations

import io
import re
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from tools.suite import package

ROOT = Path(__file__).parents[2]
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
    assert {"pyproject.toml", "src/canfb/__init__.py", "tests/tools/test_package.py"} <= names
    assert not [name for name in names if "__pycache__" in name]
