"""Types: records and the public API are annotated, and `checked_types` notices values that differ from them."""

import inspect
from importlib import import_module
from typing import NamedTuple, get_args, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

import continuation as co
import jaxvibro as jv

from . import checked_types
from .sources import MODULES, ROOT

PUBLIC = [getattr(jv, name) for name in jv.__all__ if name not in ("__version__", "plot")]
PUBLIC += [getattr(package, name) for package in (co, jv.plot) for name in package.__all__]


def untyped(value, own=""):
    """Return the parameters without annotation of a function, or of the public methods of a class."""
    if inspect.isclass(value):
        members = [(name, part) for name, part in inspect.getmembers(value) if not name.startswith("_")]
        plain = [(name, getattr(part, "fget", None) or getattr(part, "func", part)) for name, part in members]
        methods = [(name, part) for name, part in plain if inspect.isfunction(part)]
        ours = [row for row in methods if row[1].__module__.split(".")[0] in (*checked_types.PACKAGES, "tests")]
        return [f"{value.__name__}.{name}: {row}" for name, part in ours for row in untyped(part, "self")]
    signature = inspect.signature(value)
    missing = [part.name for part in signature.parameters.values() if part.annotation is part.empty]
    return [name for name in missing if name != own] + ["return"] * (signature.return_annotation is signature.empty)


def is_bare(hint):
    """Return whether a type gives no shape of an array, or no types of the items of a collection."""
    return hint in (np.ndarray, jax.Array, tuple, list, dict) or any(map(is_bare, get_args(hint)))


def bare_fields(record):
    """Return the fields of a record with a bare type."""
    return [name for name, hint in get_type_hints(record, include_extras=True).items() if is_bare(hint)]


class Pair(NamedTuple):
    """Two rows of one length."""

    first: Float[jax.Array | np.ndarray, " rows"]
    second: Float[jax.Array | np.ndarray, " rows"]

    def total(self, axis):
        """Return the sum."""


class Bare(NamedTuple):
    """A record without shapes."""

    values: np.ndarray
    names: dict[str, list]


def test_the_public_api_has_types():
    assert {str(value): untyped(value) for value in PUBLIC if untyped(value)} == {}
    assert untyped(Pair) == ["Pair.total: axis", "Pair.total: return"]
    assert [name for name in checked_types.PACKAGES if not (ROOT / name / "py.typed").exists()] == []


def test_records_have_types_with_shapes():
    modules = [import_module(name) for name in MODULES if not name.endswith("__main__")]
    own = [value for module in modules for value in vars(module).values() if checked_types.is_record(value)]
    records = {value for value in own if value.__module__ in MODULES}
    wrong = {record.__qualname__: [*bare_fields(record), *untyped(record)] for record in records}
    assert len(records) > 100 and {name: row for name, row in wrong.items() if row} == {}
    assert bare_fields(Bare) == ["values", "names"]


def test_a_record_with_a_wrong_field_is_noticed(monkeypatch):
    monkeypatch.setattr(checked_types, "PACKAGES", ("tests",))
    monkeypatch.setattr(Pair, "__new__", Pair.__new__)
    monkeypatch.setattr(Pair, "total", Pair.total)
    checked_types.check_record(Pair)
    three = np.zeros(3)
    assert Pair(three, jnp.ones(3)).first is three
    with pytest.raises(TypeError, match="second"):
        Pair(three, np.zeros(2))
    with pytest.raises(TypeError, match="first"):
        Pair(np.zeros(3, int), three)
    assert len(jax.tree.map(lambda leaf: leaf[:, None], Pair(three, three)).first) == 3


def half(number: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    return number / 2


def refuse(number: float) -> int:
    """Raises ValueError."""
    if isinstance(number, str):
        raise ValueError("must be a number")
    return number


def test_functions_are_held_to_their_types():
    assert checked_types.checked(half)(np.ones(2))[0] == 0.5
    for function, argument, error, text in (
        (half, np.ones((2, 2)), TypeError, "rows"),
        (refuse, "a", ValueError, "must be a number"),
        (refuse, 1.5, TypeError, "return"),
    ):
        with pytest.raises(error, match=text):
            checked_types.checked(function)(argument)


def test_the_first_calls_are_checked_and_then_some():
    function, calls = checked_types.checked(half), range(checked_types.FIRST + 2 * checked_types.EVERY)
    refused = []
    for call in calls:
        try:
            function(np.ones((2, 2)))
        except TypeError:
            refused.append(call)
    assert refused == [call for call in calls if call < checked_types.FIRST or call % checked_types.EVERY == 0]
    assert 100 < len(refused) < len(calls)
