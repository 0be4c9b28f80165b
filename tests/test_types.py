"""Types: every record and the whole public face are annotated, and `checked_types` finds what does not keep to it."""

import inspect
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, get_args, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

import continuation as co
import jaxvibro as jv
from continuation.array_type import Array

from . import checked_types
from .test_architecture import FILES, name

PUBLIC = [getattr(jv, one) for one in jv.__all__ if one not in ("__version__", "plot")]
PUBLIC += [getattr(package, one) for package in (co, jv.plot) for one in package.__all__]


def missing(function, own=""):
    """What of a function has no annotation."""
    signature = inspect.signature(function)
    left = [one.name for one in signature.parameters.values() if one.annotation is one.empty and one.name != own]
    return left + (["return"] if signature.return_annotation is signature.empty else [])


@pytest.mark.parametrize("one", PUBLIC, ids=lambda one: f"{one.__module__}.{one.__name__}")
def test_the_public_face_has_types(one):
    if not inspect.isclass(one):
        assert missing(one) == []
        return
    for field, part in inspect.getmembers(one):
        part = part.fget if isinstance(part, property) else getattr(part, "func", part)
        if not field.startswith("_") and inspect.isfunction(part) and part.__module__.split(".")[0] == "jaxvibro":
            assert missing(part, "self") == [], field


def bare(hint):
    """Whether a type says of an array no shape, or of a collection not what is in it."""
    return hint in (np.ndarray, jax.Array, tuple, list, dict) or any(bare(one) for one in get_args(hint))


@pytest.mark.parametrize("path", [one for one in FILES if one.name != "__main__.py"], ids=name)
def test_records_have_types_with_shapes(path):
    module = import_module(name(path))
    for one in vars(module).values():
        if checked_types.is_record(one) and one.__module__ == module.__name__:
            hints = get_type_hints(one, include_extras=True)
            assert {field: hint for field, hint in hints.items() if bare(hint)} == {}, one.__name__
            for field, part in inspect.getmembers(one):
                part = part.fget if isinstance(part, property) else getattr(part, "func", part)
                ours = inspect.isfunction(part) and part.__module__.split(".")[0] in checked_types.PACKAGES
                if ours and not field.startswith("_"):
                    assert missing(part, "self") == [], (one.__name__, field)


def test_checker_and_packages_say_that_they_are_typed():
    for package in checked_types.PACKAGES:
        assert (Path(import_module(package).__file__).parent / "py.typed").exists()


class Pair(NamedTuple):
    """Two rows of one length."""

    one: Float[Array, " rows"]
    other: Float[Array, " rows"]


def test_what_does_not_keep_to_its_type_is_found(monkeypatch):
    monkeypatch.setattr(checked_types, "PACKAGES", ("tests",))
    monkeypatch.setattr(Pair, "__new__", Pair.__new__)
    checked_types.check_record(Pair)
    three = np.zeros(3)
    assert Pair(three, jnp.ones(3)).one is three
    with pytest.raises(TypeError, match="other"):
        Pair(three, np.zeros(2))
    with pytest.raises(TypeError, match="one"):
        Pair(np.zeros(3, int), three)
    assert len(jax.tree.map(lambda leaf: leaf[:, None], Pair(three, three)).one) == 3


def half(number: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    return number / 2


def refuse(number: float) -> int:
    """Raises ValueError."""
    if isinstance(number, str):
        raise ValueError("must be a number")
    return number


def test_functions_are_held_to_their_types():
    assert checked_types.checked(half)(np.ones(2))[0] == 0.5
    with pytest.raises(TypeError, match="rows"):
        checked_types.checked(half)(np.ones((2, 2)))
    with pytest.raises(ValueError, match="must be a number"):
        checked_types.checked(refuse)("a")
    with pytest.raises(TypeError, match="return"):
        checked_types.checked(refuse)(1.5)


def test_of_many_calls_some_are_held():
    function, kept = checked_types.checked(half), 0
    for _ in range(checked_types.FIRST):
        with pytest.raises(TypeError, match="rows"):
            function(np.ones((2, 2)))
    for _ in range(2 * checked_types.EVERY):
        try:
            function(np.ones((2, 2)))
        except TypeError:
            kept += 1
    assert kept == 2
