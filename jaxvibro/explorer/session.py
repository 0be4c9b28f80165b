"""One page: what it shows, and what each message changes. Knows of no server: it is given what tells the page."""

from collections.abc import Callable, Sequence
from functools import singledispatchmethod
from typing import Any

import numpy as np

from ..branches.curves import VARIABLES
from ..flight.wall_positions import fit
from ..orbits.orbit import Orbit, OrbitError
from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from ..studies import scene_file
from ..studies.schema import SceneFile, ViewTable
from ..studies.text_limits import LARGEST
from . import asks, descriptions, messages, screen, shown
from .complaints import complaint
from .lines import SCENE, evaluated, resolved
from .nearest import nearest
from .page_text import rest_of, state_of
from .panels import Limits, Panel, Size
from .replay import replayed, shown_again
from .shown import Shown
from .work import Later, Works, text_of_far

MOST_PAST = 200  # steps that can be taken back
MOVED = 16  # periods of a motion that is shown while a slider moves

Push = Callable[[dict[str, Any]], object]
Wait = Callable[[], object]


class Session:
    """What one page is about. Its methods are called by one thread.

    file: of the scene, its tables say what is looked at first; None of a scene that has no text. push: called with each
    record that the page is to be told, from any thread; later: called with what this session's thread is to do; wait:
    called once the page knows what there is to ask, before anything is.
    """

    def __init__(
        self, file: SceneFile | None, scene: Scene, push: Push, later: Later, wait: Wait = lambda: None
    ) -> None:
        self.push, self.later, self.wait, self.screen, self.greeted = push, later, wait, screen.Screen(), False
        self._open(file, scene)

    def _open(self, file: SceneFile | None, scene: Scene) -> None:
        """Begins with a scene."""
        self.file = file
        self.results: dict[str, Any] = {SCENE: scene}
        self.counts = {"scene": 2}  # the next number of each kind of name
        self.past: list[Shown] = []
        self.taken: tuple[Shown, tuple[str, str, str]] | None = None  # what there was when a slider was taken
        self.shown = shown.first_shown(scene, file)
        self.screen.forget()
        self.works = Works(self._tell_far, self.later, bool(scene.dtype == np.float64))
        self.told: dict[str, Any] = {}  # what the page knows
        self.rested: Shown | None = None  # of which it knows the rest

    def _again(self, results: dict[str, Any] | None, error: Exception | None) -> None:
        """Shows what the file's [[view]] asked, once that is done."""
        if results is None or self.file is None:
            self._ended(error)
            return
        for line in self.file.view:
            stem, _, number = line.name.rpartition("_")
            if int(number) >= self.counts.get(stem, 1):
                self.counts[stem] = int(number) + 1
        self.results = results
        self._show(shown_again(self.shown, self.file.view, results))
        self.past.clear()
        self.tell()

    def close(self) -> None:
        """Ends all work: the page has gone, or has asked for it."""
        self.works.stop()

    def receive(self, message: messages.Sent) -> None:
        """Does what a message asks, and tells the page; a complaint is one line."""
        self.greeted |= not isinstance(message, messages.Resize)
        try:
            if self.taken is not None and not isinstance(message, messages.Put | messages.Resize):
                self._let_go()
            self._do(message)
        except Exception as error:  # whatever it was, the page is answered and goes on
            self._complain(error)
        self.tell()
        self.push({"kind": "answer", "number": message.number})

    @singledispatchmethod
    def _do(self, message: Any) -> None:
        raise ArgumentError("message", "must be one that the page knows", type(message).__name__)

    @_do.register
    def _(self, message: messages.Hello) -> None:
        if message.text:
            self._do(messages.Load(text=message.text))
        else:
            self._begin()

    @_do.register
    def _(self, message: messages.Resize) -> None:
        size = Size(message.width, message.height, message.ratio)
        if message.panel not in self.screen.panels or self.screen.panels[message.panel].size != size:
            self.screen.panels[message.panel] = Panel(size)

    @_do.register
    def _(self, message: messages.Zoom) -> None:
        for pair in (message.x, message.y):
            asks.require_rising("zoom", pair)
        self.screen.limits[message.panel] = Limits(message.x, message.y)

    @_do.register
    def _(self, message: messages.Pick) -> None:
        now = self.shown
        if message.panel == "plane":
            self._put({now.parameter: message.x, now.second: message.y})
            return
        box = self.screen.box("diagram", now)
        found = nearest(shown.branches(now, self.results), now.variable, (message.x, message.y), box)
        if found is None:
            self._put({now.parameter: message.x})
        else:
            self._choose(*found)

    @_do.register
    def _(self, message: messages.Begin) -> None:
        self._start(message.x, message.v)

    @_do.register
    def _(self, message: messages.Put) -> None:
        if self.taken is None:
            self.taken = self.shown, self._names()
        before, names = self.taken
        try:
            self.shown = self._changed({message.name: message.value}, before, names, None if message.last else MOVED)
        finally:
            if message.last:
                self._let_go()

    @_do.register
    def _(self, message: messages.Choose) -> None:
        self._choose(message.of, None)

    @_do.register
    def _(self, message: messages.Move) -> None:
        known = dict(shown.branches(self.shown, self.results))
        if not known:
            raise ArgumentError("move", "must be along a branch: there is none yet, follow one", message.by)
        names, own = list(known), self.shown.chosen.partition(".special")[0]
        row = self.shown.place
        if own in known and row is None:
            row = resolved(self.shown.chosen, self.results).place
        name, row = (own, row) if own in known and row is not None else (names[0], 0)
        if message.branch:
            name, row = names[(names.index(name) + message.branch) % len(names)], 0
        self._choose(name, max(0, min(len(known[name]) - 1, row + message.by)))

    @_do.register
    def _(self, message: messages.Along) -> None:
        names = self.results[self.shown.scene].names
        for name, pair in ((message.parameter, message.bounds), (message.second, message.second_bounds)):
            check.require_known(name, names, name)
            asks.require_rising("bounds", pair)
        if message.parameter == message.second:
            raise ArgumentError("second", "must be another parameter than the diagram's", message.second)
        if message.variable not in VARIABLES:
            raise ArgumentError("variable", f"must be one of {', '.join(VARIABLES)}", message.variable)
        keys = ("parameter", "bounds", "second", "second_bounds", "variable")
        self.screen.limits.clear()
        self._show(self.shown.having(**{key: getattr(message, key) for key in keys}))

    @_do.register
    def _(self, message: messages.Ask) -> None:
        rounds = list(asks.asked(message, self.shown, self.results, self._name))
        self._long(descriptions.label_of(message.call, self.shown, self.results), rounds)

    @_do.register
    def _(self, message: messages.Stop) -> None:
        self.close()

    @_do.register
    def _(self, message: messages.Undo) -> None:
        if not self.past:
            raise ArgumentError("undo", "must have something to take back", "nothing was asked before")
        self.shown = self.past.pop()
        self._forget()

    @_do.register
    def _(self, message: messages.Load) -> None:
        if len(message.text) > LARGEST:
            raise ArgumentError("scene file", f"must be at most {LARGEST:,} bytes long", "more")
        file = scene_file.of_content("scene file", message.text.encode())
        scene = file.scene.make(self.results[SCENE].dtype)
        self.close()
        self._open(file, scene)
        self._begin()

    # What these are made of.

    def _begin(self) -> None:
        """Does again what the file's [[view]] asked; else what it asks for first: its orbit, then its branches."""
        self._tell_texts()
        self.wait()
        if self.file is not None and self.file.view:
            lines, scene = tuple(self.file.view), self.results[SCENE]
            self.works.begin("what was asked before", lambda tell, later: replayed(lines, scene, tell), self._again)
            return
        table = self.file and self.file.branch
        try:
            self._start(*((table.start.x, table.start.v) if table else (0.0, 0.0)))
        except Exception as error:
            self._complain(error)
        self.past.clear()
        self.tell()
        explores = self.file and self.file.explore
        if explores:
            self._do(messages.Ask(call="explore", max_period=explores.max_period))
        elif isinstance(self.results.get(self.shown.current), Orbit):
            self._do(messages.Ask(call="follow"))

    def tell(self) -> None:
        """Tells the page what is other than it knows, once it has said more than how large its panels are."""
        if not self.greeted:
            return
        moving = self.taken is not None
        try:
            for record in self.screen.pictures(self.shown, self.results, moving):
                self.push(record)
            self._tell_texts(moving)
        except Exception as error:
            self._complain(error)

    def _tell_texts(self, moving: bool = False) -> None:
        """Tells what is other than the page knows besides pictures. moving: what changes as a slider moves alone."""
        state = state_of(self.shown, self.results, bool(self.past), self.works.labels)
        if not moving and self.shown is not self.rested:
            state |= rest_of(self.shown, self.results, self.file)
            self.rested = self.shown
        new = {key: value for key, value in state.items() if self.told.get(key, ...) != value}
        if new:
            self.told |= new
            self.push({"kind": "state", **new})

    def _tell_far(self, number: int, far: Any) -> None:
        self.push({"kind": "progress", "work": number, "far": text_of_far(far)})

    def _complain(self, error: Exception) -> None:
        self.push(complaint(error))

    def _name(self, stem: str) -> str:
        number = self.counts.get(stem, 1)
        self.counts[stem] = number + 1
        return f"{stem}_{number}"

    def _names(self) -> tuple[str, str, str]:
        return self._name("scene"), self._name("orbit"), self._name("motion")

    def _show(self, new: Shown) -> None:
        """Shows something else, which can be taken back."""
        if new != self.shown:
            self.past = [*self.past[1 - MOST_PAST :], self.shown]
            self.shown = new
            self._forget()

    def _forget(self) -> None:
        """Leaves out the results that no step needs any more."""
        needed = {line.name for each in (*self.past, self.shown) for line in each.lines} | {SCENE}
        self.results = {name: value for name, value in self.results.items() if name in needed}

    def _let_go(self) -> None:
        """A slider has been let go of: the whole way is one step."""
        if self.taken is not None:
            (before, _), self.taken = self.taken, None
            now, self.shown = self.shown, before
            self._show(now)

    def _start(self, x: float, v: float) -> None:
        line = self._settled(self.shown.scene, State(x, v), self._names(), None)
        self._show(self.shown.having(line, current=line.name, chosen="", place=None))

    def _settled(self, scene: str, state: State, names: Sequence[str], periods: int | None) -> ViewTable:
        """The line of the orbit, or motion, that a start settles on; its result is kept."""
        x, v, phase = (float(np.asarray(each)) for each in (state.x, state.v, state.phase))
        start = {"x": x, "v": v} | ({"phase": phase} if phase else {})
        line = ViewTable(name=names[1], call="moved" if periods else "find_orbit", of=scene, arguments=start)
        try:
            self.results[line.name] = evaluated(line, self.results)
        except OrbitError:
            more = {"periods": periods or asks.LONGEST}
            line = ViewTable(name=names[2], call="motion", of=scene, arguments=start | more)
            self.results[line.name] = evaluated(line, self.results)
        return line

    def _put(self, changes: dict[str, float]) -> None:
        self._show(self._changed(changes, self.shown, self._names(), None))

    def _changed(
        self, changes: dict[str, float], now: Shown, names: tuple[str, str, str], periods: int | None
    ) -> Shown:
        """What there is, with numbers of the scene that are others; the motion goes on from where it is."""
        scene, line = asks.changed(now, self.results, changes, names[0])
        self.results[line.name] = scene
        look = self._settled(line.name, fit(scene, asks.state_of(self.results.get(now.current))), names, periods)
        return now.having(line, look, scene=line.name, current=look.name, chosen="", place=None)

    def _choose(self, reference: str, place: int | None) -> None:
        """Shows the orbit at a special point, or at a point of a branch."""
        now = self.shown
        line = asks.look(reference, place, resolved(reference, self.results), self._name("orbit"))
        one = self.results[line.name] = evaluated(line, self.results)
        there = {now.parameter: float(one.scene.parameter(now.parameter))}
        scene, moved = asks.changed(now, self.results, there, self._name("scene"))
        self.results[moved.name] = scene
        new = {"scene": moved.name, "current": line.name, "chosen": reference, "place": place}
        self._show(now.having(moved, line, **new))

    def _long(self, label: str, rounds: list[list[ViewTable]]) -> None:
        """Evaluates rounds of lines, each in place of the one before, and shows each as it is there."""
        then, results = self.shown, dict(self.results)

        def run(tell, later):
            before: list[ViewTable] = []
            for place, lines in enumerate(rounds, 1):
                part = f"{place} of {len(rounds)}: " if len(rounds) > 1 else ""
                for line in lines:
                    results[line.name] = evaluated(line, results, lambda far, part=part: tell(part + text_of_far(far)))
                later(lambda found=(lines, before, then, dict(results)): self._found(*found))
                before = lines

        self.works.begin(label, run, lambda value, error: self._ended(error))

    def _found(self, lines: list[ViewTable], left: list[ViewTable], then: Shown, results: dict[str, Any]) -> None:
        """Shows what long work has found; left: lines in whose place it is; then, results: when it was begun."""
        new = asks.with_found(self.shown, lines, left, then)
        self.results |= {line.name: results[line.name] for line in new.lines if line.name not in self.results}
        if left:
            self.shown = new
        else:
            self._show(new)
        self.tell()

    def _ended(self, error: Exception | None) -> None:
        if error is not None:
            self._complain(error)
        self.tell()
