"""Arguments that cannot be: every public function refuses them with one error, whatever they are."""

import inspect

import jax.numpy as jnp
import numpy as np
import pytest

import continuation as co
import jaxvibro as jv
from continuation.argument_checks import argument_type, argument_types_of

from .invalid_calls import FUNCTIONS, REFUSED, fold, plain_values

BY_HAND = {"make_scene", "scene_from_physical"}  # their rules for a scene's quantities are in `scene.check`
ANYTHING = {"dtype", "args", "colour"}  # arguments of which any object may be one; the function checks them


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in BY_HAND])
def test_every_argument_is_checked_against_its_annotation(name):
    """Of pictures those arguments are checked that have a default."""
    function, refused = inspect.unwrap(FUNCTIONS[name], stop=lambda one: one.__code__.co_name == "wrapper"), 0
    kinds = argument_types_of(function)
    for argument, parameter in inspect.signature(function).parameters.items():
        if argument in ANYTHING or (name.startswith("plot.") and parameter.default is parameter.empty):
            continue
        assert argument in kinds, f"{argument} has no kind"
        for value in plain_values():
            if kinds[argument].accepts(value):
                continue
            with pytest.raises(REFUSED, match=f"(?s)^{argument}[^:]*: must be .*; got ") as told:
                function(**{argument: value})
            assert len(str(told.value)) <= 300 and "\n" not in str(told.value), str(value)
            refused += 1
    assert refused or name.startswith("plot.")


def steady_fold():
    branch = co.trace(co.equilibria(fold), 0.9, {"a": 0.5, "b": 0.3}, "a", (-1.0, 1.0))
    return branch.points("SN")[0]


NAMED = {
    "entry of free": (
        lambda: jv.margin(jv.Orbit.__new__(jv.Orbit), {"amplitude": 1.0, "damping": "x"}),
        r"free\.damping: must be a real number; got 'x'",
    ),
    "entry of orbits": (
        lambda: jv.follow_all([jv.Orbit.__new__(jv.Orbit), 3], "amplitude", (0.0, 1.0)),
        r"orbits\[1\]: must be an Orbit; got 3",
    ),
    "entry of bounds": (
        lambda: jv.search(jv.make_scene(0.5, 2.1, 0.05, 0.7, (-1.0, 1.0)), "SN", {"damping": 1.0}, {"damping": "x"}),
        r"bounds\.damping: must be a sequence of real numbers",
    ),
    "entry of walls": (
        lambda: jv.scene_from_physical(1.0, 0.1, 9.0, 1.0, 2.0, 0.7, np.array([None, {}], dtype=object)),
        r"right\.position: must be .*; got ",
    ),
    "bounds of a curve": (
        lambda: co.curve(steady_fold(), ("a", "b"), (0.0, 1.0)),
        r"bounds: must be a mapping from strings to .*numbers",
    ),
    "no names": (
        lambda: co.sensitivity(steady_fold(), set()),
        r"names: must be one or more different parameters other than a; got \(\)",
    ),
}


@pytest.mark.parametrize("name", NAMED)
def test_the_error_names_the_entry_and_the_rule(name):
    call, told = NAMED[name]
    with pytest.raises(REFUSED, match=told):
        call()


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
