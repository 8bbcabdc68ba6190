"""The demo's page, and its files in a folder."""

from __future__ import annotations

from pathlib import Path

from canfb.demo.account import TITLE, fault_facts, run_facts, servo_facts, verdict
from canfb.demo.demo_network import DemoNetwork
from canfb.demo.demo_pictures import error_after, error_before, residual, servo, tracks
from canfb.demo.story import Story, peak, rms
from canfb.errors import CanfbError
from canfb.report.page import beside, figure, gallery, page, svg_file, table
from canfb.report.plot import Plot
from canfb.rows import Row

REPORT = "report.html"
FOOTER = "Made by canfb demo: a simulation with fixed seeds; its figures are the same each time."
RESIDUAL = "Residual while faults are provoked"
SERVO = "A move of a servo"
TRACKS = "Encoder tracks"
BEFORE, AFTER = "Position error before the table", "Position error with the table"


def prepare(folder: Path) -> None:
    """Make ``folder``. CanfbError if it cannot be made: before the work starts."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CanfbError(f"cannot write figures to {folder}: {error.strerror}") from None


def write_files(
    network: DemoNetwork, story: Story, folder: Path, version: str, date: str
) -> tuple[list[Path], Path]:
    """Write the pictures and the page into ``folder``; their paths. CanfbError as :func:`prepare`.

    ``version`` of canfb and ``date`` are for the page: the same arguments give the same bytes.
    """
    prepare(folder)
    seen, before, after, faults = (
        tracks(network, story),
        error_before(story),
        error_after(story),
        residual(story),
    )
    moved = servo(story)
    files = {
        "tracks.svg": svg_file([(TRACKS, seen)]),
        "error-over-phase.svg": svg_file([(BEFORE, before), (AFTER, after)]),
        "residual-over-time.svg": svg_file([(RESIDUAL, faults)]),
        "servo-move.svg": svg_file([(SERVO, moved)]),
        REPORT: demo_page(story, f"canfb {version}, {date}", (seen, before, after, faults, moved)),
    }
    try:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise CanfbError(f"cannot write figures to {folder}: {error.strerror}") from None
    *pictures, report = (folder / name for name in files)
    return pictures, report


def demo_page(story: Story, made: str, pictures: tuple[Plot, Plot, Plot, Plot, Plot]) -> str:
    """The page: what the account says, with the pictures. ValueError if the demo has not run yet.

    made        by which version, and when
    pictures    tracks, error before and after the table, residual, the move of the servo
    """
    seen, before, after, faults, moved = pictures
    sizes = story.error_before, story.error_after
    rows = [
        Row(name, *(f"{100 * size(error):.4f}" for error in sizes))
        for name, size in (("peak", peak), ("rms", rms))
    ]
    tables = table("Position error, % of a cycle", rows, ("before the table", "with the table"))
    tables += table("Run", [*run_facts(story), *fault_facts(story)])
    act = table("A move of a servo", servo_facts(story))
    checks = table("Checks", [Row(name, verdict(held)) for name, held in story.checks.items()])
    finer = peak(story.error_before) / peak(story.error_after)
    return page(
        "canfb demo",
        f"{TITLE.partition(': ')[2]}; {made}",
        _said(story),
        beside(tables, figure(TRACKS, "the last samples; ideal tracks are a circle", seen.svg()))
        + gallery(
            "Error over the phase",
            [
                figure(BEFORE, "Table 1 and the errors of the encoder", before.svg()),
                figure(AFTER, f"noise of single 12-bit samples, scale {finer:.0f} times finer", after.svg()),
            ],
        )
        + beside(checks, figure(RESIDUAL, "at 2000 rpm; the limit is that of eq. 12", faults.svg()))
        + beside(act, figure(SERVO, "all samples; the limit is that of the known jerk", moved.svg())),
        FOOTER,
        story.held,
    )


def _said(story: Story) -> list[str]:
    failed = [name for name, held in story.checks.items() if not held]
    if failed:
        return [f"Failed: {', '.join(failed)}."]
    before, after = 100 * rms(story.error_before), 100 * rms(story.error_after)
    return [
        f"All checks passed. The position error falls from {before:.2g} % to {after:.2g} % of a cycle rms.",
        f"{story.samples} samples at {story.cycles_per_sample:.1f} cycles per sample, no wrong cycle count.",
    ]
