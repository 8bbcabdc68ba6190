"""Build the sdist and the wheel, check both, and run the demo from the wheel in an environment of its own.

    python -m tools.suite.package [--out DIR]

The wheel is built from the sdist. Checks: metadata of both (twine); the sdist equals the files of git, and
the wheel src/canfb with the EDS files; the description has no broken link; in a new virtual environment, in
another folder, `canfb demo` passes with the versions that pip chooses.
Exit status 1, with one line for each finding, if anything is wrong.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from email.parser import Parser
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = "canfb"
# Files that the build creates.
SDIST_EXTRA = {"PKG-INFO"}
LARGEST_BYTES = 1 << 20
LINK = re.compile(r"!?\[[^\]]*\]\((?!https?:|#)([^)]*)\)")


class PackageError(Exception):
    """A step failed; the text is the whole message."""


def run(*command: str | Path, cwd: Path = ROOT) -> str:
    """Standard output of a command, run without the paths of this environment. PackageError if it fails."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        said = (done.stdout + done.stderr).strip().splitlines()[-20:]
        raise PackageError("\n".join([f"{Path(command[0]).name} {command[1]}: failed", *said]))
    return done.stdout


def sources() -> set[str] | None:
    """Files that git has or would add, without ignored ones; None outside a working tree."""
    if not (ROOT / ".git").exists():
        return None
    listed = run("git", "ls-files", "--cached", "--others", "--exclude-standard", "-z")
    return {name for name in listed.split("\0") if name and (ROOT / name).is_file()}


def differences(name: str, found: Iterable[str], expected: Iterable[str]) -> Iterator[str]:
    found, expected = set(found), set(expected)
    yield from (f"{name}: {member} is missing" for member in sorted(expected - found))
    yield from (f"{name}: {member} does not belong there" for member in sorted(found - expected))


def wheel_of(members: Iterable[str]) -> set[str]:
    """Expected files of the wheel, given these sources, without dist-info."""
    prefix = f"src/{PACKAGE}/"
    paths = [f"{PACKAGE}/{one.removeprefix(prefix)}" for one in members if one.startswith((prefix, "eds/"))]
    return set(paths)


def links_to_nowhere(description: str) -> list[str]:
    """Link targets that exist only in the repository: neither absolute, nor a heading of the page."""
    return LINK.findall(description)


def check_archives(sdist: Path, wheel: Path) -> Iterator[str]:
    with tarfile.open(sdist) as archive:  # all files are in one folder
        members = {one.name.partition("/")[2]: one.size for one in archive.getmembers() if one.isfile()}
    tracked = sources()
    if tracked is not None:
        yield from differences("sdist", set(members) - SDIST_EXTRA, tracked)
    for name, size in members.items():
        if size > LARGEST_BYTES:
            yield f"sdist: {name} has {size} bytes, at most {LARGEST_BYTES} are allowed"
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        info = [name for name in names if name.partition("/")[0].endswith(".dist-info")]
        (metadata,) = [name for name in info if name.endswith("/METADATA")]
        description = Parser().parsestr(archive.read(metadata).decode("utf-8")).get_payload()
    yield from differences("wheel", set(names) - set(info), wheel_of(members))
    if not any(name.endswith("/LICENSE") for name in info):
        yield "wheel: LICENSE is missing"
    for link in links_to_nowhere(str(description)):
        yield f"description: the link to {link} leads nowhere on an index"


def check_installed(wheel: Path, folder: Path) -> Iterator[str]:
    """Findings about the wheel, installed in a new environment in ``folder``."""
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    python, away = folder / "venv/bin/python", folder / "away"
    away.mkdir()
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", folder / "venv")
    run(*pip, "install", "--quiet", "--no-compile", wheel, cwd=away)
    run(*pip, "check", cwd=away)
    place = run(python, "-c", "import canfb; print(canfb.__file__)", cwd=away).strip()
    if not Path(place).is_relative_to(folder):
        yield f"installed: canfb comes from {place}"
    command = folder / "venv/bin/canfb"
    run(command, "--help", cwd=away)
    (away / "feedback.yaml").write_text(run(command, "config", "example", cwd=away), encoding="utf-8")
    run(command, "config", "check", "feedback.yaml", cwd=away)
    figures = json.loads(run(command, "demo", "--json", "--out", "pictures", cwd=away))
    if not (away / figures["report"]).is_file():
        yield "installed: canfb demo has written no report"


def package(out: Path) -> list[str]:
    """Build into ``out`` and check; the findings. PackageError if a step fails."""
    for old in out.glob(f"{PACKAGE}-*"):
        old.unlink()
    run(sys.executable, "-m", "build", "--outdir", out, ROOT)
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    print(f"{sdist.name}, {wheel.name}: built", flush=True)
    run(sys.executable, "-m", "twine", "check", "--strict", sdist, wheel)
    findings = list(check_archives(sdist, wheel))
    print("contents and description: checked", flush=True)
    with tempfile.TemporaryDirectory(prefix="canfb-package-") as folder:
        findings += check_installed(wheel.resolve(), Path(folder))
    print("installed in a new environment, canfb demo: done", flush=True)
    return findings


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.suite.package", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR", help="for both (dist)")
    options = parser.parse_args(arguments)
    try:
        findings = package(options.out)
    except PackageError as error:
        findings = [str(error)]
    for finding in findings:
        print(finding, file=sys.stderr)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
