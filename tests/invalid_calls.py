"""Invalid calls of every public function: a valid call of each, of which one argument is replaced.

A call passes where it raises ArgumentError (ContinuationError in `continuation`) that names an argument, the rule and
the value, and where it returns a result. OSError passes for a path that is a string or a Path, OrbitError for a state.
"""

import inspect
import os
import signal
import tempfile
import warnings
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import continuation as co
import jaxvibro as jv
from continuation import shooting
from jaxvibro import plot

from .scene_files import SCENE

LIMIT = 30.0  # seconds of the processor that a call may take
REFUSED = (jv.ArgumentError, co.ContinuationError)
FUNCTIONS = {
    mark + name: getattr(package, name)
    for package, mark in ((jv, ""), (plot, "plot."), (co, "co."))
    for name in package.__all__
    if inspect.isfunction(getattr(package, name))
}
FUNCTIONS |= {f"shooting.{name}": getattr(shooting, name) for name in ("periodic_orbits", "settled")}
LONG_DATA = (
    "basins",
    "fit",
    "fractions",
    "held",
    "locus",
    "manifold",
    "map",
    "margin",
    "region",
    "section",
    "spectrum",
)
WITHOUT_CALL = {f"plot.{name}" for name in LONG_DATA}
LONG = {("paper", "names"), ("warm", "scene"), ("warm", "progress")}  # a valid call of these takes minutes
OWN = {("shooting.settled", "args")}  # what a user's function is given: any value may be right, or an error of its own
PARTS = {"walls": {"left", "right", "length"}, "what": {"scene"}, "changes": {"scene"}}  # also named
SWEEP = """
[sweep]
parameter = "amplitude"
count = 2
settle = 1
keep = 1
legs = [{name = "up", from = 0.4, to = 0.5, start = {x = 0.0, v = 0.0}}]
"""


class Call(NamedTuple):
    """An invalid call; error: the number of the value in `invalid_values`."""

    function: str
    argument: str
    error: int

    def __str__(self):
        return f"{self.function}({self.argument}={str(invalid_values()[self.error])[:80]})"


def circle(u, p, args):
    """Radius 1, a Hopf point at m = 0."""
    x, y = u
    radius = x * x + y * y
    return jnp.stack([p["m"] * x - y - x * radius, x + p["m"] * y - y * radius])


def fold(u, p, args):
    """Equilibria with a fold at a = 0."""
    return p["a"] + p["b"] - u**2


