"""Define the calls that a page can make, with the equivalent Python code, also that of its scene.

The calls are a list of `ViewTable` records, as in a scene file. A line may refer only to results of earlier lines, such
as `branch_1.special[2]`. References are parsed here and never evaluated as Python.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
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
from ..scene.check import ArgumentError, describe_choices, shorten_text
from ..scene.scene import Scene
from ..scene.scene_table import ForceTable, MotionTable, ScalesTable, SceneTable, WallLawTable, WallTable
from ..scene.state import State
from ..studies.schema import ViewTable
from ..surveys.map import map_parameters
from .background_tasks import ProgressCallback, progress_text

# (name of the constructor, number of positional arguments) of each table below that of the scene.
CONSTRUCTORS = {
    WallTable: ("Wall", 1),
    MotionTable: ("Motion", 3),
    WallLawTable: ("Push", 2),
    ForceTable: ("Force", 2),
    ScalesTable: ("Scales", 3),
}


def scene_code(scene_table: SceneTable) -> str:
    """Return the expression that makes the scene of a table, without its scales."""
    scalar_values = {name: getattr(scene_table, name) for name in ("amplitude", "frequency", "damping", "restitution")}
    arguments = [f"{name}={value!r}" for name, value in scalar_values.items() if value is not None]
    if scene_table.left is not None or scene_table.right is not None:
        arguments.append(f"walls=({_value_code(scene_table.left)}, {_value_code(scene_table.right)})")
    optional_values = {"force": scene_table.force, "drive": scene_table.drive}
    arguments += [f"{name}={_value_code(value)}" for name, value in optional_values.items() if value]
    return f"jv.make_scene({', '.join(arguments)})"


def scales_code(scene_table: SceneTable) -> str | None:
    """Return the expression that makes the `Scales` of a table; None if the table has no scales."""
    return None if scene_table.scales is None else _value_code(scene_table.scales)


def _value_code(value):
    """Return the expression of a table, a list of tables, a number or a text; omit the arguments that are None."""
    if isinstance(value, list):
        return f"[{', '.join(map(_value_code, value))}]"
    if type(value) not in CONSTRUCTORS:
        return repr(value)
    constructor_name, n_positional = CONSTRUCTORS[type(value)]
    argument_codes = [(name, _value_code(getattr(value, name))) for name in value.__struct_fields__]
    positional_codes = [code for _, code in argument_codes[:n_positional]]
    keyword_codes = [f"{name}={code}" for name, code in argument_codes[n_positional:] if code != "None"]
    return f"jv.{constructor_name}({', '.join([*positional_codes, *keyword_codes])})"


SCENE_NAME = "scene_1"  # scene of the file
SETTLE_PERIODS = 300  # drive periods of the transient
MOTION_CALLS = ("find_orbit", "moved", "motion", "orbit", "special")  # calls whose results the portrait shows
NAME_PATTERN = re.compile(r"[a-z]+_[1-9]\d{0,5}")
REFERENCE_PATTERN = re.compile(rf"({NAME_PATTERN.pattern})((?:(?:\.branches|\.special)?\[\d{{1,6}}\])*)")
ACCESS_PATTERN = re.compile(r"(?:\.(branches|special))?\[(\d+)\]")
TYPE_WORDS: dict[type, str] = {Scene: "a Scene", Orbit: "an Orbit", Branch: "a Branch", Special: "a special point"}


class Call(NamedTuple):
    """Call of a public function.

    Attributes
    ----------
    text : str
        Python code of the call.
    run : callable
        Function that makes the call. Its argument is a function that reports progress.
    """

    text: str
    run: Callable[[ProgressCallback], Any]


class CallDefinition(NamedTuple):
    """Definition of a call that a page can make.

    Attributes
    ----------
    kind : type
        Type of the object on which the call is made.
    make : callable
        Function that builds the `Call` from the `Expression` of this object and the arguments.
    """

    kind: type
    make: Callable[..., Call]


class Expression(NamedTuple):
    """Value with its Python code.

    Attributes
    ----------
    value : object
        Value.
    text : str
        Python code of the value, for example a reference.
    """

    value: Any
    text: str


def _replace_call(receiver, changes):
    changes_code = ", ".join(f"{name!r}: {value!r}" for name, value in changes.items())
    return Call(f"{receiver.text}.replace(**{{{changes_code}}})", lambda report: receiver.value.replace(**changes))


def _find_orbit_call(receiver, x, v, phase=0.0):
    return Call(
        f"jv.find_orbit({receiver.text}, jv.State({x!r}, {v!r}, {phase!r}))",
        lambda report: find_orbit(receiver.value, State(x, v, phase)),
    )


def _quick_orbit_call(receiver, x, v, phase=0.0):
    """Return the call that finds an orbit while a slider moves.

    The transient is one compiled run. It is about forty times faster than the transient of `find_orbit`.
    """
    settled_state_call = _settle_call(receiver, x, v, phase)
    return Call(
        f"jv.find_orbit({receiver.text}, {settled_state_call.text}, settle=1)",
        lambda report: find_orbit(receiver.value, settled_state_call.run(report), settle=1),
    )


def _simulate_call(receiver, x, v, periods, phase=0.0):
    settled_state_call = _settle_call(receiver, x, v, phase)
    return Call(
        f"jv.simulate({receiver.text}, {settled_state_call.text}, {periods!r})",
        lambda report: simulate(receiver.value, settled_state_call.run(report), periods),
    )


def _settle_call(receiver, x, v, phase):
    return Call(
        f"jv.strobe({receiver.text}, jv.State({x!r}, {v!r}, {phase!r}), {SETTLE_PERIODS}, 0)[0]",
        lambda report: strobe(receiver.value, State(x, v, phase), SETTLE_PERIODS, 0)[0],
    )


def _orbit_at_point_call(receiver, place):
    return Call(f"{receiver.text}.orbit({place!r})", lambda report: receiver.value.orbit(place))


def _orbit_at_special_call(receiver):
    return Call(f"{receiver.text}.orbit", lambda report: receiver.value.orbit)


def _follow_call(receiver, parameter, low, high):
    return Call(
        f"jv.follow({receiver.text}, {parameter!r}, ({low!r}, {high!r}))",
        lambda report: follow(receiver.value, parameter, (low, high)),
    )


def _switch_call(receiver):
    return Call(f"jv.switch({receiver.text})", lambda report: switch(receiver.value))


def _explore_scene_call(receiver, parameter, low, high, max_period):
    return Call(
        f"jv.explore({receiver.text}, {parameter!r}, ({low!r}, {high!r}), max_period={max_period!r})",
        lambda report: explore(receiver.value, parameter, (low, high), max_period=max_period, progress=report),
    )


def _locus_call(receiver, bounds):
    plane_bounds = {name: tuple(interval) for name, interval in bounds.items()}
    return Call(
        f"jv.locus({receiver.text}, {tuple(plane_bounds)!r}, {plane_bounds!r})",
        lambda report: locus(receiver.value, tuple(plane_bounds), plane_bounds),
    )


def _margin_call(receiver, free):
    return Call(f"jv.margin({receiver.text}, {free!r})", lambda report: margin(receiver.value, free))


def _basins_call(receiver, x, v, count):
    return Call(
        f"jv.basins({receiver.text}, {_linspace_expression(*x, count).text}, {_linspace_expression(*v, count).text})",
        lambda report: basins(
            receiver.value,
            _linspace_expression(*x, count).value,
            _linspace_expression(*v, count).value,
            progress=report,
        ),
    )


def _map_parameters_call(receiver, bounds, count):
    axis_expressions = {name: _linspace_expression(*interval, count) for name, interval in bounds.items()}
    grid_code = ", ".join(f"{name!r}: {axis_expression.text}" for name, axis_expression in axis_expressions.items())
    grid_values = {name: axis_expression.value for name, axis_expression in axis_expressions.items()}
    return Call(
        f'jv.map_parameters({receiver.text}, {{{grid_code}}}, quantities=("label",))',
        lambda report: map_parameters(receiver.value, grid_values, quantities=("label",), progress=report),
    )


def _sweep_call(receiver, parameter, first, last, count, x, v):
    value_expression = _linspace_expression(first, last, count)
    return Call(
        f"jv.sweep({receiver.text}, {parameter!r}, {value_expression.text}, jv.State({x!r}, {v!r}))",
        lambda report: sweep(receiver.value, parameter, value_expression.value, State(x, v), progress=report),
    )


def _find_attractors_call(receiver):
    return Call(f"jv.find_attractors({receiver.text})", lambda report: find_attractors(receiver.value))


def _linspace_expression(first, last, count):
    return Expression(np.linspace(first, last, count), f"np.linspace({first!r}, {last!r}, {count!r})")


CALLS: dict[str, CallDefinition] = {
    "replace": CallDefinition(Scene, _replace_call),
    "find_orbit": CallDefinition(Scene, _find_orbit_call),
    "moved": CallDefinition(Scene, _quick_orbit_call),
    "motion": CallDefinition(Scene, _simulate_call),
    "orbit": CallDefinition(Branch, _orbit_at_point_call),
    "special": CallDefinition(Special, _orbit_at_special_call),
    "follow": CallDefinition(Orbit, _follow_call),
    "switch": CallDefinition(Special, _switch_call),
    "explore": CallDefinition(Scene, _explore_scene_call),
    "locus": CallDefinition(Special, _locus_call),
    "margin": CallDefinition(Orbit, _margin_call),
    "basins": CallDefinition(Scene, _basins_call),
    "map": CallDefinition(Scene, _map_parameters_call),
    "sweep": CallDefinition(Scene, _sweep_call),
    "attractors": CallDefinition(Scene, _find_attractors_call),
}


def build_call(call_line: ViewTable, results: Mapping[str, Any]) -> Call:
    """Return the `Call` of a line. Raises ArgumentError for a line that no page can have written."""
    if call_line.call not in CALLS:
        raise ArgumentError(
            "view.call", f"must be one of {', '.join(CALLS)}{describe_choices(call_line.call, CALLS)}", call_line.call
        )
    if not NAME_PATTERN.fullmatch(call_line.name):
        raise ArgumentError("view.name", "must be a word and a number, such as branch_1", shorten_text(call_line.name))
    receiver = Expression(resolve_reference(call_line.of, results), call_line.of)
    receiver_type, call_builder = CALLS[call_line.call]
    if not isinstance(receiver.value, receiver_type):
        raise ArgumentError("view.of", f"must be {TYPE_WORDS[receiver_type]}, for {call_line.call}", call_line.of)
    try:
        return call_builder(receiver, **call_line.arguments)
    except ArgumentError:
        raise
    except (TypeError, ValueError, AttributeError) as error:
        raise ArgumentError(
            "view.arguments", f"must match those of {call_line.call} ({shorten_text(error)})", call_line.name
        ) from None


def evaluate_call_line(
    call_line: ViewTable, results: Mapping[str, Any], report_progress: ProgressCallback = lambda progress: None
) -> Any:
    """Return the result of a line.

    Raises ArgumentError for a line that no page can have written, and the errors of the call.
    """
    return build_call(call_line, results).run(report_progress)


def evaluate_rounds(
    line_rounds: Sequence[list[ViewTable]], results: dict[str, Any], report_progress: ProgressCallback
) -> Iterator[list[ViewTable]]:
    """Evaluate rounds of lines, add their results to `results`, and yield the lines of each completed round."""
    for round_number, round_lines in enumerate(line_rounds, 1):
        prefix = f"{round_number} of {len(line_rounds)}: " if len(line_rounds) > 1 else ""
        report_in_round = partial(_report_with_prefix, report_progress, prefix)
        for call_line in round_lines:
            results[call_line.name] = evaluate_call_line(call_line, results, report_in_round)
        yield round_lines


def _report_with_prefix(report_progress, prefix, progress):
    report_progress(prefix + progress_text(progress))


def resolve_reference(reference: str, results: Mapping[str, Any]) -> Any:
    """Return the value of a reference such as "branch_1.special[2]". Raises ArgumentError for an invalid reference."""
    reference_match = REFERENCE_PATTERN.fullmatch(reference)
    try:
        if reference_match is None:
            raise LookupError
        value = results[reference_match[1]]
        for attribute_name, index in ACCESS_PATTERN.findall(reference_match[2]):
            value = (getattr(value, attribute_name) if attribute_name else value)[int(index)]
        return value
    except (LookupError, AttributeError, TypeError):
        raise ArgumentError("view.of", "must refer to the result of an earlier line", shorten_text(reference)) from None


def parent_line_name(call_line: ViewTable) -> str:
    """Return the name of the line to which a line refers."""
    reference_match = REFERENCE_PATTERN.fullmatch(call_line.of)
    return reference_match[1] if reference_match else ""


def prune_call_lines(call_lines: Sequence[ViewTable], names_in_use: Sequence[str]) -> tuple[ViewTable, ...]:
    """Return the lines except those of scenes and motions that are neither in use nor referred to by another line."""
    remaining_lines: list[ViewTable] = []
    needed_names = set(names_in_use)
    for call_line in reversed(call_lines):
        if call_line.name in needed_names or call_line.call not in (*MOTION_CALLS, "replace"):
            remaining_lines.append(call_line)
            needed_names.add(parent_line_name(call_line))
    return tuple(reversed(remaining_lines))


def python_code_of_page(
    scene_table: SceneTable | None, call_lines: Sequence[ViewTable], results: Mapping[str, Any]
) -> str:
    """Return all calls as a program that prints the tables of the page.

    `scene_table` is the table of the scene. None stands for a scene that no table describes, for example under a
    user-defined force without a name."""
    earlier_results = {SCENE_NAME: results[SCENE_NAME]}
    statements, print_statements = [], []
    if scene_table is None:
        statements.append(f"{SCENE_NAME} = ...  # the scene passed to jv.view")
    else:
        statements.append(f"{SCENE_NAME} = {scene_code(scene_table)}")
        if scales_expression := scales_code(scene_table):
            statements.append(f"{SCENE_NAME} = dataclasses.replace({SCENE_NAME}, scales={scales_expression})")
    for call_line in call_lines:
        statements.append(f"{call_line.name} = {build_call(call_line, earlier_results).text}")
        earlier_results[call_line.name] = result = results[call_line.name]
        if hasattr(result, "table"):
            print_statements.append(f"print({call_line.name}.table())")
        elif isinstance(result, tuple) and result and all(hasattr(member, "table") for member in result):
            print_statements.append(f"for one in {call_line.name}:\n    print(one.table())")
    import_lines = ["import dataclasses"] if any("dataclasses." in statement for statement in statements) else []
    import_lines += ["", "import jax"] if import_lines else ["import jax"]
    import_lines += ["import numpy as np"] if any("np." in statement for statement in statements) else []
    import_lines += ["import jaxvibro as jv", "", 'jax.config.update("jax_enable_x64", True)', ""]
    return "\n".join([*import_lines, *statements, *(["", *print_statements] if print_statements else [])]) + "\n"
