"""Arguments that cannot be: every public function refuses them with one error, whatever they are."""

import inspect

import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
import jaxvibro as jv
from continuation import shooting
from continuation.argument_checks import argument_type, argument_types_of
from jaxvibro import plot
from tests import invalid_calls

SCENE, STATE = jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.0, 0.0)
PACKAGES = ((jv, ""), (plot, "plot."), (co, "co."))
FUNCTIONS = {
    mark + name: getattr(package, name)
    for package, mark in PACKAGES
    for name in package.__all__
    if inspect.isfunction(getattr(package, name))
}
FUNCTIONS |= {f"shooting.{name}": getattr(shooting, name) for name in ("periodic_orbits", "settled")}
BY_HAND = {"make_scene", "scene_from_physical"}  # their rules for a scene's quantities are in `scene.check`
ANYTHING = {"dtype", "args"}  # arguments of which any object may be one; the function checks them
VALUES = {name: make for name, make in invalid_calls.ERRORS.items() if name not in ("orbit", "branch", "dataset")}


def checked_by_annotation(name, parameter):
    """Whether the decorator checks a parameter: of pictures those with a default."""
    return not name.startswith("plot.") or parameter.default is not parameter.empty


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in BY_HAND])
def test_every_argument_is_checked_against_its_annotation(name):
    function = inspect.unwrap(FUNCTIONS[name], stop=lambda one: one.__code__.co_name == "wrapper")
    refused = 0
    kinds = argument_types_of(function)
    for argument, parameter in inspect.signature(function).parameters.items():
        if argument in ANYTHING or not checked_by_annotation(name, parameter):
            continue
        assert argument in kinds, f"{argument} has no kind"
        for error, make in VALUES.items():
            value = make()
            if kinds[argument].accepts(value) or argument == "colour":
                continue
            with pytest.raises(invalid_calls.REFUSED, match=f"(?s)^{argument}[^:]*: must be .*; got ") as told:
                function(**{argument: value})
            assert len(str(told.value)) <= 300 and "\n" not in str(told.value), error
            refused += 1
    assert refused or name.startswith("plot.")


def test_an_entry_that_is_wrong_is_named():
    orbit = jv.Orbit.__new__(jv.Orbit)
    for call, told in (
        (
            lambda: jv.margin(orbit, {"amplitude": 1.0, "damping": "x"}),
            r"free\.damping: must be a real number; got 'x'",
        ),
        (lambda: jv.follow_all([orbit, 3], "amplitude", (0.0, 1.0)), r"orbits\[1\]: must be an Orbit; got 3"),
        (
            lambda: jv.search(SCENE, "SN", {"damping": 1.0}, {"damping": "x"}),
            r"bounds\.damping: must be a sequence of real numbers",
        ),
    ):
        with pytest.raises(jv.ArgumentError, match=told):
            call()


ORBIT = jv.Orbit.__new__(jv.Orbit)
RAW = {
    "return_map side": (lambda: jv.return_map(SCENE, np.array([1.0, 2.0]), 0.3, -1.0), "side"),
    "map_parameters along": (lambda: jv.map_parameters(SCENE, {"amplitude": [1.0]}, along=np.ones(2)), "along"),
    "find_orbit periods": (lambda: jv.find_orbit(SCENE, STATE, periods=np.ones(2)), "periods"),
    "least_shock direction": (lambda: jv.least_shock(SCENE, direction=np.ones(2)), "direction"),
    "strobe slots": (lambda: jv.strobe(SCENE, STATE, slots=np.array([])), "slots"),
    "follow step": (lambda: jv.follow(ORBIT, "amplitude", (0.0, 1.0), largest_step="x"), "largest_step"),
    "search set": (lambda: jv.search(SCENE, "SN", {"amplitude": 1.0}, set()), "bounds"),
    "search 0": (lambda: jv.search(SCENE, "SN", {"amplitude": 1.0}, 0), "bounds"),
    "least_shock attractors": (lambda: jv.least_shock(SCENE, attractors="x"), "attractors"),
    "margin kinds": (lambda: jv.margin(ORBIT, {"amplitude": 1.0}, kinds=np.ones(2)), "kinds"),
    "place target": (lambda: jv.place(lambda scene: 0.0, None, set(), {"damping": 0.1}, scene=SCENE), "target"),
    "load branch": (lambda: jv.load_branch(3), "path"),
    "load scene": (lambda: jv.load_scene(np.ones(2)), "path"),
    "load data": (lambda: jv.load_data(None), "path"),
    "load store": (lambda: jv.load_store({"x"}), "path"),
    "load null": (lambda: jv.load_locus("a\0b"), "path"),
    "load diagram": (lambda: jv.load_diagram(b"x"), "folder"),
    "physical walls": (
        lambda: jv.scene_from_physical(1.0, 0.1, 9.0, 1.0, 2.0, 0.7, np.array([None, {}], dtype=object)),
        "right.position",
    ),
    "co symmetry": (lambda: co.equilibria(lambda u, p, args: u, symmetry=np.eye(2)), "symmetry"),
    "co load": (lambda: co.load(3, co.equilibria(lambda u, p, args: u)), "path"),
}


@pytest.mark.parametrize("name", RAW)
def test_no_other_error_comes_through(name):
    call, key = RAW[name]
    with pytest.raises(invalid_calls.REFUSED, match=rf"^{key}: must be .*; got "):
        call()


def test_bounds_of_continuation_are_by_name():
    branch = co.trace(co.equilibria(invalid_calls.fold), 0.9, {"a": 0.5, "b": 0.3}, "a", (-1.0, 1.0))
    (point,) = branch.points("SN")
    for call in (lambda: co.curve(point, ("a", "b"), (0.0, 1.0)), lambda: co.switch(point, bounds=(0.0, 1.0))):
        with pytest.raises(co.ContinuationError, match=r"bounds: must be a mapping from strings to .*numbers"):
            call()
    with pytest.raises(
        co.ContinuationError, match=r"names: must be one or more different parameters other than a; got \(\)"
    ):
        co.sensitivity(point, set())


@pytest.mark.parametrize(
    ("hint", "right", "wrong"),
    [
        (int, [0, -3, np.int8(2), 10**400], [True, 1.0, np.array(1), "1", None]),
        (float, [0, 1.5, np.float32(1), np.array(0.5), jnp.asarray(2.0)], [True, "1", 1j, 10**400, np.ones(1), None]),
        (str, ["", np.str_("a")], [b"a", None, 1, ["a"]]),
        (bool, [True, np.bool_(False)], [0, 1, None, "True"]),
        (tuple[float, float], [(0, 1.0), [1, 2], np.ones(2)], [(1, 2, 3), {1, 2}, "ab", (None, 1.0), {1: 2, 3: 4}, 5]),
        (tuple[str, ...], [(), ["a"], ("a", "b"), {"a"}], ["a", ["a", 1], {"a": 1}, b"a", iter("a")]),
        (dict[str, float] | None, [None], []),
    ],
)
def test_kinds(hint, right, wrong):
    kind = argument_type(hint)
    assert [value for value in right if not kind.accepts(value)] == []
    assert [value for value in wrong if kind.accepts(value)] == []
