"""The report of a reference measurement: one HTML file that stands alone."""

from __future__ import annotations

import math
from html import escape

from canfb.calibration.recording import BINS
from canfb.commissioning.active import NOTHING_ACTIVE, ActiveSet
from canfb.commissioning.procedure import Installation, Measurement
from canfb.commissioning.samples import Samples
from canfb.commissioning.summary import (
    Circumstances,
    comparison,
    coverage_warning,
    facts,
    origins,
    outcome,
    verdict,
)
from canfb.errors import CalibrationError
from canfb.report import pictures
from canfb.report.lissajous import is_dense, lissajous
from canfb.signal.supervision import SampleLimits

STYLE = """
:root { color-scheme: light dark; --ink: #1c2126; --soft: #5b656e; --paper: #ffffff; --panel: #f6f7f8;
  --rule: #d8dcdf; --before: #b5472f; --after: #14708c; --limit: #6d757c; --good: #1d6b3a; --bad: #a8261b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7e9; --soft: #a3acb3; --paper: #15181b;
  --panel: #1e2226; --rule: #3a4046; --before: #f0846a; --after: #5cc0dd; --limit: #9aa3aa; --good: #6fcf8e;
  --bad: #ff8a7d; } }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --panel: #fff;
  --rule: #bbb; --before: #b5472f; --after: #14708c; --limit: #666; --good: #1d6b3a; --bad: #a8261b; }
}
body { background: var(--paper); color: var(--ink); font: 15px/1.45 system-ui, "Segoe UI", Roboto, sans-serif;
  margin: 2em auto; max-width: 1120px; padding: 0 1.2em; }
h1 { font-size: 1.5em; margin: 0 0 .2em; }
h2 { font-size: 1.1em; margin: 1.6em 0 .5em; }
.where { color: var(--soft); margin: 0 0 1em; }
.verdict { border-left: 5px solid var(--good); background: var(--panel); padding: .7em 1em; margin: 0 0 .4em;
  font-size: 1.08em; }
.verdict.bad { border-color: var(--bad); }
.verdict p { margin: .15em 0; }
table { border-collapse: collapse; margin: 0 0 1em; }
th, td { text-align: left; padding: .28em 1.4em .28em 0; border-bottom: 1px solid var(--rule);
  vertical-align: top; }
td { font-variant-numeric: tabular-nums; }
.origin td { overflow-wrap: anywhere; }
.top table { width: 100%; } .top th, .top td { padding-right: .9em; }
.top thead + tbody td:nth-child(2) { white-space: nowrap; }
@media (max-width: 560px) { .top th, .top td, .top thead + tbody td:nth-child(2) { white-space: normal;
  overflow-wrap: anywhere; padding-right: .5em; } }
thead th { color: var(--soft); font-weight: 600; }
tbody th { font-weight: 500; white-space: nowrap; }
.pictures { display: grid; gap: 1.1em;
  grid-template-columns: repeat(auto-fit, minmax(min(430px, 100%), 1fr)); }
.top { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(430px, 100%), 1fr)); gap: 0 1.6em;
  align-items: start; }
.top figure { margin-top: 1.6em; }
figure { margin: 0; background: var(--panel); border: 1px solid var(--rule); border-radius: 6px;
  padding: .7em .8em .6em; }
figcaption { font-weight: 600; margin-bottom: .35em; }
figcaption small { display: block; font-weight: 400; color: var(--soft); }
svg { width: 100%; height: auto; display: block; }
svg text { fill: var(--soft); font-size: 12px; font-family: inherit; }
svg .label { fill: var(--ink); }
.mid { text-anchor: middle; } .end { text-anchor: end; }
.grid { stroke: var(--rule); stroke-width: .6; } .axis { fill: none; stroke: var(--soft); stroke-width: 1; }
.line { fill: none; stroke-width: 1.7; stroke-linejoin: round; }
.dots { fill: none; stroke-width: 2.6; stroke-linecap: round; stroke-opacity: .55; }
.line.before, .dots.before { stroke: var(--before); } .line.after, .dots.after { stroke: var(--after); }
.line.limit { stroke: var(--limit); stroke-width: 1.1; } .dashed { stroke-dasharray: 5 4; }
.bar { stroke: none; } .bar.before { fill: var(--before); } .bar.after { fill: var(--after); }
.legend { display: flex; flex-wrap: wrap; gap: .1em 1.3em; color: var(--soft); font-size: .87em;
  margin: .1em 0 0 3.6em; }
.legend span { display: inline-flex; align-items: center; gap: .45em; }
.legend i { display: inline-block; width: 20px; height: 0; border-top: 2px solid; }
.legend i.bar-key { height: 10px; width: 12px; border: 0; background: currentColor; }
.legend i.dot-key { height: 7px; width: 7px; border: 0; border-radius: 50%; background: currentColor; }
.legend i.dashed { border-top-style: dashed; }
i.before { color: var(--before); } i.after { color: var(--after); } i.limit { color: var(--limit); }
footer { color: var(--soft); font-size: .87em; margin: 2em 0; }
@media print { body { margin: 0; padding: 0; font-size: 11px; } figure { break-inside: avoid; }
  h2 { break-after: avoid; } .top, .pictures { grid-template-columns: 1fr 1fr; gap: .6em; }
  figure { padding: .4em; } .top figure { margin-top: .6em; } footer { margin: 1em 0 0; } }
"""


FOOTER = (
    "Made by canfb calibrate. Deviation: how far single samples are from smooth motion, noise included, on "
    "samples not used for the table that they are measured with."
)
ANGLES = " Angles (″) are those of the shaft."


