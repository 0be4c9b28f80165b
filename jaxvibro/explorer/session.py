"""Hold the state of one page and apply its messages, independently of the server."""

from collections.abc import Callable, Sequence
from functools import singledispatchmethod
from typing import Any

import numpy as np

from ..branches.curves import VARIABLES
from ..flight.wall_positions import clamp_to_walls
from ..orbits.orbit import Orbit, OrbitError
from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from ..studies import scene_file
from ..studies.schema import SceneFile, ViewTable
from ..studies.text_limits import MAX_BYTES
from . import actions, descriptions, messages, page_state, screen
from .background_tasks import BackgroundTasks, Schedule, progress_text
from .calls import SCENE_NAME, evaluate, resolve
from .error_records import error_record
from .nearest_point import nearest_point
from .page_state import PageState
from .page_text import live_fields, static_fields
from .panels import Limits, Panel, Size
from .replay import replay_lines, restore_page

MAX_UNDO = 200  # steps of undo
DRAG_PERIODS = 16  # drive periods shown while a slider moves

Send = Callable[[dict[str, Any]], object]
Wait = Callable[[], object]


class Session:
    """State of one page; one thread calls its methods.

    Parameters
    ----------
    file : SceneFile or None
        Scene file, whose tables select the first results. None if the scene cannot be written as text.
    scene : Scene
        Scene of the page.
    send : callable
        Function that sends a record to the page, from any thread.
    schedule : callable
        Function that runs a callback in the thread of this session.
    wait : callable, optional
        Function that is called after the first fields are sent and before the first computation.
    """

    def __init__(
        self, file: SceneFile | None, scene: Scene, send: Send, schedule: Schedule, wait: Wait = lambda: None
    ) -> None:
        self.send, self.schedule, self.wait, self.screen, self.connected = send, schedule, wait, screen.Screen(), False
        self._open(file, scene)

    def _open(self, file: SceneFile | None, scene: Scene) -> None:
        """Start with a scene."""
        self.file = file
        self.results: dict[str, Any] = {SCENE_NAME: scene}
        self.name_counters = {"scene": 2}  # next number of each name stem
        self.history: list[PageState] = []
        # Page and names at the start of a slider motion.
        self.drag_start: tuple[PageState, tuple[str, str, str]] | None = None
        self.page = page_state.first_page(scene, file)
        self.screen.invalidate()
        self.tasks = BackgroundTasks(self._send_progress, self.schedule, bool(scene.dtype == np.float64))
        self.sent_fields: dict[str, Any] = {}  # fields that the page has
        self.static_page: PageState | None = None  # page whose static fields were sent

    def _end_replay(self, results: dict[str, Any] | None, error: Exception | None) -> None:
        """Show the results of the [[view]] tables of the file."""
        if results is None or self.file is None:
            self._finish_action(error)
            return
        for line in self.file.view:
            stem, _, number = line.name.rpartition("_")
            if int(number) >= self.name_counters.get(stem, 1):
                self.name_counters[stem] = int(number) + 1
        self.results = results
        self._show(restore_page(self.page, self.file.view, results))
        self.history.clear()
        self.update_page()

    def close(self) -> None:
        """Stop all tasks, because the page is closed or requests it."""
        self.tasks.stop()

    def receive(self, message: messages.PageMessage) -> None:
        """Apply a message and update the page; an error is sent as one line."""
        self.connected |= not isinstance(message, messages.Resize)
        try:
            if self.drag_start is not None and not isinstance(message, messages.SetParameter | messages.Resize):
                self._end_drag()
            self._handle(message)
        except Exception as error:  # answer the page after any error
            self._send_error(error)
        self.update_page()
        self.send({"kind": "answer", "number": message.number})

    @singledispatchmethod
    def _handle(self, message: Any) -> None:
        raise ArgumentError("message", "must be a known message", type(message).__name__)

    @_handle.register
    def _(self, message: messages.Hello) -> None:
        if message.text:
            self._handle(messages.Load(text=message.text))
        else:
            self._run_first_actions()

    @_handle.register
    def _(self, message: messages.Resize) -> None:
        size = Size(message.width, message.height, message.ratio)
        if message.panel not in self.screen.panels or self.screen.panels[message.panel].size != size:
            self.screen.panels[message.panel] = Panel(size)

    @_handle.register
    def _(self, message: messages.Zoom) -> None:
        for interval in (message.x, message.y):
            actions.require_increasing("zoom", interval)
        self.screen.limits[message.panel] = Limits(message.x, message.y)

    @_handle.register
    def _(self, message: messages.Click) -> None:
        page = self.page
        if message.panel == "plane":
            self._set_parameters({page.parameter: message.x, page.second: message.y})
            return
        limits = self.screen.axis_limits("diagram", page)
        point = nearest_point(page_state.branches(page, self.results), page.variable, (message.x, message.y), limits)
        if point is None:
            self._set_parameters({page.parameter: message.x})
        else:
            self._select(*point)

    @_handle.register
    def _(self, message: messages.SetStart) -> None:
        self._set_start(message.x, message.v)

    @_handle.register
    def _(self, message: messages.SetParameter) -> None:
        if self.drag_start is None:
            self.drag_start = self.page, self._new_names()
        page_before, names = self.drag_start
        try:
            self.page = self._change_parameters(
                {message.name: message.value}, page_before, names, None if message.last else DRAG_PERIODS
            )
        finally:
            if message.last:
                self._end_drag()

    @_handle.register
    def _(self, message: messages.Select) -> None:
        self._select(message.of, None)

    @_handle.register
    def _(self, message: messages.MoveOnBranch) -> None:
        branches = dict(page_state.branches(self.page, self.results))
        if not branches:
            raise ArgumentError("move", "requires a branch in the diagram. Follow an orbit first", message.by)
        names, reference = list(branches), self.page.chosen.partition(".special")[0]
        row = self.page.place
        if reference in branches and row is None:
            row = resolve(self.page.chosen, self.results).place
        name, row = (reference, row) if reference in branches and row is not None else (names[0], 0)
        if message.branch:
            name, row = names[(names.index(name) + message.branch) % len(names)], 0
        self._select(name, max(0, min(len(branches[name]) - 1, row + message.by)))

    @_handle.register
    def _(self, message: messages.SetAxes) -> None:
        names = self.results[self.page.scene].names
        for name, interval in ((message.parameter, message.bounds), (message.second, message.second_bounds)):
            check.require_parameter(name, names, name)
            actions.require_increasing("bounds", interval)
        if message.parameter == message.second:
            raise ArgumentError("second", "must differ from the parameter of the diagram", message.second)
        if message.variable not in VARIABLES:
            raise ArgumentError("variable", f"must be one of {', '.join(VARIABLES)}", message.variable)
        keys = ("parameter", "bounds", "second", "second_bounds", "variable")
        self.screen.limits.clear()
        self._show(self.page.with_lines(**{key: getattr(message, key) for key in keys}))

    @_handle.register
    def _(self, message: messages.RunAction) -> None:
        rounds = list(actions.action_lines(message, self.page, self.results, self._new_name))
        self._run_rounds(descriptions.action_label(message.call, self.page, self.results), rounds)

    @_handle.register
    def _(self, message: messages.Stop) -> None:
        self.close()

    @_handle.register
    def _(self, message: messages.Undo) -> None:
        if not self.history:
            raise ArgumentError("undo", "requires an earlier step", "no earlier step")
        self.page = self.history.pop()
        self._drop_unused_results()

    @_handle.register
    def _(self, message: messages.Load) -> None:
        if len(message.text) > MAX_BYTES:
            raise ArgumentError("scene file", f"must be at most {MAX_BYTES:,} bytes long", "more")
        file = scene_file.parse_content("scene file", message.text.encode())
        scene = file.scene.make(self.results[SCENE_NAME].dtype)
        self.close()
        self._open(file, scene)
        self._run_first_actions()

    def _run_first_actions(self) -> None:
        """Repeat the [[view]] tables of the file, or else compute its orbit and then its branches."""
        self._send_fields()
        self.wait()
        if self.file is not None and self.file.view:
            lines, scene = tuple(self.file.view), self.results[SCENE_NAME]
            self.tasks.start(
                "restoring the earlier calls",
                lambda report, schedule: replay_lines(lines, scene, report),
                self._end_replay,
            )
            return
        table = self.file and self.file.branch
        try:
            self._set_start(*((table.start.x, table.start.v) if table else (0.0, 0.0)))
        except Exception as error:
            self._send_error(error)
        self.history.clear()
        self.update_page()
        explore_table = self.file and self.file.explore
        if explore_table:
            self._handle(messages.RunAction(call="explore", max_period=explore_table.max_period))
        elif isinstance(self.results.get(self.page.current), Orbit):
            self._handle(messages.RunAction(call="follow"))

    def update_page(self) -> None:
        """Send the changes to the page, after its first message other than a panel size."""
        if not self.connected:
            return
        is_dragging = self.drag_start is not None
        try:
            for record in self.screen.changed_pictures(self.page, self.results, is_dragging):
                self.send(record)
            self._send_fields(is_dragging)
        except Exception as error:
            self._send_error(error)

    def _send_fields(self, is_dragging: bool = False) -> None:
        """Send the changed fields besides figures; `is_dragging` restricts them to those that follow a slider."""
        fields = live_fields(self.page, self.results, bool(self.history), self.tasks.labels)
        if not is_dragging and self.page is not self.static_page:
            fields |= static_fields(self.page, self.results, self.file)
            self.static_page = self.page
        new_fields = {key: value for key, value in fields.items() if self.sent_fields.get(key, ...) != value}
        if new_fields:
            self.sent_fields |= new_fields
            self.send({"kind": "state", **new_fields})

    def _send_progress(self, task_number: int, progress: Any) -> None:
        self.send({"kind": "progress", "work": task_number, "far": progress_text(progress)})

    def _send_error(self, error: Exception) -> None:
        self.send(error_record(error))

    def _new_name(self, stem: str) -> str:
        number = self.name_counters.get(stem, 1)
        self.name_counters[stem] = number + 1
        return f"{stem}_{number}"

    def _new_names(self) -> tuple[str, str, str]:
        return self._new_name("scene"), self._new_name("orbit"), self._new_name("motion")

    def _show(self, page: PageState) -> None:
        """Show another content, as a step that can be undone."""
        if page != self.page:
            self.history = [*self.history[1 - MAX_UNDO :], self.page]
            self.page = page
            self._drop_unused_results()

    def _drop_unused_results(self) -> None:
        """Drop the results that no step needs."""
        needed_names = {line.name for page in (*self.history, self.page) for line in page.lines} | {SCENE_NAME}
        self.results = {name: value for name, value in self.results.items() if name in needed_names}

    def _end_drag(self) -> None:
        """End the motion of a slider, which counts as one step."""
        if self.drag_start is not None:
            (page_before, _), self.drag_start = self.drag_start, None
            page, self.page = self.page, page_before
            self._show(page)

    def _set_start(self, x: float, v: float) -> None:
        line = self._settle(self.page.scene, State(x, v), self._new_names(), None)
        self._show(self.page.with_lines(line, current=line.name, chosen="", place=None))

    def _settle(self, scene: str, state: State, names: Sequence[str], periods: int | None) -> ViewTable:
        """Return the line of the orbit or motion that a state approaches, and store its result."""
        x, v, phase = (float(np.asarray(coordinate)) for coordinate in (state.x, state.v, state.phase))
        start = {"x": x, "v": v} | ({"phase": phase} if phase else {})
        line = ViewTable(name=names[1], call="moved" if periods else "find_orbit", of=scene, arguments=start)
        try:
            self.results[line.name] = evaluate(line, self.results)
        except OrbitError:
            extra = {"periods": periods or actions.MOTION_PERIODS}
            line = ViewTable(name=names[2], call="motion", of=scene, arguments=start | extra)
            self.results[line.name] = evaluate(line, self.results)
        return line

    def _set_parameters(self, changes: dict[str, float]) -> None:
        self._show(self._change_parameters(changes, self.page, self._new_names(), None))

    def _change_parameters(
        self, changes: dict[str, float], page: PageState, names: tuple[str, str, str], periods: int | None
    ) -> PageState:
        """Return the page with changed parameters; the motion continues from its last state."""
        scene, line = actions.change_scene(page, self.results, changes, names[0])
        self.results[line.name] = scene
        motion_line = self._settle(
            line.name, clamp_to_walls(scene, actions.last_state(self.results.get(page.current))), names, periods
        )
        return page.with_lines(line, motion_line, scene=line.name, current=motion_line.name, chosen="", place=None)

    def _select(self, reference: str, point_index: int | None) -> None:
        """Show the orbit at a special point or at a point of a branch."""
        page = self.page
        line = actions.orbit_line(reference, point_index, resolve(reference, self.results), self._new_name("orbit"))
        orbit = self.results[line.name] = evaluate(line, self.results)
        parameter_change = {page.parameter: float(orbit.scene.parameter(page.parameter))}
        scene, scene_line = actions.change_scene(page, self.results, parameter_change, self._new_name("scene"))
        self.results[scene_line.name] = scene
        fields = {"scene": scene_line.name, "current": line.name, "chosen": reference, "place": point_index}
        self._show(page.with_lines(scene_line, line, **fields))

    def _run_rounds(self, label: str, rounds: list[list[ViewTable]]) -> None:
        """Evaluate rounds of lines in a task and show each round in place of the previous one."""
        page_before, results = self.page, dict(self.results)

        def run_lines(report, schedule):
            previous_lines: list[ViewTable] = []
            for round_number, lines in enumerate(rounds, 1):
                prefix = f"{round_number} of {len(rounds)}: " if len(rounds) > 1 else ""
                for line in lines:
                    results[line.name] = evaluate(
                        line, results, lambda progress, prefix=prefix: report(prefix + progress_text(progress))
                    )
                schedule(lambda outcome=(lines, previous_lines, page_before, dict(results)): self._show_lines(*outcome))
                previous_lines = lines

        self.tasks.start(label, run_lines, lambda value, error: self._finish_action(error))

    def _show_lines(
        self, lines: list[ViewTable], superseded: list[ViewTable], page_before: PageState, results: dict[str, Any]
    ) -> None:
        """Show results of a task.

        `superseded` are the lines that they replace. `page_before` and `results` belong to the start of the task.
        """
        page = actions.add_lines(self.page, lines, superseded, page_before)
        self.results |= {line.name: results[line.name] for line in page.lines if line.name not in self.results}
        if superseded:
            self.page = page
        else:
            self._show(page)
        self.update_page()

    def _finish_action(self, error: Exception | None) -> None:
        if error is not None:
            self._send_error(error)
        self.update_page()
