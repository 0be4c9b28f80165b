"""Invalid calls of every public function: a table of functions, arguments and kinds of error.

`bases()` holds a cheap valid call of each function, `ERRORS` the values that replace one of its arguments. A call
passes where it raises ArgumentError (ContinuationError in `continuation`) that names an argument, the rule and the
value, and where it returns a result. OSError passes for a path that is a string or a Path, OrbitError for any state.
"""

import inspect
import os
import signal
import tempfile
import time
import warnings
from contextlib import contextmanager
from functools import lru_cache
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

SLOW = 10.0  # seconds that a call may take
REFUSED = (jv.ArgumentError, co.ContinuationError)
SCENE_FILE = """
[scene]
amplitude = 0.5
frequency = 2.1
damping = 0.05
restitution = 0.7
[scene.left]
position = -1.0
[scene.right]
position = 1.0
[sweep]
parameter = "amplitude"
count = 2
settle = 1
keep = 1
legs = [{name = "up", from = 0.4, to = 0.5, start = {x = 0.0, v = 0.0}}]
"""


class Call(NamedTuple):
    """One invalid call."""

    function: str
    argument: str
    error: str

    def __str__(self):
        return f"{self.function}({self.argument}=<{self.error}>)"


class Outcome(NamedTuple):
    """fault: what is wrong with the answer to a call, "" where nothing is; refused: whether it was refused."""

    fault: str
    refused: bool
    seconds: float


def circle(u, p, args):
    """Radius 1, a Hopf point at m = 0."""
    x, y = u
    radius = x * x + y * y
    return jnp.stack([p["m"] * x - y - x * radius, x + p["m"] * y - y * radius])


def fold(u, p, args):
    """Equilibria with a fold at a = 0."""
    return p["a"] + p["b"] - u**2


@lru_cache
def shared():
    """What the calls share: a scene, its orbit, a branch with special points, datasets of studies, a scene file."""
    scene, state = jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.0, 0.0)
    orbit = jv.find_orbit(scene, state, 1, settle=0)
    branch = jv.follow(orbit, "amplitude", (0.4, 3.6))
    settings = {"max_period": 1, "seed": 0, "largest_step": 0.1}
    diagram = jv.Diagram("amplitude", (0.4, 3.6), scene, (branch,), (), True, "all followed", settings)
    rig = jv.scene_from_physical(1.0, 0.1, 4.0, 1.0, 4.0, 0.7, (-1.0, 1.0))
    steady = co.trace(co.equilibria(fold), 0.9, {"a": 0.5, "b": 0.3}, "a", (-1.0, 1.0))
    spun = co.trace(co.equilibria(circle), [0.0, 0.0], {"m": -0.5}, "m", (-1.0, 1.0))
    folder = Path(tempfile.mkdtemp())
    (folder / "scene.toml").write_text(SCENE_FILE)
    branch.save(folder / "branch.nc")
    co.save(steady, folder / "steady.npz")
    return {
        "scene": scene,
        "rig": rig,
        "state": state,
        "orbit": orbit,
        "branch": branch,
        "diagram": diagram,
        "grazing": branch.points("GR")[0],
        "fold": branch.points("SN")[0],
        "attractors": jv.find_attractors(scene, 4, settle=20),
        "impacts": jv.ImpactRecord([0.1, 0.4, 0.9, 1.3, 1.9], [-1, 1, -1, 1, -1], 0.01),
        "trace": jv.simulate(scene, state, 1, 8),
        "swept": jv.sweep(scene, "amplitude", [0.4, 0.5], state, settle=1, keep=1),
        "steady": steady,
        "spun": spun,
        "folder": folder,
    }


