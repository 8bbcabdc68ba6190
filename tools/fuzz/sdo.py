"""Fuzz the SDO server, and the whole node around it, guided by what code an input reaches.

    python -m tools.fuzz.sdo [CORPUS] [LIBFUZZER OPTIONS]       needs atheris: pip install 'atheris>=3.0'
    python -m tools.fuzz.sdo --show FILE...                     inputs as frames, and what comes of them

CORPUS is a folder that keeps the inputs that reached something new; without it they are forgotten. Useful
options: -max_total_time=600 (seconds), -runs=100000, -max_len=300 (bytes), -seed=1. The first input that
breaks a rule of body.py ends the run and is left in a file crash-...; `--show` tells its story.
"""

from __future__ import annotations

import sys
from pathlib import Path

MEGABYTES = 512
"""A device has no need for more; an input that makes it take more is a crash."""


def fuzz(arguments: list[str]) -> None:
    """Run until a crash, or as long as the options of libFuzzer say. Does not return."""
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is missing: python -m pip install 'atheris>=3.0'")
    import can  # noqa: F401  what is loaded before is not instrumented
    import canopen  # noqa: F401
    import numpy as np  # noqa: F401

    with atheris.instrument_imports(include=["canfb"], exclude=[*names("signal"), *names("calibration")]):
        from tools.fuzz import body

    def one(data: bytes) -> None:
        body.play(data)

    options = [f"-rss_limit_mb={MEGABYTES}", "-max_len=400", "-timeout=20"]
    atheris.Setup([sys.argv[0], *options, *arguments], one)
    atheris.Fuzz()


def names(part: str) -> list[str]:
    """The modules of a part of canfb that is no target: it runs faster when it is not instrumented."""
    source = Path(__file__).resolve().parents[2] / "src"
    files = (source / "canfb" / part).rglob("*.py")
    return [".".join(path.relative_to(source).with_suffix("").parts) for path in files]


def show(path: Path) -> None:
    """Tell what an input does, frame by frame. Raises what it raises."""
    from tools.fuzz import body
    from tools.fuzz.inputs import Reader, steps

    data = path.read_bytes()
    reader = Reader(data)
    print(f"{path}: {data.hex()}\ndevice {reader.byte()}")
    for step in steps(reader):
        for frame in step.frames:
            remote = " remote" if frame.rtr else ""
            print(f"  {frame.can_id:03X}#{frame.data.hex().upper()}{remote}")
        if step.follow:
            print(f"  a client goes on, {step.follow} rounds, and writes {len(step.content)} bytes")
        if step.pause_s:
            print(f"  {step.pause_s} s{' with ticks when they are due' if step.punctual else ''}")
    body.play(data)
    print("nothing is wrong")


def main(arguments: list[str]) -> None:
    """Fuzz, or show inputs."""
    if arguments[:1] == ["--show"]:
        for name in arguments[1:]:
            show(Path(name))
    elif arguments[:1] in (["-h"], ["--help"]):
        print(__doc__)
    else:
        fuzz(arguments)


if __name__ == "__main__":
    main(sys.argv[1:])