def report_html(
    measured: Measurement, done: Installation, where: Circumstances, limits: SampleLimits | None = None
) -> str:
    """The page. It refers to nothing outside of itself and runs no script."""
    said = [verdict(measured), _sentence(outcome(measured, done, where))]
    return _page(
        where,
        said,
        f'<div class="top"><div>{_comparison(measured, done, where)}{_facts(measured, done, where)}</div>\n'
        f"{_lissajous(measured.samples, measured.found, limits)}</div>\n"
        f'<h2>Pictures</h2>\n<div class="pictures">\n{_pictures(measured, done)}</div>\n{_origins(where)}',
    )


def refusal_html(
    samples: Samples, refused: CalibrationError, where: Circumstances, limits: SampleLimits | None = None
) -> str:
    """The page of a measurement that was refused: why, and what the tracks look like."""
    said = [f"Refused: {refused}.", "Nothing was written to the module."]
    rows = [("samples", f"{len(samples)}; {samples.origin}"), ("missed", str(samples.missed))]
    return _page(
        where,
        said,
        f'<div class="top"><div>{_rows(rows)}</div>\n{_lissajous(samples, NOTHING_ACTIVE, limits)}</div>\n'
        f"{_origins(where)}",
        good=False,
    )


def _page(where: Circumstances, said: list[str], body: str, good: bool = True) -> str:
    title = f"Reference measurement{f', encoder {where.encoder}' if where.encoder else ''}"
    first, *others = (escape(line) for line in said)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f'<h1>{escape(title)}</h1>\n<p class="where">{escape(_place(where))}</p>\n'
        f'<div class="verdict{"" if good else " bad"}"><p><strong>{first}</strong></p>'
        f"{''.join(f'<p>{line}</p>' for line in others)}</div>\n"
        f"{body}<footer>{FOOTER}{ANGLES if where.cycles_per_revolution else ''}</footer>\n</body>\n</html>\n"
    )


def _place(where: Circumstances) -> str:
    words = [f"{where.date} {where.time}".strip()]
    if where.module is not None:
        words.append(f"module {where.module} ({where.module:02X}h)")
    if where.encoder_interface is not None:
        words.append(f"encoder interface {where.encoder_interface} ({where.encoder_interface:02X}h)")
    if where.cycles_per_revolution is not None:
        words.append(f"{where.cycles_per_revolution} cycles per revolution")
    return " · ".join(words)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _comparison(measured: Measurement, done: Installation, where: Circumstances) -> str:
    rows = "".join(
        f"<tr><th>{escape(row.name)}</th><td>{escape(row.before)}</td><td>{escape(row.after)}</td></tr>\n"
        for row in comparison(measured, done, where)
    )
    return (
        "<h2>Before and after</h2>\n<table><thead><tr><th></th><th>before</th><th>after</th></tr></thead>"
        f"<tbody>\n{rows}</tbody></table>\n"
    )


def _facts(measured: Measurement, done: Installation, where: Circumstances) -> str:
    return _rows(facts(measured, done, where))


def _origins(where: Circumstances) -> str:
    return _rows(origins(where), "Origin", "origin") if origins(where) else ""


def _rows(listed: list[tuple[str, str]], title: str = "Measurement", style: str = "") -> str:
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>\n" for name, text in listed)
    table = f'<table class="{style}">' if style else "<table>"
    return f"<h2>{title}</h2>\n{table}<tbody>\n{rows}</tbody></table>\n"


def _lissajous(samples: Samples, used: ActiveSet, limits: SampleLimits | None) -> str:
    picture = lissajous(samples.sine, samples.cosine, used.conditioning, limits)
    seen = len(samples) - samples.missed
    shown = f"all {seen} samples, darker where more fall" if is_dense(samples.sine) else f"{seen} samples"
    return _figure("Lissajous picture", f"should be a circle within the limits; {shown}", picture)


def _pictures(measured: Measurement, done: Installation) -> str:
    calibration, on_samples = measured.calibration, measured.on_samples
    before, after = on_samples.mean_over_phase(before=True), calibration.curve.after
    noise = 100.0 * calibration.residual_rms * math.sqrt(BINS / max(1, calibration.samples_used))
    shown, which = (
        (on_samples, "of the measurement") if done.fresh is None else (done.fresh, "taken after it")
    )
    curves = pictures.error_over_phase(before, after, "Mean error over the phase, before and after")
    left = pictures.remaining_error(after, calibration.uncertainty_peak)
    orders = pictures.harmonics(before, after, calibration.residual_rms, calibration.samples_used)
    listed = [
        (
            "Correction table",
            "phase less raw phase; Table 1 alone wants four waves of 1.1 %",
            pictures.table_curve(calibration.table, measured.before.table),
        ),
        (
            "Coverage",
            f"every phase must be met{coverage_warning(measured)}",
            pictures.coverage(on_samples.samples_over_phase()),
        ),
        ("Error over the phase", "mean in each 1/64 cycle, before and after", curves),
        ("What is left of it", f"on a scale of its own; noise alone gives {noise:.2g} % rms", left),
        ("Harmonics of the error", "1: offset; 2: gain and phase error; 4, 8, 12: Table 1 itself", orders),
        (
            "Deviation of single samples",
            f"{len(shown.error)} samples {which}",
            pictures.histogram(shown.error, shown.rms, calibration.noise_cycles),
        ),
    ]
    return "".join(_figure(name, text, svg) for name, text, svg in listed)


def _figure(name: str, text: str, svg: str) -> str:
    caption = f"<figcaption>{escape(name)}<small>{escape(text)}</small></figcaption>"
    return f"<figure>{caption}{svg}</figure>\n"