def bases():
    """{function: ({argument: value} of a valid call)}."""
    of = shared()
    scene, state, orbit, branch, folder = (of[key] for key in ("scene", "state", "orbit", "branch", "folder"))
    box, free = {"amplitude": (0.45, 0.55)}, {"amplitude": 0.5}
    plane = {"names": ("amplitude", "frequency"), "bounds": {"amplitude": (3.41, 3.42), "frequency": (2.09, 2.11)}}
    row = {"scene": scene, "name": "amplitude", "values": [0.4, 0.5]}
    missing = str(folder / "missing")
    found = {
        "make_scene": {"amplitude": 0.5, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)},
        "scene_from_physical": {
            "mass": 1.0,
            "damping": 0.1,
            "stiffness": 4.0,
            "force": 1.0,
            "frequency": 4.0,
            "restitution": 0.7,
            "walls": (-1.0, 1.0),
        },
        "to_physical": {"data": jv.simulate(of["rig"], state, 1, 8)},
        "soften": {"scene": scene, "stiffness": 1e4},
        "effective_restitution": {"stiffness": 100.0, "damping": 0.5},
        "contact_damping": {"stiffness": 100.0, "restitution": 0.5},
        "load_scene": {"path": folder / "scene.toml"},
        "save_scene": {"scene": scene, "path": folder / "saved.toml", "force": True},
        "load_data": {"path": folder / "branch.nc"},
        "strobe": {"scene": scene, "state": state},
        "wall_loads": {"scene": scene, "state": state},
        "monodromy": {"scene": scene, "state": state},
        "simulate": {"scene": scene, "state": state, "samples": 8},
        "sample": {"scene": scene, "state": state, "times": np.array([0.5, 1.0])},
        "return_map": {"scene": scene, "side": "right", "phase": 0.3, "velocity": -1.0},
        "sections": {"scene": scene, "state": state, "periods": 2, "settle": 0},
        "find_orbit": {"scene": scene, "state": state, "settle": 0, "periods": 1},
        "find_orbits": {"scene": scene, "max_period": 1, "starts": 4},
        "solve_orbits": {"scenes": scene, "guesses": state, "itinerary": ("",)},
        "twist": {"orbit": orbit},
        "follow": {"orbit": orbit, "name": "amplitude", "bounds": (0.45, 0.55)},
        "follow_all": {"orbits": [orbit], "name": "amplitude", "bounds": (0.45, 0.55)},
        "switch": {"special": branch.points("SB")[0], "bounds": (3.54, 3.55)},
        "extend": {"branch": branch, "bounds": (0.39, 3.6)},
        "load_branch": {"path": folder / "branch.nc"},
        "load_held_branch": {"path": missing},
        "scenario": {"special": of["grazing"]},
        "period_adding": {"special": of["grazing"]},
        "peaks": {"branch": branch},
        "peak": {"orbit": orbit},
        "sensitivity": {"special": of["fold"], "names": "frequency"},
        "search": {"scene": scene, "kinds": "GR", "free": free, "bounds": box, "starts": 4, "max_period": 1},
        "located": {"point": of["grazing"], "name": "amplitude", "wall": "right"},
        "hysteresis": {"first": of["fold"], "last": branch.points("SB")[0]},
        "margin": {"orbit": orbit, "free": free, "bounds": box, "directions": 2},
        "place": {"what": of["fold"], "name": "amplitude", "target": 0.5081, "free": {"damping": 0.1}},
        "fit": {"scene": scene, "data": of["impacts"], "free": free, "bounds": box},
        "record_from_physical": {"record": of["impacts"], "scene": of["rig"]},
        "locus": {"special": of["grazing"], **plane},
        "load_locus": {"path": missing},
        "family": {"special": of["grazing"], **plane, "third": "damping", "values": [0.05]},
        "explore": {"scene": scene, "name": "amplitude", "bounds": (0.45, 0.55), "max_period": 1, "budget": 1},
        "find_isolas": {"diagram": of["diagram"], "max_period": 1, "max_impacts": 1},
        "diagrams": {
            "scene": scene,
            "name": "amplitude",
            "bounds": (0.45, 0.55),
            "third": "damping",
            "values": [0.05],
            "max_period": 1,
            "budget": 1,
        },
        "load_diagram": {"folder": missing},
        "sweep": {**row, "state": state, "settle": 1, "keep": 1},
        "find_attractors": {"scene": scene, "starts": 4, "settle": 20},
        "spectrum": {**row, "state": state, "settle": 1, "most": 1024},
        "basins": {"scene": scene, "x": [-0.5, 0.5], "v": [0.0, 0.1], "attractors": of["attractors"], "patience": 100},
        "fractions": {**row, "starts": 4, "settle": 20},
        "manifold": {"orbit": branch.orbit(branch.data.sizes["point"] - 1), "kind": "stable", "length": 0.2},
        "map_parameters": {"scene": scene, "grid": {"amplitude": [0.4, 0.5]}, "settle": 20, "patience": 100},
        "load_store": {"path": missing},
        "least_shock": {"scene": scene, "attractors": of["attractors"], "reach": 0.1, "shocks": 64},
        "view": {"scene": scene},
        "run": {"path": folder / "scene.toml", "out": folder / "out", "force": True},
        "show": {"path": missing},
        "paper": {"names": ("no figure",), "out": folder / "paper"},
        "warm": {},
    }
    found |= {f"plot.{name}": given for name, given in pictures(of).items()}
    steady, spun = of["steady"], of["spun"]
    (hopf,) = spun.points("HB")
    orbits = shooting.periodic_orbits(circle)
    found |= {
        "co.equilibria": {"function": fold},
        "co.fixed_points": {"move": fold},
        "co.trace": {
            "system": co.equilibria(fold),
            "u": 0.9,
            "at": {"a": 0.5, "b": 0.3},
            "along": "a",
            "bounds": (0.4, 0.6),
        },
        "co.switch": {"special": hopf, "orbits": orbits, "bounds": {"m": (-0.01, 0.01)}},
        "co.curve": {
            "special": steady.points("SN")[0],
            "names": ("a", "b"),
            "bounds": {"a": (-0.4, -0.2), "b": (0.2, 0.4)},
        },
        "co.sensitivity": {"special": steady.points("SN")[0], "names": "b"},
        "co.save": {"branch": steady, "path": folder / "again.npz"},
        "co.load": {"path": folder / "steady.npz", "system": co.equilibria(fold)},
        "shooting.periodic_orbits": {"field": circle},
        "shooting.settled": {"system": orbits, "start": [1.0, 0.0], "period": 6.28, "at": {"m": 1.0}},
    }
    return found