@cache
def valid_arguments():
    """Return {name of an argument: its value, unless a function has its own} and {function: {argument: value}}."""
    scene, state = jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.0, 0.0)
    orbit = jv.find_orbit(scene, state, 1, settle=0)
    branch = jv.follow(orbit, "amplitude", (0.4, 3.6))
    grazing, saddle_node, breaking = (branch.points(kind)[0] for kind in ("GR", "SN", "SB"))
    settings = {"max_period": 1, "seed": 0, "largest_step": 0.1}
    diagram = jv.Diagram("amplitude", (0.4, 3.6), scene, (branch,), (), True, "all followed", settings)
    physical = {"mass": 1.0, "damping": 0.1, "stiffness": 4.0, "force": 1.0, "frequency": 4.0}
    rig = jv.scene_from_physical(**physical, restitution=0.7, walls=(-1.0, 1.0))
    impacts = jv.ImpactRecord([0.1, 0.4, 0.9, 1.3, 1.9], [-1, 1, -1, 1, -1], 0.01)
    plane = {"names": ("amplitude", "frequency"), "bounds": {"amplitude": (3.41, 3.42), "frequency": (2.09, 2.11)}}
    box = {"bounds": {"amplitude": (0.45, 0.55)}}
    folder = Path(tempfile.mkdtemp())
    (folder / "scene.toml").write_text(SCENE + SWEEP)
    branch.save(folder / "branch.nc")
    equation, orbits = co.equilibria(fold), FUNCTIONS["shooting.periodic_orbits"](circle)
    steady = co.trace(equation, 0.9, {"a": 0.5, "b": 0.3}, "a", (-1.0, 1.0))
    (hopf,) = co.trace(co.equilibria(circle), [0.0, 0.0], {"m": -0.5}, "m", (-1.0, 1.0)).points("HB")
    (turn,) = steady.points("SN")
    co.save(steady, folder / "steady.npz")
    usual = {"scene": scene, "state": state, "orbit": orbit, "branch": branch, "special": grazing, "name": "amplitude"}
    usual |= {"bounds": (0.45, 0.55), "values": [0.4, 0.5], "third": "damping", "free": {"amplitude": 0.5}}
    usual |= {"path": str(folder / "missing"), "attractors": jv.find_attractors(scene, 4, settle=20)}
    usual |= {"trajectory": jv.simulate(scene, state, 1, 8), "one": branch, "value": 0.5}
    usual |= {"max_period": 1, "starts": 4, "settle": 20, "patience": 100, "budget": 1, "keep": 1, "samples": 8}
    own = {
        "make_scene": {"amplitude": 0.5, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)},
        "scene_from_physical": physical | {"restitution": 0.7, "walls": (-1.0, 1.0)},
        "to_physical": {"data": jv.simulate(rig, state, 1, 8)},
        "soften": {"stiffness": 1e4},
        "effective_restitution": {"stiffness": 100.0, "damping": 0.5},
        "contact_damping": {"stiffness": 100.0, "restitution": 0.5},
        "load_scene": {"path": folder / "scene.toml"},
        "save_scene": {"path": folder / "saved.toml", "force": True},
        "load_data": {"path": folder / "branch.nc"},
        "sample": {"times": np.array([0.5, 1.0])},
        "return_map": {"side": "right", "phase": 0.3, "velocity": -1.0},
        "sections": {"periods": 2, "settle": 0},
        "find_orbit": {"settle": 0, "periods": 1},
        "solve_orbits": {"scenes": scene, "guesses": state, "itinerary": ("",)},
        "follow_all": {"orbits": [orbit]},
        "switch": {"special": breaking, "bounds": (3.54, 3.55)},
        "extend": {"bounds": (0.39, 3.6)},
        "load_branch": {"path": folder / "branch.nc"},
        "sensitivity": {"special": saddle_node, "names": "frequency"},
        "search": {"kinds": "GR", **box},
        "located": {"point": grazing, "wall": "right"},
        "hysteresis": {"first": saddle_node, "last": breaking},
        "margin": {"directions": 2, **box},
        "place": {"what": saddle_node, "target": 0.5081, "free": {"damping": 0.1}, "bounds": None},
        "fit": {"data": impacts, **box},
        "record_from_physical": {"record": impacts, "scene": rig},
        "locus": plane,
        "family": plane | {"values": [0.05]},
        "diagrams": {"values": [0.05]},
        "find_isolas": {"diagram": diagram, "max_impacts": 1},
        "load_diagram": {"folder": str(folder / "missing")},
        "sweep": {"settle": 1},
        "spectrum": {"settle": 1, "most": 1024},
        "basins": {"x": [-0.5, 0.5], "v": [0.0, 0.1]},
        "manifold": {"orbit": branch.orbit(branch.data.sizes["point"] - 1), "kind": "stable", "length": 0.2},
        "map_parameters": {"grid": {"amplitude": [0.4, 0.5]}},
        "least_shock": {"reach": 0.1, "shocks": 64},
        "run": {"path": folder / "scene.toml", "out": folder / "out", "force": True},
        "paper": {"names": ("no figure",), "out": folder / "paper"},
        "plot.diagram": {"swept": jv.sweep(scene, "amplitude", [0.4, 0.5], state, settle=1, keep=1)},
        "plot.mark_orbits": {"orbits": [orbit]},
        "plot.mark_points": {"branches": [branch], "ax": plt.figure().subplots()},
        "plot.orbit": {"one": orbit},
        "co.equilibria": {"function": fold},
        "co.fixed_points": {"move": fold},
        "co.trace": {"system": equation, "u": 0.9, "at": {"a": 0.5, "b": 0.3}, "along": "a", "bounds": (0.4, 0.6)},
        "co.switch": {"special": hopf, "orbits": orbits, "bounds": {"m": (-0.01, 0.01)}},
        "co.curve": {"special": turn, "names": ("a", "b"), "bounds": {"a": (-0.4, -0.2), "b": (0.2, 0.4)}},
        "co.sensitivity": {"special": turn, "names": "b"},
        "co.save": {"branch": steady, "path": folder / "again.npz"},
        "co.load": {"path": folder / "steady.npz", "system": equation},
        "shooting.periodic_orbits": {"field": circle},
        "shooting.settled": {"system": orbits, "start": [1.0, 0.0], "period": 6.28, "at": {"m": 1.0}},
    }
    return usual, own


@cache
def valid_call(name):
    """Return ({argument: value}, message of the exception or "") of the valid call of a function."""
    usual, own = valid_arguments()
    given = {each: usual[each] for each in inspect.signature(FUNCTIONS[name]).parameters if each in usual}
    given |= own.get(name, {})
    answer = answer_of(name, given)
    return given, str(answer) if isinstance(answer, Exception) else ""


class Plain:
    """An object of no use."""


