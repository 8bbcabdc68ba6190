"""What the report says of where it comes from, and what its coverage lacks."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from test_calibrate_on_a_bus import calibrate

from canfb.calibrate.artefacts import refusal_html, report_html, write
from canfb.calibrate.calibration_summary import bound_words, facts, findings
from canfb.calibrate.measurement import Measurement
from canfb.calibrate.procedure import Installation
from canfb.calibration.deviation import Deviation
from canfb.errors import CalibrationError
from canfb.master.machine_watch import Provenance
from commissioning_kit import Bench

WHERE = Provenance(
    "2026-03-01",
    32,
    16,
    "X",
    2500,
    time="14:03:22+01:00",
    version="1.2.3",
    command="canfb calibrate -c can0 --encoder 'X & Y'",
    identity=(0, 1, 65536, 4711),
    interface_identity=(0, 2),
)


def test_the_report_says_when_with_what_and_how(measured: Measurement, tmp_path: Path) -> None:
    for page in (
        report_html(measured, Installation(), WHERE),
        refusal_html(measured.samples, CalibrationError("no", "ellipse"), WHERE),
    ):
        assert "2026-03-01 14:03:22+01:00" in page
        assert "canfb 1.2.3" in page
        assert "canfb calibrate -c can0 --encoder &#x27;X &amp; Y&#x27;" in page
        assert "32 (20h); vendor 0, product 1, revision 65536, serial number 4711 (1018h)" in page
        assert "16 (10h); vendor 0, product 2 (1018h)" in page
    figures = findings(measured, Installation(), WHERE).to_json()
    assert (figures["time"], figures["canfb"], figures["module_identity"]) == (
        "14:03:22+01:00",
        "1.2.3",
        [0, 1, 65536, 4711],
    )
    json.dumps(figures)
    write(tmp_path, measured, Installation(), WHERE)
    head = yaml.safe_load((tmp_path / "table.yaml").read_text())
    assert (head["date"], head["time"], head["canfb"]) == ("2026-03-01", "14:03:22+01:00", "1.2.3")
    assert head["module_identity"] == [0, 1, 65536, 4711]


def test_the_identities_are_read_from_the_nodes(capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(config={"serial_number": 77})
    calibrate(bench, "--dry-run", "--json")
    figures = json.loads(capsys.readouterr().out)
    assert figures["module_identity"] == [0, 1, 1, 77]
    assert figures["encoder_interface_identity"] == [0, 2, 1, 0]
    assert figures["date"] == "2026-03-01"
    assert figures["time"] is None


def deviation_at(phase: np.ndarray) -> Deviation:
    nothing = np.zeros(len(phase))
    return Deviation(1e-4, 1e-3, 1e-2, 2e-2, phase, nothing, nothing, 0)


def test_a_spike_of_the_coverage_is_said(measured: Measurement) -> None:
    rng = np.random.default_rng(2)
    even = rng.uniform(0, 1, 6400)
    assert deviation_at(even).spike is None
    assert deviation_at(even[:200]).spike is None, "chance"
    assert deviation_at(even[:0]).spike is None
    spiky = deviation_at(np.concatenate([even, np.full(400, 0.3)]))
    assert spiky.spike == (pytest.approx(5.0, rel=0.2), pytest.approx(0.3, abs=0.5 / 64))
    bad = replace(measured, on_samples=spiky)
    (words,) = next(row.words for row in facts(bad, Installation(), WHERE) if row.name == "coverage")
    assert re.search(r"; spiky: \d\.\d times the mean at phase 0\.30, another speed is better$", words)
    page = report_html(bad, Installation(), WHERE)
    assert "every phase must be covered; spiky: " in page
    assert findings(bad, Installation(), WHERE).to_json()["coverage_spike"] == pytest.approx(5.0, rel=0.2)
    assert "spiky" not in report_html(measured, Installation(), WHERE)


@pytest.mark.parametrize(
    ("ratio", "scatter", "words"),
    [
        (0.66, 0.3, "0.66 ± 0.20 times the Cramér-Rao bound: as small as these samples allow"),
        (1.3, 0.15, "1.30 ± 0.20 times the Cramér-Rao bound: as small as these samples allow"),
        (
            3.0,
            0.15,
            "3.00 ± 0.45 times the Cramér-Rao bound: more than the noise of the converter; motion or ",
        ),
    ],
)
def test_a_ratio_below_one_is_chance_and_one_far_above_is_not(
    measured: Measurement, ratio: float, scatter: float, words: str
) -> None:
    found = replace(measured.calibration, cramer_rao_ratio=ratio, cramer_rao_scatter=scatter)
    assert bound_words(found).startswith(words)