def pictures(of):
    """{picture: arguments of a valid call}, but for some whose argument takes long to make."""
    branch, orbit, scene = of["branch"], of["orbit"], of["scene"]
    return {
        "branch": {"one": branch},
        "diagram": {"swept": of["swept"]},
        "mark": {"attractors": of["attractors"], "value": 0.5},
        "mark_orbits": {"orbits": [orbit], "value": 0.5},
        "mark_points": {"branches": [branch], "ax": plt.figure().subplots()},
        "orbit": {"one": orbit},
        "portrait": {"trajectory": of["trace"], "scene": scene},
        "trace": {"trajectory": of["trace"], "scene": scene},
    }


class Plain:
    """An object of no use."""


def endless():
    """A list that holds itself."""
    found = []
    found.append(found)
    return found


ERRORS = {
    "None": lambda: None,
    "True": lambda: True,
    "string": lambda: "x",
    "empty string": lambda: "",
    "null character": lambda: "a\0b",
    "bytes": lambda: b"amplitude",
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "negative": lambda: -1,
    "zero": lambda: 0,
    "fraction": lambda: 1.5,
    "huge int": lambda: 10**400,
    "large int": lambda: 2**63,
    "complex": lambda: 1j,
    "object": Plain,
    "class": lambda: Plain,
    "function": lambda: Plain.mro,
    "ellipsis": lambda: ...,
    "array": lambda: np.array([0.45, 0.5, 0.55]),
    "matrix": lambda: np.eye(2),
    "empty array": lambda: np.array([]),
    "0-d array": lambda: np.array(0.5),
    "jax array": lambda: jnp.array([0.45, 0.5]),
    "bool array": lambda: np.array([True, False]),
    "complex array": lambda: np.array([1j, 2.0]),
    "object array": lambda: np.array([None, "x"], object),
    "string array": lambda: np.array(["amplitude", "left"]),
    "nan array": lambda: np.array([0.5, np.nan]),
    "numpy string": lambda: np.str_("x"),
    "numpy datetime": lambda: np.datetime64("2020-01-01"),
    "empty set": set,
    "set": lambda: {"x"},
    "empty dict": dict,
    "dict": lambda: {"x": 1.0},
    "dict with int keys": lambda: {1: (0.0, 1.0)},
    "empty list": list,
    "list of None": lambda: [None],
    "list of strings": lambda: ["x", "y"],
    "ragged list": lambda: [[1.0], [1.0, 2.0]],
    "endless list": endless,
    "pair of strings": lambda: ("a", "b"),
    "pair of None": lambda: (None, None),
    "reversed pair": lambda: (2.0, 1.0),
    "nan pair": lambda: (float("nan"), 1.0),
    "complex pair": lambda: (0.0, 1j),
    "huge pair": lambda: (0, 10**400),
    "triple": lambda: (0.1, 0.5, 1.0),
    "generator": lambda: (one for one in (0.4, 0.5)),
    "iterator": lambda: iter("ab"),
    "scene": lambda: shared()["scene"],
    "batch of scenes": lambda: jv.make_scene(np.array([0.5, 0.6]), 2.1, 0.05, 0.7, (-1.0, 1.0)),
    "state": lambda: shared()["state"],
    "batch of states": lambda: jv.State(np.zeros(2), np.zeros(2)),
    "state of strings": lambda: jv.State("x", "y"),
    "state of nan": lambda: jv.State(float("nan"), 0.0),
    "orbit": lambda: shared()["orbit"],
    "branch": lambda: shared()["branch"],
    "dataset": lambda: xr.Dataset({"x": ("n", [1.0])}),
    "path": lambda: Path("no/such/file"),
    "wall": lambda: jv.Wall(1.0),
}
LONG = {("paper", "names"), ("warm", "scene"), ("warm", "progress")}  # a valid call of these takes minutes
OWN = {("shooting.settled", "args")}  # what a user's function is given: any value may be right, or an error of its own
ENTRIES = (dict, list, tuple, set, np.ndarray)  # an error may name an entry of these
PARTS = {"walls": {"left", "right", "length"}, "what": {"scene"}, "changes": {"scene"}}  # also named
CALLABLE = {"class", "function"}  # a progress= of these is called, and its errors are its own


