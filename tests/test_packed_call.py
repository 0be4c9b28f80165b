"""Numbers handed over in one array of each type, and results fetched likewise, are what they are one by one."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from continuation import numpy_evaluation
from continuation.packed_call import ArrayLayout, PackedCall
from continuation.persistent_jit import persistent_jit

rng = np.random.default_rng(5)
MIXED = [
    rng.normal(size=(3, 2)),
    np.float64(0.25),
    np.int32(7),
    np.arange(4),
    np.zeros((0, 3)),
    np.array([True, False]),
    np.float32(1.5),
    rng.normal(size=5),
    jnp.linspace(0.0, 1.0, 3),
]


def test_arrays_come_back_from_their_rows():
    layout = ArrayLayout(MIXED)
    rows = layout.rows(MIXED)
    assert sorted(row.dtype.name for row in rows) == ["bool", "float32", "float64", "int32", "int64"]
    for found in (layout.arrays(rows), layout.unpack_traced_arrays([jnp.asarray(row) for row in rows])):
        for one, given in zip(found, MIXED, strict=True):
            assert one.shape == np.shape(given) and one.dtype == given.dtype
            np.testing.assert_array_equal(one, given)
    for one, other in zip(layout.pack_traced_rows([jnp.asarray(each) for each in MIXED]), rows, strict=True):
        np.testing.assert_array_equal(one, other)


def everything(table, share, count, places, none, mask, single, row, more, weak):
    return {"sum": table.sum() * share + count, "rest": (places[mask.sum()] * weak, none, ~mask, None)}, row[::-1], more


def test_results_are_those_of_jit():
    given = [*MIXED, 3]
    found, expected = PackedCall(everything, given, {})(given), jax.jit(everything)(*given)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert isinstance(one, np.ndarray) and (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_array_equal(one, other)


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


@persistent_jit(static_argnums=1, numpy_first=True)
def turned(pair, times, by):
    return Pair(jnp.roll(pair.second, times), by * pair.first)


@pytest.mark.parametrize("patience", [np.inf, 0])
def test_calls_of_other_kinds_are_told_apart(patience, monkeypatch):
    """Of another length, type, static argument or form; with a number of the host's own; and under transformations."""
    monkeypatch.setattr(numpy_evaluation, "MAX_EVALUATIONS", patience)
    for size, kind in ((3, float), (5, float), (3, np.float32), (3, np.int32)):
        one, two = np.arange(size).astype(kind), np.ones(size, kind)
        for times in (1, 2):
            for by in (2, np.int32(2), np.array([2] * size, np.int32)):
                found = turned(Pair(one, two + one), times, by)
                np.testing.assert_array_equal(found.first, np.roll(two + one, times))
                np.testing.assert_array_equal(found.second, 2 * one)
                assert found.second.dtype == jnp.asarray(by * jnp.asarray(one)).dtype
    slope = jax.grad(lambda x: turned(Pair(x * np.ones(3), np.ones(3)), 1, 2.0).second.sum())(1.0)
    assert slope == 6.0
