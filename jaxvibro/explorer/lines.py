"""What can be asked on the page: each a public call, with the line of Python that does the same.

What was asked is a list of `ViewTable`s, as a scene file keeps it. A line may refer to the results of those before it,
`branch_1.special[2]`, and to nothing else: it is read here, and never evaluated as Python.
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
from ..scene.check import ArgumentError, among, short
from ..scene.scene import Scene
from ..scene.scene_table import SceneTable
from ..scene.state import State
from ..studies.schema import ViewTable
from ..surveys.map import map_parameters
from .scene_code import scales_code, scene_code
from .work import Tell

SCENE = "scene_1"  # that of the file
SETTLE = 300  # drive periods after which a motion is shown
LOOKS = ("find_orbit", "moved", "motion", "orbit", "special")  # calls whose result the portrait shows
NAME = re.compile(r"[a-z]+_[1-9]\d{0,5}")
REFERENCE = re.compile(rf"({NAME.pattern})((?:(?:\.branches|\.special)?\[\d{{1,6}}\])*)")
STEP = re.compile(r"(?:\.(branches|special))?\[(\d+)\]")
KINDS: dict[type, str] = {Scene: "a Scene", Orbit: "an Orbit", Branch: "a Branch", Special: "a special point"}


class Call(NamedTuple):
    """A call. text: as Python; run: does it; what it is given is called with how far it is, if the call tells that."""

    text: str
    run: Callable[[Tell], Any]


class Form(NamedTuple):
    """What calls of a name are of, and what makes one, of what it is of and its arguments."""

    kind: type
    make: Callable[..., Call]


class Given(NamedTuple):
    """What a line refers to, and the Python that gives it."""

    value: Any
    text: str


def _replace(of, changes):
    told = ", ".join(f"{name!r}: {value!r}" for name, value in changes.items())
    return Call(f"{of.text}.replace(**{{{told}}})", lambda told: of.value.replace(**changes))


def _find_orbit(of, x, v, phase=0.0):
    return Call(
        f"jv.find_orbit({of.text}, jv.State({x!r}, {v!r}, {phase!r}))",
        lambda told: find_orbit(of.value, State(x, v, phase)),
    )


def _moved(of, x, v, phase=0.0):
    """The same while a slider moves: settled in one compiled run, which takes a fortieth of the time."""
    start = _settled(of, x, v, phase)
    return Call(
        f"jv.find_orbit({of.text}, {start.text}, settle=1)",
        lambda told: find_orbit(of.value, start.run(told), settle=1),
    )


def _motion(of, x, v, periods, phase=0.0):
    start = _settled(of, x, v, phase)
    return Call(
        f"jv.simulate({of.text}, {start.text}, {periods!r})",
        lambda told: simulate(of.value, start.run(told), periods),
    )


def _settled(of, x, v, phase):
    return Call(
        f"jv.strobe({of.text}, jv.State({x!r}, {v!r}, {phase!r}), {SETTLE}, 0)[0]",
        lambda told: strobe(of.value, State(x, v, phase), SETTLE, 0)[0],
    )


def _orbit(of, place):
    return Call(f"{of.text}.orbit({place!r})", lambda told: of.value.orbit(place))


def _special(of):
    return Call(f"{of.text}.orbit", lambda told: of.value.orbit)


def _follow(of, parameter, low, high):
    return Call(
        f"jv.follow({of.text}, {parameter!r}, ({low!r}, {high!r}))",
        lambda told: follow(of.value, parameter, (low, high)),
    )


def _switch(of):
    return Call(f"jv.switch({of.text})", lambda told: switch(of.value))


def _explore(of, parameter, low, high, max_period):
    return Call(
        f"jv.explore({of.text}, {parameter!r}, ({low!r}, {high!r}), max_period={max_period!r})",
        lambda told: explore(of.value, parameter, (low, high), max_period=max_period, progress=told),
    )


def _locus(of, bounds):
    box = {name: tuple(pair) for name, pair in bounds.items()}
    return Call(f"jv.locus({of.text}, {tuple(box)!r}, {box!r})", lambda told: locus(of.value, tuple(box), box))


def _margin(of, free):
    return Call(f"jv.margin({of.text}, {free!r})", lambda told: margin(of.value, free))


def _basins(of, x, v, count):
    return Call(
        f"jv.basins({of.text}, {_even(*x, count).text}, {_even(*v, count).text})",
        lambda told: basins(of.value, _even(*x, count).value, _even(*v, count).value, progress=told),
    )


def _map(of, bounds, count):
    grid = {name: _even(*pair, count) for name, pair in bounds.items()}
    told = ", ".join(f"{name!r}: {row.text}" for name, row in grid.items())
    values = {name: row.value for name, row in grid.items()}
    return Call(
        f'jv.map_parameters({of.text}, {{{told}}}, quantities=("label",))',
        lambda told: map_parameters(of.value, values, quantities=("label",), progress=told),
    )


def _sweep(of, parameter, first, last, count, x, v):
    values = _even(first, last, count)
    return Call(
        f"jv.sweep({of.text}, {parameter!r}, {values.text}, jv.State({x!r}, {v!r}))",
        lambda told: sweep(of.value, parameter, values.value, State(x, v), progress=told),
    )


def _attractors(of):
    return Call(f"jv.find_attractors({of.text})", lambda told: find_attractors(of.value))


def _even(first, last, count):
    return Given(np.linspace(first, last, count), f"np.linspace({first!r}, {last!r}, {count!r})")


CALLS: dict[str, Form] = {
    "replace": Form(Scene, _replace),
    "find_orbit": Form(Scene, _find_orbit),
    "moved": Form(Scene, _moved),
    "motion": Form(Scene, _motion),
    "orbit": Form(Branch, _orbit),
    "special": Form(Special, _special),
    "follow": Form(Orbit, _follow),
    "switch": Form(Special, _switch),
    "explore": Form(Scene, _explore),
    "locus": Form(Special, _locus),
    "margin": Form(Orbit, _margin),
    "basins": Form(Scene, _basins),
    "map": Form(Scene, _map),
    "sweep": Form(Scene, _sweep),
    "attractors": Form(Scene, _attractors),
}


def call_of(line: ViewTable, results: Mapping[str, Any]) -> Call:
    """The `Call` of a line. Raises ArgumentError for what no page can have asked."""
    if line.call not in CALLS:
        raise ArgumentError("view.call", f"must be one of {', '.join(CALLS)}{among(line.call, CALLS)}", line.call)
    if not NAME.fullmatch(line.name):
        raise ArgumentError("view.name", "must be a word and a number, as branch_1", short(line.name))
    of = Given(resolved(line.of, results), line.of)
    kind, make = CALLS[line.call]
    if not isinstance(of.value, kind):
        raise ArgumentError("view.of", f"must be {KINDS[kind]}, for {line.call}", line.of)
    try:
        return make(of, **line.arguments)
    except ArgumentError:
        raise
    except (TypeError, ValueError, AttributeError) as error:
        raise ArgumentError("view.arguments", f"must be those of {line.call} ({short(error)})", line.name) from None


def evaluated(line: ViewTable, results: Mapping[str, Any], told: Tell = lambda far: None) -> Any:
    """The result of a line. Raises ArgumentError for one that no page can have asked, and what the call raises."""
    return call_of(line, results).run(told)


def resolved(reference: str, results: Mapping[str, Any]) -> Any:
    """What a reference means, as "branch_1.special[2]". Raises ArgumentError where there is no such thing."""
    found = REFERENCE.fullmatch(reference)
    try:
        if found is None:
            raise LookupError
        value = results[found[1]]
        for name, place in STEP.findall(found[2]):
            value = (getattr(value, name) if name else value)[int(place)]
        return value
    except (LookupError, AttributeError, TypeError):
        raise ArgumentError("view.of", "must be the result of a line before", short(reference)) from None


def referred(line: ViewTable) -> str:
    """The name of the line that a line refers to."""
    found = REFERENCE.fullmatch(line.of)
    return found[1] if found else ""


def tidy(lines: Sequence[ViewTable], kept: Sequence[str]) -> tuple[ViewTable, ...]:
    """The lines without those scenes and looks that are not kept and that nothing refers to."""
    found: list[ViewTable] = []
    needed = set(kept)
    for line in reversed(lines):
        if line.name in needed or line.call not in (*LOOKS, "replace"):
            found.append(line)
            needed.add(referred(line))
    return tuple(reversed(found))


def python(table: SceneTable | None, lines: Sequence[ViewTable], results: Mapping[str, Any]) -> str:
    """All that was asked as a program that prints what the page shows.

    table: of the scene, None where it has none, as one with a force of the user's own.
    """
    known = {SCENE: results[SCENE]}
    body, tables = [], []
    if table is None:
        body.append(f"{SCENE} = ...  # the scene that was given to jv.view")
    else:
        body.append(f"{SCENE} = {scene_code(table)}")
        if scales := scales_code(table):
            body.append(f"{SCENE} = dataclasses.replace({SCENE}, scales={scales})")
    for line in lines:
        body.append(f"{line.name} = {call_of(line, known).text}")
        known[line.name] = value = results[line.name]
        if hasattr(value, "table"):
            tables.append(f"print({line.name}.table())")
        elif isinstance(value, tuple) and value and all(hasattr(one, "table") for one in value):
            tables.append(f"for one in {line.name}:\n    print(one.table())")
    heads = ["import dataclasses"] if any("dataclasses." in one for one in body) else []
    heads += ["", "import jax"] if heads else ["import jax"]
    heads += ["import numpy as np"] if any("np." in one for one in body) else []
    heads += ["import jaxvibro as jv", "", 'jax.config.update("jax_enable_x64", True)', ""]
    return "\n".join([*heads, *body, *(["", *tables] if tables else [])]) + "\n"
