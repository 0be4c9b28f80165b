"""Functions whose modules and programs tests keep in a cache folder, and damage to its files."""

from contextlib import contextmanager
from functools import wraps
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from continuation.hostcall import persistent_jit
from continuation.hostcall.host_jit import HostFunction

FOLDER = "modules"  # of the package's own files, in JAX's cache folder
DIGEST = 32  # bytes at the begin of a file
GIVEN = np.linspace(0.1, 2.0, 5)
TRUE = np.sin(GIVEN), GIVEN * np.exp(-GIVEN)


class Waves(NamedTuple):
    """A result with a form."""

    sine: jax.Array
    product: jax.Array


def waves(x):
    return Waves(jnp.sin(x), x * jnp.exp(-x))


def other_waves(x):
    return Waves(jnp.cos(x), x * jnp.exp(x))


def evaluated(function=waves):
    """Return a function's values by its program, as a new process computes them."""
    return [np.asarray(each) for each in persistent_jit(numpy_first=True)(function)(GIVEN)]


def compiled(function=waves):
    """Return the same by its module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("continuation.hostcall.host_jit.max_evaluations", 0)
        return evaluated(function)


def host_function(function, static=()):
    """Return a function as the host calls it, without a place among the stored ones."""

    @wraps(function)
    def call(*given):
        return function(*given)

    return HostFunction(jax.jit(function, static_argnums=static), call, {"static_argnums": static})


def in_numpy(function, *given):
    """Return a function's values by its program; None if it has none, so that it would be compiled."""
    program, tree = host_function(function).find_program(given)
    if program is None:
        return None
    with np.errstate(all="ignore"):
        results, _ = program.run(*[np.asarray(leaf)[()] for leaf in jax.tree.leaves(given)])
    return jax.tree.unflatten(tree, results)


def require_right(values):
    for computed, true in zip(values, TRUE, strict=True):
        np.testing.assert_allclose(computed, true, rtol=1e-14)


@contextmanager
def separate_cache(folder):
    """Let JAX keep its compile cache in a new folder."""
    before = jax.config.jax_compilation_cache_dir
    folder.mkdir(mode=0o700)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    try:
        yield folder
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def own_files(cache):
    """Return the files of the package's own, by the ends of their names."""
    return {path.suffix: path for path in sorted(cache.glob(f"{FOLDER}/*/*"))}


def flipped(content, place):
    """Return bytes with one bit flipped, counted from the first byte's lowest."""
    byte, bit = divmod(place, 8)
    return content[:byte] + bytes([content[byte] ^ 1 << bit]) + content[byte + 1 :]
