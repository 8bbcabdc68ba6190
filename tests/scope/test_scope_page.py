"""One page, without a browser: what it has, and which task an answer begins."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.events import ButtonClick
from bokeh.models import Button, Div

from canfb.monitoring.lines import MachineUnits
from canfb.scope import desk as tasks
from canfb.scope.desk import Desk, MeasuredCurves, Stage, TaskResult, allowed_tasks
from canfb.scope.scope_page import LARGEST_FILE, LARGEST_MESSAGE, ScopePage, page_html, root_names
from canfb.scope.traces import BusTraces
from monitored_network import NODE, MonitoredNetwork

OTHER = NODE + 1


class OpenPage:
    def __init__(self, *, asks: bool = True, writes: bool = True, nodes: tuple[int, ...] = (NODE,)) -> None:
        self.begun: list[Any] = []
        self.desk = Desk(lambda *what: self.begun.append(what), allowed_tasks(asks=asks, writes=writes))
        self.document, traces = Document(), BusTraces()
        if nodes:
            network = MonitoredNetwork(nodes, known=nodes)
            network.run(0.2)
            traces.take(network.model.snapshot(network.bus.now))
        self.page = ScopePage(self.document, traces, self.desk, MachineUnits(), None)

    def all(self, kind: type) -> list[Any]:
        return list(self.document.select({"type": kind}))

    def press(self, label: str) -> None:
        (button,) = [one for one in self.all(Button) if one.label == label]
        button._trigger_event(ButtonClick(button))

    def choose(self, name: str, data: bytes) -> None:
        """As the browser reports it: these properties of a FileInput are for the browser alone."""
        self.page._choose_file("value", "", base64.b64encode(data).decode())
        self.page._choose_file("filename", "", name)

    def type(self, code: str) -> None:
        self.page._field.value = code

    def text_of_question(self) -> str:
        return str(self.page._texts["question"].text)

    def text(self, name: str) -> str:
        (found,) = [one for one in self.all(Div) if one.name == name]
        return str(found.text)


def labels(page: OpenPage) -> list[str]:
    return [one.label for one in page.all(Button)]


def test_a_page_that_only_listens_has_no_tasks() -> None:
    page = OpenPage(asks=False, writes=False)
    assert not {"Read table", "Calibrate", "Save"} & set(labels(page))
    page.page._pressed(tasks.SAVE)  # what a browser cannot ask for, asked all the same
    page.page._confirmed()
    page.page._pressed(tasks.READ)
    assert page.begun == []
    assert page.desk.state.stage is Stage.IDLE


def test_a_page_that_reads_begins_nothing_that_writes() -> None:
    page = OpenPage(writes=False)
    assert {"Read table", "Measure only"} <= set(labels(page))
    page.choose("table.bin", b"\0" * 64)
    for task in tasks.TASKS:
        if task.writes:
            page.page._pressed(task)
            page.page._confirmed()
    assert page.begun == []


def test_a_task_begins_after_its_answer() -> None:
    page = OpenPage()
    page.press("Save")
    assert page.begun == []
    page.press("No")
    page.page._confirmed()  # an answer to nothing
    assert page.begun == []
    page.press("Save")
    page.type(str(page.desk.code))
    page.press("Yes")
    assert page.begun == [(tasks.SAVE, NODE, None)]
    assert all(one.disabled for one in page.all(Button) if one.label in [task.label for task in tasks.TASKS])


def test_a_module_that_is_none_is_not_chosen() -> None:
    """A browser may send any value."""
    page = OpenPage(nodes=(NODE, OTHER))
    for value in ({"type": "ndarray"}, ["32"], None, "999"):
        page.page._choose("value", str(NODE), value)
    assert page.page._node == NODE


def test_the_answer_is_for_what_was_asked() -> None:
    """Another module and another file that are chosen between the question and the answer."""
    page = OpenPage(nodes=(NODE, OTHER))
    page.choose("one.bin", b"one")
    page.press("Upload table")
    assert f"Stage one.bin in module {NODE}" in page.text_of_question()
    page.choose("other.bin", b"other")
    page.page._choose("value", str(NODE), str(OTHER))
    page.type(page.desk.code.code.lower())
    page.press("Yes")
    ((task, node, upload),) = page.begun
    assert (task, node, upload.name, upload.data) == (tasks.UPLOAD, NODE, "one.bin", b"one")


def test_the_code_is_asked_for_once_in_a_page_and_never_shown() -> None:
    page = OpenPage()
    page.press("Save")
    assert page.page._field.visible
    for wrong in ("", "ABCD-EFGH"):
        page.type(wrong)
        page.press("Yes")
        assert "code that canfb scope has printed" in page.text_of_question()
        assert page.page._field.value == ""
    assert page.begun == []
    page.type(page.desk.code.code)
    page.press("Yes")
    assert len(page.begun) == 1
    assert page.page._field.value == ""
    page.desk.end(TaskResult(True, []))
    page.press("Activate")
    assert not page.page._field.visible
    page.press("Yes")
    assert len(page.begun) == 2
    assert page.desk.code.code not in str(page.document.to_json())


def test_what_reads_asks_for_no_code() -> None:
    page = OpenPage()
    page.press("Measure only")
    assert not page.page._field.visible
    page.press("Yes")
    assert page.begun == [(tasks.MEASURE, NODE, None)]


def test_a_file_that_is_no_table_is_not_taken() -> None:
    page = OpenPage()
    page.choose("large.bin", bytes(LARGEST_FILE + 1))
    page.press("Upload table")
    assert "this is no table file" in page.text_of_question()
    assert not page.page._yes.visible
    page.choose("small.bin", bytes(LARGEST_FILE))
    page.press("Upload table")
    assert "Stage small.bin" in page.text_of_question()
    assert 4 * LARGEST_FILE / 3 + 50_000 < LARGEST_MESSAGE  # in base64, in the words of Bokeh


@pytest.mark.parametrize(("asks", "writes"), [(False, False), (True, False), (True, True)])
def test_the_html_has_a_place_for_each_root_and_no_secret(asks: bool, writes: bool) -> None:
    page = OpenPage(asks=asks, writes=writes)
    html, names = page_html(page.desk), root_names(page.desk)
    assert [one.name for one in page.document.roots] == names
    assert all(html.count(f'id="root-{name}"') == 1 for name in names)
    assert html.count('id="root-') == len(names)
    assert page.desk.code.code not in html
    assert html == page_html(OpenPage(asks=asks, writes=writes).desk)  # for everybody, at each start


def test_limits_that_were_not_read_are_marked_and_dotted() -> None:
    page = OpenPage(writes=False)
    figures = page.page._figures
    assert "of assumed 0.333 cycle" in page.text("figures")
    assert "assumed 410 to 2560" in page.text("figures")
    assert (figures._dashes.glyph.line_dash, figures._circles.glyph.line_dash) == ([2, 4], "dotted")
    traces = page.page._traces
    module = traces.modules[NODE]
    assert module.module is not None
    module.module = replace(module.module, assumed=[], layout="module")
    page.page.update()
    assert "assumed" not in page.text("figures")
    assert (figures._dashes.glyph.line_dash, figures._circles.glyph.line_dash) == ([6], "dashed")


def test_a_file_name_is_text() -> None:
    page = OpenPage()
    page.choose("<img src=x onerror=alert(1)>.bin", b"x")
    page.press("Upload table")
    assert "&lt;img src=x onerror=alert(1)&gt;" in page.text_of_question()
    assert "<img" not in page.text_of_question()


def test_without_a_file_or_a_module_it_says_so() -> None:
    page = OpenPage()
    page.press("Upload table")
    assert "choose a table file first" in page.text_of_question()
    page.choose("table.bin", b"")
    for data in ("no base64!", "AAA\ufffd"):
        page.page._choose_file("value", "", data)
        page.press("Upload table")
        assert "choose a table file first" in page.text_of_question()
    empty = OpenPage(nodes=())
    empty.press("Calibrate")
    assert "no module is heard yet" in empty.text_of_question()
    assert page.begun == empty.begun == []


def test_a_measurement_is_drawn_before_and_after_and_in_words() -> None:
    page = OpenPage()
    page.press("Read table")
    curves = MeasuredCurves(np.linspace(-0.01, 0.01, 64), np.full(64, 1e-4))
    lines = ["          before  after", "deviation  1 %  0.1 %", "Accepted. <b>"]
    page.desk.end(TaskResult(True, lines, None, curves))
    page.page.update()
    figure = page.document.select_one({"name": "measured"})
    assert figure is not None
    drawn = page.page._figures._measured.data
    assert page.page._figures.measured.visible
    assert np.max(np.abs(drawn["before"])) == 1.0  # % of a cycle
    assert "done" in page.text("desk")
    assert page.text("outcome").startswith("<pre>          before  after\ndeviation")
    assert page.text("outcome").endswith("<p>Accepted. &lt;b&gt;</p>")
    page.press("Read table")
    assert not page.page._figures.measured.visible


def test_a_browser_that_chooses_a_module_that_there_is_not() -> None:
    page = OpenPage(nodes=(NODE, OTHER))
    for said in ("inf", "", str(NODE + 5)):
        page.page._choose("value", "", said)
        assert page.page._node == NODE
    page.page._choose("value", "", str(OTHER))
    assert page.page._node == OTHER
