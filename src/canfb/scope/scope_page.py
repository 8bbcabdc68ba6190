"""One open page: a document of Bokeh, its texts, and the buttons of its tasks."""

from __future__ import annotations

import base64
from functools import partial
from html import escape
from importlib.resources import files
from typing import Any, NamedTuple

from bokeh.document import Document
from bokeh.models import Button, Column, Div, FileInput, InlineStyleSheet, Row, Select, TextInput, Toggle
from jinja2 import Environment

from canfb.errors import CanfbError
from canfb.monitoring.lines import MachineUnits
from canfb.scope import scope_texts as texts
from canfb.scope.desk import CALIBRATE, MEASURE, READ, Desk, DeskState, ScopeTask, Stage, Upload
from canfb.scope.gate import OPEN_ADDRESS
from canfb.scope.scope_figures import PICTURES, ScopeFigures
from canfb.scope.traces import BusTraces

TITLE = "canfb scope"
HERE = files("canfb.scope")
SCRIPT, STYLE = "scope.js", "scope.css"
BOKEH_SCRIPTS = ("static/js/bokeh.min.js", "static/js/bokeh-widgets.min.js")
FILES = ".yaml,.yml,.bin"
LARGEST_FILE = 300_000  # bytes: a table of 4096 entries has 60 000 in YAML
LARGEST_MESSAGE = 500_000  # bytes, of the browser: a file in base64; a larger one ends the connection
TEXTS = ("head", "bus", "figures", "counters", "emergencies", "note")
TASK_TEXTS = ("desk", "outcome")


def page_file(name: str) -> str:
    """A file of the page, of those beside this one."""
    return HERE.joinpath(name).read_text(encoding="utf-8")


def root_names(desk: Desk) -> list[str]:
    """Names of the parts of the page, in the order of the roots of its document."""
    tasks = (*TASK_TEXTS, "tasks", "measured") if desk.allowed else ()
    return [*TEXTS, *(one for one in PICTURES if one != "measured"), "dark", "select", *tasks]


def page_html(desk: Desk) -> str:
    """The page as everybody gets it, before a document fills it: no secret, no value. ``{nonce}`` is open."""
    page = Environment(autoescape=True).from_string(page_file("scope.html"))
    return page.render(
        title=TITLE,
        roots=root_names(desk),
        script=SCRIPT,
        style=STYLE,
        bokeh=BOKEH_SCRIPTS,
        tasks=bool(desk.allowed),
        largest_file=LARGEST_FILE,
        largest_message=LARGEST_MESSAGE,
        open_address=OPEN_ADDRESS,
    )


class _Asked(NamedTuple):
    """What the answer is for: a page that shows another module or file by then does not change it."""

    task: ScopeTask
    node: int
    upload: Upload | None


