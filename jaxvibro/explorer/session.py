"""Hold the state of one page and apply its messages, independently of the server."""

from collections.abc import Callable
from functools import partial, singledispatchmethod
from typing import Any

import numpy as np

from ..branches.branch_curves import VARIABLES
from ..flight.wall_positions import adapt_to_moved_walls
from ..orbits.orbit import Orbit
from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from ..studies import scene_file
from ..studies.scene_file import MAX_BYTES
from ..studies.schema import SceneFile, ViewTable
from . import action_calls, messages, page_display, page_screen, page_state
from .background_tasks import BackgroundTasks, Schedule, progress_text
from .messages import error_record
from .page_calls import SCENE_NAME, evaluate_call_line, evaluate_rounds, resolve_reference
from .page_display import display_data_on_drag, display_data_when_idle
from .page_state import PageState, nearest_point
from .panels import AxisLimits, Panel, PanelSize
from .view_replay import replay_call_lines, restore_page

MAX_UNDO = 200  # steps of undo
DRAG_PERIODS = 16  # drive periods shown while a slider moves

Send = Callable[[dict[str, Any]], object]
Wait = Callable[[], object]


class Session:
    """State of one page; one thread calls its methods.

    Parameters
    ----------
    scene_file : SceneFile or None
        Scene file, whose tables select the first results. None if the scene cannot be written as text.
    scene : Scene
        Scene of the page.
    send_record : callable
        Function that sends a record to the page, from any thread.
    run_in_page_thread : callable
        Function that runs a callback in the thread of this session.
    wait_until_ready : callable, optional
        Function that is called after the first fields are sent and before the first computation.
    """

    def __init__(
        self,
        scene_file: SceneFile | None,
        scene: Scene,
        send_record: Send,
        run_in_page_thread: Schedule,
        wait_until_ready: Wait = lambda: None,
    ) -> None:
        self.send, self.schedule, self.wait, self.screen, self.connected = (
            send_record,
            run_in_page_thread,
            wait_until_ready,
            page_screen.Screen(),
            False,
        )
        self._open_scene(scene_file, scene)

    def _open_scene(self, scene_file: SceneFile | None, scene: Scene) -> None:
        """Show the initial page of a scene; earlier results and steps of undo are discarded."""
        self.file = scene_file
        self.results: dict[str, Any] = {SCENE_NAME: scene}
        self.name_counters = {"scene": 2}  # next number of each name stem
        self.history: list[PageState] = []
        # Page and names at the start of a slider motion.
        self.drag_start: tuple[PageState, tuple[str, str, str]] | None = None
        self.page = page_state.initial_page(scene, scene_file)
        self.screen.invalidate()
        self.tasks = BackgroundTasks(self._send_progress, self.schedule, bool(scene.dtype == np.float64))
        self.sent_fields: dict[str, Any] = {}  # fields that the page has
        self.static_page: PageState | None = None  # page whose static fields were sent

    def _show_replay_results(self, results: dict[str, Any] | None, error: Exception | None) -> None:
        """Show the results of the [[view]] tables of the file."""
        if results is None or self.file is None:
            self._finish_action(error)
            return
        for call_line in self.file.view:
            name_stem, _, name_number = call_line.name.rpartition("_")
            if int(name_number) >= self.name_counters.get(name_stem, 1):
                self.name_counters[name_stem] = int(name_number) + 1
        self.results = results
        self._show_page(restore_page(self.page, self.file.view, results))
        self.history.clear()
        self.update_page()

    def close(self) -> None:
        """Stop all tasks of the page."""
        self.tasks.stop()

    def receive_message(self, message: messages.PageMessage) -> None:
        """Apply a message and update the page; an error is sent to the page as one line."""
        self.connected |= not isinstance(message, messages.ResizePanel)
        try:
            if self.drag_start is not None and not isinstance(message, messages.SetParameter | messages.ResizePanel):
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
            self._handle(messages.LoadSceneFile(text=message.text))
        else:
            self._run_first_actions()

    @_handle.register
    def _(self, message: messages.ResizePanel) -> None:
        panel_size = PanelSize(message.width, message.height, message.ratio)
        if message.panel not in self.screen.panels or self.screen.panels[message.panel].size != panel_size:
            self.screen.panels[message.panel] = Panel(panel_size)

    @_handle.register
    def _(self, message: messages.ZoomPanel) -> None:
        for interval in (message.x, message.y):
            action_calls.require_valid_bounds("zoom", interval)
        self.screen.limits[message.panel] = AxisLimits(message.x, message.y)

    @_handle.register
    def _(self, message: messages.Click) -> None:
        current_page = self.page
        if message.panel == "plane":
            self._set_parameters({current_page.parameter: message.x, current_page.second: message.y})
            return
        axis_limits = self.screen.axis_limits("diagram", current_page)
        reference_and_index = nearest_point(
            page_state.diagram_branches(current_page, self.results),
            current_page.variable,
            (message.x, message.y),
            axis_limits,
        )
        if reference_and_index is None:
            self._set_parameters({current_page.parameter: message.x})
        else:
            self._select(*reference_and_index)

    @_handle.register
    def _(self, message: messages.SetStart) -> None:
        self._set_initial_state(message.x, message.v)

    @_handle.register
    def _(self, message: messages.SetParameter) -> None:
        if self.drag_start is None:
            self.drag_start = self.page, self._new_scene_motion_names()
        page_before_drag, names = self.drag_start
        try:
            self.page = self._change_parameters(
                {message.name: message.value}, page_before_drag, names, None if message.last else DRAG_PERIODS
            )
        finally:
            if message.last:
                self._end_drag()

    @_handle.register
    def _(self, message: messages.Select) -> None:
        self._select(message.of, None)

    @_handle.register
    def _(self, message: messages.MoveOnBranch) -> None:
        self._select(*action_calls.moved_selection(message, self.page, self.results))

    @_handle.register
    def _(self, message: messages.SetAxes) -> None:
        names = self.results[self.page.scene].names
        for name, interval in ((message.parameter, message.bounds), (message.second, message.second_bounds)):
            check.require_parameter(name, names, name)
            action_calls.require_valid_bounds("bounds", interval)
        if message.parameter == message.second:
            raise ArgumentError("second", "must differ from the parameter of the diagram", message.second)
        if message.variable not in VARIABLES:
            raise ArgumentError("variable", f"must be one of {', '.join(VARIABLES)}", message.variable)
        axis_field_names = ("parameter", "bounds", "second", "second_bounds", "variable")
        self.screen.limits.clear()
        self._show_page(self.page.with_call_lines(**{key: getattr(message, key) for key in axis_field_names}))

    @_handle.register
    def _(self, message: messages.RunAction) -> None:
        line_rounds = list(action_calls.action_call_lines(message, self.page, self.results, self._new_result_name))
        self._start_rounds_task(page_display.action_label(message.call, self.page, self.results), line_rounds)

    @_handle.register
    def _(self, message: messages.StopTasks) -> None:
        self.close()

    @_handle.register
    def _(self, message: messages.Undo) -> None:
        if not self.history:
            raise ArgumentError("undo", "requires an earlier step", "no earlier step")
        self.page = self.history.pop()
        self._drop_unused_results()

    @_handle.register
    def _(self, message: messages.LoadSceneFile) -> None:
        if len(message.text) > MAX_BYTES:
            raise ArgumentError("scene file", f"must be at most {MAX_BYTES:,} bytes long", "more")
        file_tables = scene_file.parse_scene_file("scene file", message.text.encode())
        scene = file_tables.scene.make(self.results[SCENE_NAME].dtype)
        self.close()
        self._open_scene(file_tables, scene)
        self._run_first_actions()

    def _run_first_actions(self) -> None:
        """Repeat the calls in the [[view]] tables of the file; if there are none, compute an orbit, then branches."""
        self._send_fields()
        self.wait()
        if self.file is not None and self.file.view:
            lines, scene = tuple(self.file.view), self.results[SCENE_NAME]
            self.tasks.start(
                "restoring the earlier calls",
                lambda report, schedule: replay_call_lines(lines, scene, report),
                self._show_replay_results,
            )
            return
        branch_table = self.file and self.file.branch
        try:
            self._set_initial_state(*((branch_table.start.x, branch_table.start.v) if branch_table else (0.0, 0.0)))
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
        """Send the changes to the page if the page has sent a message other than a panel size."""
        if not self.connected:
            return
        is_dragging = self.drag_start is not None
        try:
            for picture_record in self.screen.changed_pictures(self.page, self.results, is_dragging):
                self.send(picture_record)
            self._send_fields(is_dragging)
        except Exception as error:
            self._send_error(error)

    def _send_fields(self, is_dragging: bool = False) -> None:
        """Send the changed fields besides figures; `is_dragging` selects those that change while a slider moves."""
        fields = display_data_on_drag(self.page, self.results, bool(self.history), self.tasks.labels)
        if not is_dragging and self.page is not self.static_page:
            fields |= display_data_when_idle(self.page, self.results, self.file)
            self.static_page = self.page
        changed_fields = {key: value for key, value in fields.items() if self.sent_fields.get(key, ...) != value}
        if changed_fields:
            self.sent_fields |= changed_fields
            self.send({"kind": "state", **changed_fields})

    def _send_progress(self, task_number: int, progress: Any) -> None:
        self.send({"kind": "progress", "work": task_number, "far": progress_text(progress)})

    def _send_error(self, error: Exception) -> None:
        self.send(error_record(error))

    def _new_result_name(self, name_stem: str) -> str:
        name_number = self.name_counters.get(name_stem, 1)
        self.name_counters[name_stem] = name_number + 1
        return f"{name_stem}_{name_number}"

    def _new_scene_motion_names(self) -> tuple[str, str, str]:
        return self._new_result_name("scene"), self._new_result_name("orbit"), self._new_result_name("motion")

    def _show_page(self, page: PageState) -> None:
        """Show a new page content, as a step that can be undone."""
        if page != self.page:
            self.history = [*self.history[1 - MAX_UNDO :], self.page]
            self.page = page
            self._drop_unused_results()

    def _drop_unused_results(self) -> None:
        """Drop the results that neither the page nor a step of undo needs."""
        needed_names = {call_line.name for page in (*self.history, self.page) for call_line in page.lines} | {
            SCENE_NAME
        }
        self.results = {name: value for name, value in self.results.items() if name in needed_names}

    def _end_drag(self) -> None:
        """End the motion of a slider; the whole motion is one step of undo."""
        if self.drag_start is not None:
            (page_before_drag, _), self.drag_start = self.drag_start, None
            page, self.page = self.page, page_before_drag
            self._show_page(page)

    def _set_initial_state(self, x: float, v: float) -> None:
        motion_line = action_calls.settle_motion(
            self.page.scene, State(x, v), self._new_scene_motion_names(), None, self.results
        )
        self._show_page(self.page.with_call_lines(motion_line, current=motion_line.name, chosen="", place=None))

    def _set_parameters(self, changes: dict[str, float]) -> None:
        self._show_page(self._change_parameters(changes, self.page, self._new_scene_motion_names(), None))

    def _change_parameters(
        self, changes: dict[str, float], page: PageState, result_names: tuple[str, str, str], periods: int | None
    ) -> PageState:
        """Return the page with changed parameters; the motion continues from its last state."""
        scene, scene_line = action_calls.changed_scene_and_line(page, self.results, changes, result_names[0])
        self.results[scene_line.name] = scene
        motion_state = action_calls.current_motion_state(self.results.get(page.current))
        initial_state = adapt_to_moved_walls(scene, motion_state)
        motion_line = action_calls.settle_motion(scene_line.name, initial_state, result_names, periods, self.results)
        return page.with_call_lines(
            scene_line, motion_line, scene=scene_line.name, current=motion_line.name, chosen="", place=None
        )

    def _select(self, reference: str, point_index: int | None) -> None:
        """Show the orbit at a special point or at a point of a branch."""
        page = self.page
        orbit_line = action_calls.orbit_call_line(
            reference, point_index, resolve_reference(reference, self.results), self._new_result_name("orbit")
        )
        orbit = self.results[orbit_line.name] = evaluate_call_line(orbit_line, self.results)
        parameter_change = {page.parameter: float(orbit.scene.parameter(page.parameter))}
        scene, scene_line = action_calls.changed_scene_and_line(
            page, self.results, parameter_change, self._new_result_name("scene")
        )
        self.results[scene_line.name] = scene
        page_changes = {"scene": scene_line.name, "current": orbit_line.name, "chosen": reference, "place": point_index}
        self._show_page(page.with_call_lines(scene_line, orbit_line, **page_changes))

    def _start_rounds_task(self, label: str, line_rounds: list[list[ViewTable]]) -> None:
        """Evaluate rounds of lines in a task and show each round in place of the previous one."""
        page_at_start, results = self.page, dict(self.results)

        def show_rounds(report, schedule):
            previous_lines: list[ViewTable] = []
            for round_lines in evaluate_rounds(line_rounds, results, report):
                task_results = round_lines, previous_lines, page_at_start, dict(results)
                schedule(partial(self._show_task_results, *task_results))
                previous_lines = round_lines

        self.tasks.start(label, show_rounds, lambda value, error: self._finish_action(error))

    def _show_task_results(
        self,
        new_lines: list[ViewTable],
        lines_to_replace: list[ViewTable],
        page_at_start: PageState,
        results: dict[str, Any],
    ) -> None:
        """Show results of a task.

        `lines_to_replace` are the lines that the new lines replace. `page_at_start` is the page at the start of the
        task. `results` are the results at that time and those of the task."""
        page = action_calls.add_call_lines(self.page, new_lines, lines_to_replace, page_at_start)
        self.results |= {
            call_line.name: results[call_line.name] for call_line in page.lines if call_line.name not in self.results
        }
        if lines_to_replace:
            self.page = page
        else:
            self._show_page(page)
        self.update_page()

    def _finish_action(self, error: Exception | None) -> None:
        if error is not None:
            self._send_error(error)
        self.update_page()
