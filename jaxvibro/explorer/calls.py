"""Define the calls that a page can make: public functions with the equivalent Python code.

The calls are a list of `ViewTable` records, as in a scene file. A line may refer only to results of earlier lines, such
as `branch_1.special[2]`. References are parsed here and never evaluated as Python.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..attractors.basins import basins
from ..attractors.find import find_attractors
from ..attractors.sweep import sweep
from ..branches.branch import Branch, Special
from ..branches.explore import explore
from ..branches.follow import follow
from ..design.margin import margin
from ..loci.locus import locus
from ..loci.switch import switch
from ..maps.simulate import simulate
from ..maps.strobe import strobe
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit
from ..scene.check import ArgumentError, describe_choices, shorten
from ..scene.scene import Scene
from ..scene.scene_table import SceneTable
from ..scene.state import State
from ..studies.schema import ViewTable
from ..surveys.map import map_parameters
from .background_tasks import ProgressCallback
from .scene_code import scales_code, scene_code

SCENE_NAME = "scene_1"  # scene of the file
SETTLE_PERIODS = 300  # drive periods of the transient
MOTION_CALLS = ("find_orbit", "moved", "motion", "orbit", "special")  # calls whose results the portrait shows
NAME_PATTERN = re.compile(r"[a-z]+_[1-9]\d{0,5}")
REFERENCE_PATTERN = re.compile(rf"({NAME_PATTERN.pattern})((?:(?:\.branches|\.special)?\[\d{{1,6}}\])*)")
ACCESS_PATTERN = re.compile(r"(?:\.(branches|special))?\[(\d+)\]")
TYPE_WORDS: dict[type, str] = {Scene: "a Scene", Orbit: "an Orbit", Branch: "a Branch", Special: "a special point"}


class Call(NamedTuple):
    """Call as Python code, `text`, and as a function, `run`, of a progress callback."""

    text: str
    run: Callable[[ProgressCallback], Any]


class CallType(NamedTuple):
    """Type of the receiver of a call, and the function that builds the call from receiver and arguments."""

    kind: type
    make: Callable[..., Call]


class Expression(NamedTuple):
    """Value of a reference, and the Python code of the reference."""

    value: Any
    text: str


def _replace(receiver, changes):
    changes_text = ", ".join(f"{name!r}: {value!r}" for name, value in changes.items())
    return Call(f"{receiver.text}.replace(**{{{changes_text}}})", lambda report: receiver.value.replace(**changes))


def _find_orbit(receiver, x, v, phase=0.0):
    return Call(
        f"jv.find_orbit({receiver.text}, jv.State({x!r}, {v!r}, {phase!r}))",
        lambda report: find_orbit(receiver.value, State(x, v, phase)),
    )


def _find_orbit_quickly(receiver, x, v, phase=0.0):
    """Find an orbit while a slider moves: the transient is one compiled run, about forty times faster."""
    start = _settle(receiver, x, v, phase)
    return Call(
        f"jv.find_orbit({receiver.text}, {start.text}, settle=1)",
        lambda report: find_orbit(receiver.value, start.run(report), settle=1),
    )


def _simulate(receiver, x, v, periods, phase=0.0):
    start = _settle(receiver, x, v, phase)
    return Call(
        f"jv.simulate({receiver.text}, {start.text}, {periods!r})",
        lambda report: simulate(receiver.value, start.run(report), periods),
    )


def _settle(receiver, x, v, phase):
    return Call(
        f"jv.strobe({receiver.text}, jv.State({x!r}, {v!r}, {phase!r}), {SETTLE_PERIODS}, 0)[0]",
        lambda report: strobe(receiver.value, State(x, v, phase), SETTLE_PERIODS, 0)[0],
    )


def _orbit_at_point(receiver, place):
    return Call(f"{receiver.text}.orbit({place!r})", lambda report: receiver.value.orbit(place))


def _orbit_at_special(receiver):
    return Call(f"{receiver.text}.orbit", lambda report: receiver.value.orbit)


def _follow(receiver, parameter, low, high):
    return Call(
        f"jv.follow({receiver.text}, {parameter!r}, ({low!r}, {high!r}))",
        lambda report: follow(receiver.value, parameter, (low, high)),
    )


def _switch(receiver):
    return Call(f"jv.switch({receiver.text})", lambda report: switch(receiver.value))


def _explore(receiver, parameter, low, high, max_period):
    return Call(
        f"jv.explore({receiver.text}, {parameter!r}, ({low!r}, {high!r}), max_period={max_period!r})",
        lambda report: explore(receiver.value, parameter, (low, high), max_period=max_period, progress=report),
    )


def _locus(receiver, bounds):
    plane_bounds = {name: tuple(interval) for name, interval in bounds.items()}
    return Call(
        f"jv.locus({receiver.text}, {tuple(plane_bounds)!r}, {plane_bounds!r})",
        lambda report: locus(receiver.value, tuple(plane_bounds), plane_bounds),
    )


def _margin(receiver, free):
    return Call(f"jv.margin({receiver.text}, {free!r})", lambda report: margin(receiver.value, free))


def _basins(receiver, x, v, count):
    return Call(
        f"jv.basins({receiver.text}, {_linspace(*x, count).text}, {_linspace(*v, count).text})",
        lambda report: basins(receiver.value, _linspace(*x, count).value, _linspace(*v, count).value, progress=report),
    )


def _map_parameters(receiver, bounds, count):
    grid = {name: _linspace(*interval, count) for name, interval in bounds.items()}
    grid_text = ", ".join(f"{name!r}: {axis.text}" for name, axis in grid.items())
    grid_values = {name: axis.value for name, axis in grid.items()}
    return Call(
        f'jv.map_parameters({receiver.text}, {{{grid_text}}}, quantities=("label",))',
        lambda report: map_parameters(receiver.value, grid_values, quantities=("label",), progress=report),
    )


def _sweep(receiver, parameter, first, last, count, x, v):
    values = _linspace(first, last, count)
    return Call(
        f"jv.sweep({receiver.text}, {parameter!r}, {values.text}, jv.State({x!r}, {v!r}))",
        lambda report: sweep(receiver.value, parameter, values.value, State(x, v), progress=report),
    )


def _find_attractors(receiver):
    return Call(f"jv.find_attractors({receiver.text})", lambda report: find_attractors(receiver.value))


def _linspace(first, last, count):
    return Expression(np.linspace(first, last, count), f"np.linspace({first!r}, {last!r}, {count!r})")


CALLS: dict[str, CallType] = {
    "replace": CallType(Scene, _replace),
    "find_orbit": CallType(Scene, _find_orbit),
    "moved": CallType(Scene, _find_orbit_quickly),
    "motion": CallType(Scene, _simulate),
    "orbit": CallType(Branch, _orbit_at_point),
    "special": CallType(Special, _orbit_at_special),
    "follow": CallType(Orbit, _follow),
    "switch": CallType(Special, _switch),
    "explore": CallType(Scene, _explore),
    "locus": CallType(Special, _locus),
    "margin": CallType(Orbit, _margin),
    "basins": CallType(Scene, _basins),
    "map": CallType(Scene, _map_parameters),
    "sweep": CallType(Scene, _sweep),
    "attractors": CallType(Scene, _find_attractors),
}


def build_call(line: ViewTable, results: Mapping[str, Any]) -> Call:
    """Return the `Call` of a line. Raises ArgumentError for a line that no page can have written."""
    if line.call not in CALLS:
        raise ArgumentError(
            "view.call", f"must be one of {', '.join(CALLS)}{describe_choices(line.call, CALLS)}", line.call
        )
    if not NAME_PATTERN.fullmatch(line.name):
        raise ArgumentError("view.name", "must be a word and a number, such as branch_1", shorten(line.name))
    receiver = Expression(resolve(line.of, results), line.of)
    receiver_type, build = CALLS[line.call]
    if not isinstance(receiver.value, receiver_type):
        raise ArgumentError("view.of", f"must be {TYPE_WORDS[receiver_type]}, for {line.call}", line.of)
    try:
        return build(receiver, **line.arguments)
    except ArgumentError:
        raise
    except (TypeError, ValueError, AttributeError) as error:
        raise ArgumentError(
            "view.arguments", f"must match those of {line.call} ({shorten(error)})", line.name
        ) from None


def evaluate(line: ViewTable, results: Mapping[str, Any], report: ProgressCallback = lambda progress: None) -> Any:
    """Return the result of a line.

    Raises ArgumentError for a line that no page can have written, and the errors of the call.
    """
    return build_call(line, results).run(report)


def resolve(reference: str, results: Mapping[str, Any]) -> Any:
    """Return the value of a reference such as "branch_1.special[2]". Raises ArgumentError if there is none."""
    match = REFERENCE_PATTERN.fullmatch(reference)
    try:
        if match is None:
            raise LookupError
        value = results[match[1]]
        for name, index in ACCESS_PATTERN.findall(match[2]):
            value = (getattr(value, name) if name else value)[int(index)]
        return value
    except (LookupError, AttributeError, TypeError):
        raise ArgumentError("view.of", "must refer to the result of an earlier line", shorten(reference)) from None


def parent_name(line: ViewTable) -> str:
    """Return the name of the line to which a line refers."""
    match = REFERENCE_PATTERN.fullmatch(line.of)
    return match[1] if match else ""


def prune_lines(lines: Sequence[ViewTable], names_in_use: Sequence[str]) -> tuple[ViewTable, ...]:
    """Return the lines without scenes and orbits that are not in use and to which no line refers."""
    remaining: list[ViewTable] = []
    needed_names = set(names_in_use)
    for line in reversed(lines):
        if line.name in needed_names or line.call not in (*MOTION_CALLS, "replace"):
            remaining.append(line)
            needed_names.add(parent_name(line))
    return tuple(reversed(remaining))


def python_program(table: SceneTable | None, lines: Sequence[ViewTable], results: Mapping[str, Any]) -> str:
    """Return all calls as a program that prints the tables of the page.

    `table` is that of the scene; None if it has none, as with a user-defined force without a name.
    """
    earlier_results = {SCENE_NAME: results[SCENE_NAME]}
    statements, print_statements = [], []
    if table is None:
        statements.append(f"{SCENE_NAME} = ...  # the scene passed to jv.view")
    else:
        statements.append(f"{SCENE_NAME} = {scene_code(table)}")
        if scales_expression := scales_code(table):
            statements.append(f"{SCENE_NAME} = dataclasses.replace({SCENE_NAME}, scales={scales_expression})")
    for line in lines:
        statements.append(f"{line.name} = {build_call(line, earlier_results).text}")
        earlier_results[line.name] = value = results[line.name]
        if hasattr(value, "table"):
            print_statements.append(f"print({line.name}.table())")
        elif isinstance(value, tuple) and value and all(hasattr(item, "table") for item in value):
            print_statements.append(f"for one in {line.name}:\n    print(one.table())")
    header = ["import dataclasses"] if any("dataclasses." in item for item in statements) else []
    header += ["", "import jax"] if header else ["import jax"]
    header += ["import numpy as np"] if any("np." in item for item in statements) else []
    header += ["import jaxvibro as jv", "", 'jax.config.update("jax_enable_x64", True)', ""]
    return "\n".join([*header, *statements, *(["", *print_statements] if print_statements else [])]) + "\n"