def plain_values():
    """Return values of the types that users may confuse, each of which is wrong for most arguments."""
    endless, nan = [], float("nan")
    endless.append(endless)
    objects = [None, True, Plain(), Plain, Plain.mro, ..., Path("no/such/file"), jv.Wall(1.0)]
    texts = ["x", "", "a\0b", b"amplitude", np.str_("x")]
    numbers = [nan, float("inf"), -1, 0, 1.5, 10**400, 2**63, 1j, np.array(0.5), np.datetime64("2020-01-01")]
    arrays = [np.array([0.45, 0.5, 0.55]), np.eye(2), np.array([]), jnp.array([0.45, 0.5]), np.array([0.5, nan])]
    arrays += [np.array([True, False]), np.array([1j, 2.0]), np.array([None, "x"], object), np.array(["x", "left"])]
    groups = [set(), {"x"}, {}, {"x": 1.0}, {1: (0.0, 1.0)}, [], [None], ["x", "y"], [[1.0], [1.0, 2.0]], endless]
    groups += [("a", "b"), (None, None), (2.0, 1.0), (nan, 1.0), (0.0, 1j), (0, 10**400), (0.1, 0.5, 1.0)]
    groups += [(one for one in (0.4, 0.5)), iter("ab")]
    states = [jv.State(0.0, 0.0), jv.State(np.zeros(2), np.zeros(2)), jv.State("x", "y"), jv.State(nan, 0.0)]
    scenes = [jv.make_scene(amplitude, 2.1, 0.05, 0.7, (-1.0, 1.0)) for amplitude in (0.5, np.array([0.5, 0.6]))]
    return objects + texts + numbers + arrays + groups + states + scenes


def invalid_values():
    """Return the values that replace an argument; iterators among them are new in each call."""
    usual, _ = valid_arguments()
    return [*plain_values(), usual["orbit"], usual["branch"], xr.Dataset({"x": ("n", [1.0])})]


def is_tried(name, argument, value):
    """Return whether a call is fast and may be refused; a progress= that is called has errors of its own."""
    return (name, argument) not in LONG | OWN and not (argument == "progress" and callable(value))


def drawn(count, seed=0):
    """Return so many calls at random; all arguments have one before any has two."""
    rng, values, groups = np.random.default_rng(seed), invalid_values(), []
    for name in sorted(FUNCTIONS.keys() - WITHOUT_CALL):
        for argument in inspect.signature(FUNCTIONS[name]).parameters:
            errors = [k for k, value in enumerate(values) if is_tried(name, argument, value)]
            groups.append([Call(name, argument, int(k)) for k in rng.permutation(errors)])
    groups = [groups[k] for k in rng.permutation(len(groups)) if groups[k]]
    rounds = [group[k] for k in range(len(values)) for group in groups if k < len(group)]
    return rounds[:count]


@contextmanager
def limited(seconds):
    """Raise TimeoutError in Python's own code after so many seconds of the processor."""

    def late(*_):
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def answer_of(name, given):
    """Return the result of a call, or its exception."""
    try:
        with limited(LIMIT), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            answer = FUNCTIONS[name](**given)
    except Exception as error:
        answer = error
    if hasattr(answer, "url"):
        Thread(target=answer.stop).start()  # a page's server takes seconds to end
    plt.close("all")
    return answer


def fault_of(call):
    """Return what is wrong with the answer to a call, "" where nothing is."""
    given, usual_message = valid_call(call.function)
    value, fault = invalid_values()[call.error], ""
    answer = answer_of(call.function, given | {call.argument: value})
    if isinstance(answer, REFUSED):
        fault = fault_of_message(answer, call, value, given)
    elif isinstance(answer, Exception) and str(answer) != usual_message and not isinstance(answer, jv.OrbitError):
        is_path = isinstance(answer, OSError) and isinstance(value, str | os.PathLike)
        fault = "" if is_path and not isinstance(answer, TimeoutError) else f"{type(answer).__name__}: {answer}"
    return " ".join(fault.split())[:160]


def fault_of_message(error, call, value, given):
    """Return what is missing in a message: the argument or a name that stands for it, the rule or the value."""
    key, names = str(error.key), {call.argument, call.function, str(value)[:80]} | PARTS.get(call.argument, set())
    names |= {each for each in given.values() if isinstance(each, str)}
    if isinstance(value, jv.State):
        names.add("state")  # its entries are named by themselves
    if isinstance(value, dict | list | tuple | set | np.ndarray) and getattr(value, "ndim", 1):
        names |= {str(each)[:80] for each in value}
    if not (key in names or key.replace("[", ".").split(".")[0] in names or call.argument in str(error)):
        return f"names {key}: {error}"
    return "" if "; got " in str(error) and error.rule else f"has no value: {error}"