class ScopePage:
    """Fills ``document`` from the traces of the bus; :meth:`update` brings it up to date.

    ``node`` is the module that is shown first, None for the first that sends.
    """

    def __init__(
        self, document: Document, traces: BusTraces, desk: Desk, units: MachineUnits, node: int | None
    ) -> None:
        self._document, self._traces, self._desk, self._units = document, traces, desk, units
        self._node = node
        self._asked: _Asked | None = None
        style = InlineStyleSheet(css=page_file("parts.css"))
        self._style = InlineStyleSheet(css=page_file("controls.css"))
        self._texts = {
            name: Div(text="", margin=0, disable_math=True, sizing_mode="stretch_width", stylesheets=[style])
            for name in (*TEXTS, *TASK_TEXTS, "question")
        }
        self._figures = ScopeFigures(units)
        self._select = Select(options=[], visible=False, stylesheets=[self._style])
        self._select.on_change("value", self._choose)
        self._file = FileInput(
            accept=FILES, visible=any(task.takes_file for task in desk.allowed), stylesheets=[self._style]
        )
        self._chosen: dict[str, Any] = {"filename": "", "value": ""}
        for part in self._chosen:
            self._file.on_change(part, self._choose_file)
        self._buttons = {task: self._button(task) for task in desk.allowed}
        self._yes = Button(
            label="Yes", button_type="danger", visible=False, name="yes", stylesheets=[self._style]
        )
        self._no = Button(label="No", visible=False, name="no", stylesheets=[self._style])
        self._field = TextInput(
            title="code of the terminal in which canfb scope runs",
            name="code",
            visible=False,
            stylesheets=[self._style],
        )
        self._code = ""  # once it was right; a page has one websocket, and nobody else has this one
        self._yes.on_click(self._confirmed)
        self._no.on_click(partial(self._ask, None, ""))
        self._fill()

    def _button(self, task: ScopeTask) -> Button:
        kind = "primary" if task in (READ, MEASURE, CALIBRATE) else "default"
        button = Button(label=task.label, button_type=kind, name=task.label, stylesheets=[self._style])
        button.on_click(partial(self._pressed, task))
        return button

    def _fill(self) -> None:
        dark = Toggle(name="dark", label="dark", visible=False)
        dark.on_change("active", lambda name, old, new: self._dress(bool(new)))
        row = Row(*self._buttons.values(), sizing_mode="stretch_width", styles={"flex-wrap": "wrap"})
        asking = Row(self._yes, self._no)
        parts = (row, self._file, self._texts["question"], self._field, asking)
        tasks = Column(*parts, sizing_mode="stretch_width")
        roots = {**self._texts, **self._figures.roots, "dark": dark, "select": self._select, "tasks": tasks}
        for name in root_names(self._desk):
            roots[name].name = name
            self._document.add_root(roots[name])
        self._document.title = TITLE
        self._dress(False)
        self.update()

    def _dress(self, dark: bool) -> None:
        self._figures.dress(dark=dark)

    def _choose(self, name: str, old: Any, new: Any) -> None:
        self._node = {str(node): node for node in self._traces.modules}.get(str(new), self._node)
        self.update()

    def _choose_file(self, name: str, old: Any, new: Any) -> None:
        self._chosen[name] = new

    def update(self) -> None:
        """Show what there is now, in one message to the browser."""
        self._document.hold("combine")
        try:
            self._update()
        finally:
            self._document.unhold()

    def _update(self) -> None:
        say, traces = self._say, self._traces
        say("bus", texts.bus_line(traces.snapshot))
        self._update_desk(self._desk.state)
        nodes = sorted(traces.modules)
        if self._node not in nodes and nodes:
            self._node = nodes[0]
        if self._select.options != (options := [(str(node), f"node {node} ({node:02X}h)") for node in nodes]):
            self._select.update(options=options, value=str(self._node), visible=len(nodes) > 1)
        shown = traces.modules.get(self._node or 0)
        if shown is None or shown.module is None or shown.node is None or traces.snapshot is None:
            say("head", texts.NOT_HEARD)
            return
        say("head", texts.state_line(shown.node, shown.module))
        say("figures", texts.figures_table(shown.module, self._units))
        say("counters", texts.counters_table(shown.module))
        say("emergencies", texts.emergencies(shown.node))
        self._figures.show(shown, traces.snapshot.time_s)
        known = shown.correction is not None
        say("note", texts.deviation_note(shown.deviation(traces.snapshot.time_s), known=known))

    def _update_desk(self, state: DeskState) -> None:
        self._say("desk", texts.desk_text(state))
        self._say("outcome", texts.outcome_text(state))
        self._figures.show_measured(state.measured)
        for button in (*self._buttons.values(), self._yes):
            button.disabled = state.stage is Stage.RUNNING

    def _say(self, name: str, text: str) -> None:
        if self._texts[name].text != text:
            self._texts[name].text = text

    def _pressed(self, task: ScopeTask) -> None:
        upload = self._upload() if task.takes_file else None
        if upload is not None and len(upload.data) > LARGEST_FILE:
            self._ask(None, f"{upload.name} has more than {LARGEST_FILE} bytes: this is no table file")
        elif self._node is None:
            self._ask(None, "no module is heard yet")
        elif task.takes_file and upload is None:
            self._ask(None, "choose a table file first: what canfb calibrate or canfb table download wrote")
        elif task.question:
            asked = _Asked(task, self._node, upload)
            self._ask(asked, self._question(asked))
        else:
            self._begin(_Asked(task, self._node, upload))

    def _ask(self, asked: _Asked | None, question: str) -> None:
        self._asked = asked
        self._say("question", f"<p>{escape(question)}</p>" if question else "")
        self._yes.visible = self._no.visible = asked is not None
        self._field.visible = asked is not None and asked.task.writes and not self._code

    def _confirmed(self) -> None:
        asked, said = self._asked, self._field.value
        self._field.value = ""
        if asked is None:
            return
        if asked.task.writes and not self._code:
            if refusal := self._desk.code.refusal(said):
                self._ask(asked, f"{refusal}. {self._question(asked)}")
                return
            self._code = said
        self._ask(None, "")
        self._begin(asked)

    def _question(self, asked: _Asked) -> str:
        node, file = f"module {asked.node} ({asked.node:02X}h)", asked.upload.name if asked.upload else ""
        return asked.task.question.format(node=node, file=file)

    def _begin(self, asked: _Asked) -> None:
        try:
            self._desk.begin(asked.task, asked.node, asked.upload, self._code)
        except CanfbError as error:
            self._ask(None, str(error))
        self.update()

    def _upload(self) -> Upload | None:
        name, data = self._chosen["filename"], self._chosen["value"]
        if not isinstance(name, str) or not isinstance(data, str) or not name:
            return None
        try:
            return Upload(name, base64.b64decode(data, validate=True))
        except ValueError:  # binascii.Error, or characters beyond ASCII
            return None
