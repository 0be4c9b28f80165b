"""A program's text says all of it: what is read again gives the same bits; what no text holds is not kept."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from continuation import jaxpr_to_python
from continuation.numpy_gather_scatter import NoRuleError
from continuation.python_literals import literal_text

TABLE = np.random.default_rng(3).normal(size=(9, 7))


def rows(x, k):
    """Arrays beyond sixteen numbers, a table, an index that is known late, loops, a choice, infinities."""
    y = jnp.asarray(TABLE) @ x
    y = lax.fori_loop(0, 3, lambda turn, y: y.at[turn].add(y[k]) * 0.5, y)
    wide = jnp.sort(jnp.tile(y, 3)).reshape(3, 9)[:, ::-1]
    found = jnp.where(wide[k] > 0.0, wide[0], -jnp.inf)
    found = lax.cond(k > 1, lambda z: z + 1.0, lambda z: z * 0.5, found)
    return found, jnp.take(wide, jnp.array([5, 99, k]), axis=1, mode="fill"), wide.astype(np.int32)


def kept(text):
    return jaxpr_to_python.load_program(jaxpr_to_python.compile_program_text(text))


def constant(text):
    """The value of a literal in a program that is read."""
    return kept(f"size = 1\ndef run():\n    return [{text}], 1").run()[0][0]


@pytest.mark.parametrize("k", (0, 2))
def test_a_program_that_is_read_gives_the_same_bits(k):
    given = np.arange(7.0) - 3.2, np.int64(k)
    program = jaxpr_to_python.build_program(jax.jit(rows).trace(*given).jaxpr)
    again = kept(program.text)
    assert again.size == program.size
    (one, spent), (other, same) = program.run(*given), again.run(*given)
    assert spent == same
    for first, second, true in zip(one, other, jax.jit(rows)(*given), strict=True):
        assert first.dtype == second.dtype == true.dtype
        np.testing.assert_array_equal(first, second)
        np.testing.assert_allclose(first, true, rtol=1e-13, atol=1e-14)


def test_what_no_text_holds_is_not_kept():
    class Odd(int):
        pass

    with pytest.raises(NoRuleError):
        literal_text((1, Odd(2)))
    with pytest.raises(NoRuleError):
        literal_text(np.array([1j]))
    plain = jaxpr_to_python.literal_text
    given = (np.arange(7.0), np.int64(1))
    closed = jax.jit(rows).trace(*given).jaxpr

    def refused(value):
        if isinstance(value, np.ndarray):
            raise NoRuleError(value)
        return plain(value)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jaxpr_to_python, "literal_text", refused)
        program = jaxpr_to_python.build_program(closed)
    assert program.text is None
    for one, true in zip(program.run(*given)[0], jaxpr_to_python.build_program(closed).run(*given)[0], strict=True):
        np.testing.assert_array_equal(one, true)


@pytest.mark.parametrize(
    "value",
    (
        np.array([[0.1, -0.0], [np.inf, 5e-324]]),
        np.zeros((0, 3), np.int32),
        np.float32(0.1),
        np.array([True, False]),
        (1, (None, "a'b"), 2.5),
        lax.GatherDimensionNumbers((0,), (1,), (0,), (), ()),
        lax.GatherScatterMode.CLIP,
        np.dtype(bool),
    ),
)
def test_a_literal_is_its_value(value):
    found = constant(literal_text(value))
    assert type(found) is type(value)
    if isinstance(value, np.ndarray | np.generic):
        assert found.dtype == value.dtype and found.shape == value.shape and found.tobytes() == value.tobytes()
    else:
        assert found == value


def test_nan_is_written():
    assert np.isnan(constant(literal_text(np.array([np.nan]))))


def test_the_same_rule_is_named_once():
    def twice(x):
        return jnp.concatenate([lax.slice(x, (1,), (20,)), lax.slice(x * 2.0, (1,), (20,))])

    text = jaxpr_to_python.build_program(jax.jit(twice).trace(np.arange(30.0)).jaxpr).text
    assert text.count("rules['slice']") == 1
