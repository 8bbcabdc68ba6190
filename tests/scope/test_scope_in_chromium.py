"""``canfb scope`` in a real browser: what it shows, and what it lets do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from canfb.scope.desk import ModuleTasks
from canfb.scope.scoping import READING
from canfb.signal.correction import CorrectionTable
from chromium import Chromium
from scope_running import Running

LOOPBACK = {"127.0.0.1"}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(tmp_path_factory.mktemp("chromium")) as browser:
        browser.size(1280, 900)
        yield browser


def opened(browser: Chromium, address: str) -> None:
    browser.go(address)
    browser.wait_for(lambda: browser.look("document.body.dataset.ready"), "page")


def value_of(browser: Chromium, name: str) -> str:
    rows = browser.texts("tr")
    return next((row.removeprefix(name) for row in rows if row.startswith(name)), "")


def test_the_page_lives_and_writes(
    browser: Chromium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from canfb.cli import scope_parts

    quick = partial(ModuleTasks, least_samples=1000, seconds=3.0)
    monkeypatch.setattr(scope_parts, "ModuleTasks", quick)
    running = Running(tmp_path, "--write")
    with running.started(monkeypatch) as address:
        opened(browser, address)
        assert browser.look("location.href") == address.partition("#")[0]
        browser.wait_for(lambda: "valid" in browser.texts(".state"), "valid position")
        assert_everything_is_drawn(browser)
        measure(browser, running)
        refuse_large(browser, tmp_path)
        upload(browser, running, tmp_path)
        assert {
            urlsplit(one).hostname for one in browser.addresses() if not one.startswith("data:")
        } == LOOPBACK
        assert browser.complaints() == []
        assert_no_text_is_cut(browser)
        assert_foreign_scripts_do_not_run(browser)
        assert_foreign_styles_do_nothing(browser)
        assert_only_loopback_is_bound(running)


def assert_everything_is_drawn(browser: Chromium) -> None:
    """Each picture has data, which change; so do the values."""
    first = value_of(browser, "position")
    browser.wait_for(lambda: value_of(browser, "position") != first, "motion")
    browser.wait_for(lambda: "% rms" in browser.text(), "deviation")
    assert value_of(browser, "velocity").endswith("rpm")
    browser.wait_for(lambda: value_of(browser, "missed").startswith("0"), "counters by SDO")
    for name in ("lissajous", "deviation", "residual", "position", "velocity"):
        filled = (
            f"Bokeh.documents[0].get_model_by_name('{name}').renderers.some(one => "
            "Object.values(one.data_source.data).some(column => column.length > 10))"
        )
        browser.wait_for(partial(browser.look, filled), f"data of {name}")
    limit = "Bokeh.documents[0].get_model_by_name('limit').data_source.data.limit[0]"
    browser.wait_for(lambda: abs(browser.look(limit) - 1 / 3) < 1e-3, "residual limit")


def measure(browser: Chromium, running: Running) -> None:
    """A reference measurement: its progress, its figures before and after, and nothing is written."""
    browser.wait_for(lambda: "Read table, module 32 (20h): done" in browser.texts(".state"), "table read")
    measured = "Bokeh.documents[0].get_model_by_name('measured')"
    assert not browser.look(f"{measured}.visible")
    browser.press("Measure only")
    browser.wait_for(lambda: "the machine must turn" in browser.text(), "question")
    browser.press("Yes")
    browser.wait_for(lambda: "collecting samples" in browser.text(), "step")
    browser.wait_for(lambda: browser.texts("progress"), "progress")
    browser.wait_for(lambda: "Measure only, module 32 (20h): done" in browser.texts(".state"), "measurement")
    assert "dry run: nothing was written to the module" in browser.text()
    (row,) = [line for line in browser.text().splitlines() if line.startswith("deviation, rms ")][:1]
    before, after = (float(word) for word in re.findall(r"([\d.e-]+) %", row))
    assert 0.5 < before < 2.0
    assert 0.0 < after < 0.1 * before
    browser.wait_for(lambda: browser.look(f"{measured}.visible"), "picture")
    assert browser.look(f"{measured}.renderers[0].data_source.data.before.length") == 64
    assert running.networks[0].module.dictionary.entry(0x2020, 2).value == 0
    assert running.networks[0].module.dictionary.entry(0x2020, 4).value == 0


def assert_foreign_scripts_do_not_run(browser: Chromium) -> None:
    """What gets into the page by a mistake of ours is text: no inline script, no eval, no other address."""
    browser.look(
        "(() => { const one = document.createElement('script'); one.textContent = 'window.inlined = 1';"
        "document.body.append(one); const other = document.createElement('script');"
        "other.src = 'http://localhost:9/x.js'; document.body.append(other);"
        "const button = document.createElement('p'); button.setAttribute('onclick', 'window.inlined = 2');"
        "document.body.append(button); button.click(); })()"
    )
    evaluated = "new Promise(done => { setTimeout('window.inlined = 3'); setTimeout(done, 0) })"
    browser.look(evaluated)
    assert browser.look("window.inlined === undefined")
    browser.wait_for(lambda: "Content Security Policy" in str(browser.complaints()), "violation")


def assert_only_loopback_is_bound(running: Running) -> None:
    bound = running.servers[0]._server._http._sockets.values()
    assert {one.getsockname()[0] for one in bound} == LOOPBACK


def upload(browser: Chromium, running: Running, folder: Path) -> None:
    """A table reaches the module: chosen, asked for, staged; then activated."""
    raw = np.arange(64) / 64
    table = CorrectionTable(raw + 0.002 * np.sin(2 * np.pi * raw))
    file = folder / "new <b>.bin"
    file.write_bytes(table.to_bytes())
    entry = running.networks[0].module.dictionary.entry
    browser.choose_file(file)

    def asked() -> bool:  # as soon as the browser has read the file
        browser.press("Upload table")
        return "Stage new <b>.bin in module 32" in browser.text()

    browser.wait_for(asked, "question")
    browser.press("Yes")
    browser.wait_for(lambda: "type the code" in browser.text(), "code")
    assert entry(0x2020, 2).value == 0  # nothing before the answer and its code
    browser.type_in("code of the terminal", running.code)
    browser.press("Yes")
    browser.wait_for(lambda: "Upload table, module 32 (20h): done" in browser.texts(".state"), "upload")
    assert entry(0x2020, 2).value == table.crc32
    browser.press("Activate")
    browser.wait_for(lambda: "Put the staged table" in browser.text(), "question")
    browser.press("Yes")
    browser.wait_for(lambda: "Activate, module 32 (20h): done" in browser.texts(".state"), "activation")
    assert entry(0x2020, 4).value == table.crc32


def refuse_large(browser: Chromium, folder: Path) -> None:
    """A file that is no table file is not sent; the connection holds."""
    large = folder / "large.bin"
    large.write_bytes(bytes(25_000_000))
    browser.choose_file(large)
    browser.wait_for(lambda: "large.bin has 25000000 bytes and was not sent" in browser.text(), "refusal")
    browser.press("Upload table")
    browser.wait_for(lambda: "choose a table file first" in browser.text(), "no file")
    assert browser.look("document.getElementById('lost').hidden")


def assert_foreign_styles_do_nothing(browser: Chromium) -> None:
    """Style elements and attributes that are not Bokeh's own."""
    browser.look(
        "document.body.insertAdjacentHTML('beforeend', \"<style>h1 { display: none; }</style>"
        "<p id='styled' style='display: none'>x</p>\")"
    )
    for one in ("h1", "#styled"):
        assert browser.look(f"getComputedStyle(document.querySelector('{one}')).display") == "block"