def function_of(name):
    """The public function of a name in `bases`."""
    package, _, rest = name.rpartition(".")
    return getattr({"": jv, "plot": plot, "co": co, "shooting": shooting}[package], rest)


def table():
    """Every `Call`."""
    return [
        Call(name, argument, error)
        for name in bases()
        for argument in inspect.signature(function_of(name)).parameters
        for error in ERRORS
        if (name, argument) not in LONG | OWN and not (argument == "progress" and error in CALLABLE)
    ]


def drawn(count, seed=0):
    """So many calls of the table, at random; all arguments have one before any has two."""
    rng, calls, groups = np.random.default_rng(seed), table(), {}
    for place in rng.permutation(len(calls)):
        groups.setdefault(calls[place][:2], []).append(calls[place])
    rounds = [group[k] for k in range(len(ERRORS)) for group in groups.values() if k < len(group)]
    return rounds[:count]


@contextmanager
def limited(seconds):
    """TimeoutError after so many seconds in Python's own code."""

    def late(*_):
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def answer(name, given):
    """(result or exception, seconds) of a call."""
    begun, found = time.perf_counter(), None
    try:
        with limited(3 * SLOW), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = function_of(name)(**given)
    except Exception as error:
        found = error
    seconds = time.perf_counter() - begun
    if hasattr(found, "url"):
        Thread(target=found.stop).start()  # a page's server takes seconds to end
    plt.close("all")
    return found, seconds


@lru_cache
def base(name):
    """(arguments, message of the exception or "") of the valid call of a function; it compiles what the others use."""
    given = bases_once()[name]
    found, _ = answer(name, given)
    return given, str(found) if isinstance(found, Exception) else ""


@lru_cache
def bases_once():
    """`bases`, made once."""
    return bases()


def outcome(call):
    """The `Outcome` of a call."""
    given, usual = base(call.function)
    value = ERRORS[call.error]()
    found, seconds = answer(call.function, given | {call.argument: value})
    refused, fault = isinstance(found, REFUSED), ""
    if not isinstance(found, Exception) or str(found) == usual or isinstance(found, jv.OrbitError):
        fault = f"took {seconds:.1f} s" if seconds > SLOW else ""
    elif refused:
        fault = named(found, call, value, given)
    elif not (isinstance(found, OSError) and isinstance(value, str | os.PathLike)) or isinstance(found, TimeoutError):
        fault = f"{type(found).__name__}: {found}"
    return Outcome(" ".join(fault.split())[:160], refused, seconds)


def named(error, call, value, given):
    """What is missing in the message of a refusal: the argument, the rule or the value. The name of a parameter, and
    that of a picture, stand for the argument."""
    told, key = str(error), str(error.key)
    stands = {call.argument, call.function, str(value)[:80]}
    stands |= {each for each in given.values() if isinstance(each, str)}
    stands |= {"state"} if isinstance(value, jv.State) else set()  # its entries are named by themselves
    stands |= {str(each)[:80] for each in value} if isinstance(value, ENTRIES) and getattr(value, "ndim", 1) else set()
    stands |= PARTS.get(call.argument, set())
    if not (key in stands or key.replace("[", ".").split(".")[0] in stands or call.argument in told):
        return f"names {key}: {told}"
    return "" if "; got " in told and error.rule else f"has no value: {told}"
