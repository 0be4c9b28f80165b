"""Loops as one kernel hold what XLA would call a library for, too: they are compiled as they are then."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxvibro.compiled.kernel_calls import call_as_kernel

ROWS = 64
ONES = np.ones(3)
KINDS = {
    "largest": lambda lib, a: lib.max(a, -1, keepdims=True),
    "least": lambda lib, a: lib.min(a, 0, keepdims=True),
    "sum": lambda lib, a: lib.sum(a) / a.size,
    "product of matrices": lambda lib, a: (a @ a.T) @ a / a.size,
    "product of lanes": lambda lib, a: lib.einsum("ij,ij->i", a, a)[:, None] / a.size,
    "product with a vector": lambda lib, a: (a[:, :3] @ ONES)[:, None],
}


@pytest.mark.parametrize("columns", [3, 7, 64, 80])
@pytest.mark.parametrize("kind", KINDS)
def test_reductions_and_products_of_any_size(kind, columns):
    function = KINDS[kind]

    def turned(values):
        def turn(carry):
            count, a = carry
            return count + 1, jnp.cos(a + function(jnp, a))

        return lax.while_loop(lambda carry: carry[0] < 3, turn, (0, values))[1]

    start = np.random.default_rng(0).normal(size=(ROWS, columns))
    expected = start
    for _ in range(3):
        expected = np.cos(expected + function(np, expected))
    found = jax.jit(lambda values: call_as_kernel(turned, values))(start)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13)