def assert_no_text_is_cut(browser: Chromium) -> None:
    """Neither on a desk nor on a phone the page is wider than its window."""
    for width in (1280, 390):
        for dark in (False, True):
            browser.size(width, 900, dark=dark)
            ink = "#e6edf3" if dark else "#1d2b33"
            axis = "Bokeh.documents[0].get_model_by_name('deviation').below[0]"
            inked = f"{axis}.axis_label_text_color === '{ink}'"
            browser.wait_for(partial(browser.look, inked), "colour of the axes")
            fits = f"document.documentElement.scrollWidth <= {width}"
            browser.wait_for(partial(browser.look, fits), "width")
    browser.size(1280, 900)


@pytest.mark.parametrize("options", [[], ["--sdo"]])
def test_without_write_there_is_nothing_to_press_that_writes(
    browser: Chromium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    running = Running(tmp_path, *options)
    with running.started(monkeypatch) as address:
        opened(browser, address)
        browser.wait_for(lambda: "valid" in browser.texts(".state"), "valid position")
        assert ("Tasks" in browser.texts("h2")) is bool(options)
        if options:
            browser.wait_for(lambda: "Read table, module 32 (20h): done" in browser.texts(".state"), "table")
            assert browser.buttons() == ["Read table", "Measure only"]
            heard = running.networks[0]._received
            assert heard is not None
            assert heard.data[0] >> 5 in READING
        else:
            assert browser.buttons() == []
            browser.wait_for(lambda: "(--sdo)" in browser.text(), "deviation")
            assert running.networks[0]._received is None  # nothing was sent
        assert browser.complaints() == []
        browser.go("about:blank")  # before the server goes, of which the page would complain
