"""Functions whose modules and programs tests keep in a cache folder."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from continuation import numpy_evaluation
from continuation.persistent_jit import persistent_jit

GIVEN = np.linspace(0.1, 2.0, 5)


class Waves(NamedTuple):
    """A result with a form."""

    sine: jax.Array
    product: jax.Array


def waves(x):
    return Waves(jnp.sin(x), x * jnp.exp(-x))


def other_waves(x):
    return Waves(jnp.cos(x), x * jnp.exp(x))


def evaluated(function=waves):
    """A function's values by its program, as a new process has them."""
    return [np.asarray(each) for each in persistent_jit(function, numpy_first=True)(GIVEN)]


def compiled(function=waves):
    """The same by its module."""
    before, numpy_evaluation.MAX_EVALUATIONS = numpy_evaluation.MAX_EVALUATIONS, 0
    try:
        return evaluated(function)
    finally:
        numpy_evaluation.MAX_EVALUATIONS = before
