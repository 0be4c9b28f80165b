"""Modules kept between processes: read without tracing, equal in their numbers, and never in the way."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from continuation import augmented_systems, persistent_jit
from continuation.problem import SystemConstants, equilibria, make_problem
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS
from jaxvibro.maps.strobe import _two_tier_strobe

ROOT = Path(__file__).parents[1]
# A package of its own, so that its source can change.
TOY = """
from typing import NamedTuple
import jax, jax.numpy as jnp, numpy as np
from continuation.persistent_jit import persistent_jit
traced = []

class Pair(NamedTuple):
    sine: jax.Array
    rest: tuple

def twice(x):
    return 2.0 * x

@persistent_jit(static_argnames="how")
def waves(x, how):
    traced.append(1)
    return Pair(jnp.sin(x), (how(x), None))
"""
CALL = """
import sys, numpy as np, jax, toy
own = sys.argv[1] == "own"
for k in range(2):
    found = toy.waves(np.linspace(0.0, 1.0, 5), how=(lambda x: 2.0 * x) if own else toy.twice)
assert isinstance(found, toy.Pair) and found.rest[1] is None
print(len(toy.traced), np.asarray(found.sine).tobytes().hex(), np.asarray(found.rest[0]).tobytes().hex())
"""


@pytest.fixture
def toy(tmp_path):
    """Runs the toy in a process of its own: how often its body was traced, and its numbers."""
    (tmp_path / "toy.py").write_text(TOY)

    def run(how="ours", cached=True):
        paths = os.pathsep.join([str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")])
        given = os.environ | {"PYTHONPATH": paths, "JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu"}
        given.pop("JAX_COMPILATION_CACHE_DIR", None)
        given["PYTHONDONTWRITEBYTECODE"] = "1"  # a source of the same length and second would be taken for the old one
        if cached:
            given["JAX_COMPILATION_CACHE_DIR"] = str(tmp_path / "cache")
        done = subprocess.run([sys.executable, "-c", CALL, how], env=given, capture_output=True, text=True, check=True)
        count, *numbers = done.stdout.split()
        return int(count), numbers

    run.source, run.modules = (
        tmp_path / "toy.py",
        lambda: sorted((tmp_path / "cache" / persistent_jit.FOLDER).glob("*/*")),
    )
    return run


def test_the_next_process_does_not_trace(toy):
    first, second, without = toy(), toy(), toy(cached=False)
    assert (first[0], second[0], without[0]) == (1, 0, 1)
    assert first[1] == second[1] == without[1]
    (module,) = toy.modules()
    assert module.stat().st_mode & 0o077 == 0 and module.parent.stat().st_mode & 0o077 == 0


def test_another_source_is_traced_and_old_ones_go(toy):
    toy()
    for k in range(persistent_jit.MAX_GENERATIONS):
        toy.source.write_text(TOY.replace("2.0 * x", f"{3 + k}.0 * x"))
        count, numbers = toy()
        assert count == 1
        assert np.allclose(np.frombuffer(bytes.fromhex(numbers[1])), (3.0 + k) * np.linspace(0.0, 1.0, 5))
    assert len(toy.modules()) == persistent_jit.MAX_GENERATIONS


@pytest.mark.parametrize(
    "content", [*(pytest.param(each, marks=pytest.mark.slow) for each in (b"", b"nothing of ours", "cut")), "changed"]
)
def test_a_damaged_file_is_written_anew(toy, content):
    toy()
    (module,) = toy.modules()
    whole = module.read_bytes()
    damaged = {"cut": whole[:-7], "changed": whole[:-7] + bytes([whole[-7] ^ 1]) + whole[-6:]}.get(content, content)
    module.write_bytes(damaged)
    assert toy()[0] == 1
    assert toy()[0] == 0


def test_a_users_function_is_not_kept(toy):
    assert toy("own")[0] == 2  # each of its functions is another
    assert toy.modules() == []


@pytest.fixture
def cache(tmp_path):
    """jax's compile cache in a folder of its own."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.mark.parametrize("fails", [False, True])
def test_numbers(cache, fails):
    """One strobe by its module, or without where the folder cannot be made, to the same numbers."""
    if fails:
        (cache / persistent_jit.FOLDER).write_text("a file in its place")
    scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
    state, slots = jv.State(*(jnp.asarray(each, float) for each in (0.9, -1.1, 0.0, 0.0))), 5 + fails
    found = _two_tier_strobe(scene, state, 1, slots, False)
    assert len(list((cache / persistent_jit.FOLDER).glob("*/*"))) == (0 if fails else 1)
    plain = jax.jit(_two_tier_strobe.__wrapped__, static_argnums=(2, 3, 4), compiler_options=COMPILER_OPTIONS)(
        scene, state, 1, slots, False
    )
    for one, two in zip(jax.tree.leaves(found), jax.tree.leaves(plain), strict=True):
        np.testing.assert_array_equal(one, two)
    lanes = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), state)
    under = jax.vmap(lambda state: _two_tier_strobe(scene, state, 1, slots, False)[0].x)(lanes)
    np.testing.assert_allclose(under, float(found[0].x), rtol=1e-14)


def test_under_transformations(cache):
    """A module has no derivative and no lanes: the function itself is called."""
    circle = make_problem(equilibria(lambda u, p, args: u * u + p["p"] ** 2 - 1.0), ("p",))
    given, z = SystemConstants({}, None), jnp.array([0.6, 0.8])
    value, slopes = augmented_systems.evaluate_problem(circle, z, given)
    zs = jnp.stack([z, 2.0 * z])
    np.testing.assert_allclose(
        jax.vmap(lambda z: augmented_systems.evaluate_problem(circle, z, given)[1])(zs)[0], slopes, rtol=1e-15
    )
    np.testing.assert_allclose(
        jax.jacrev(lambda z: augmented_systems.evaluate_problem(circle, z, given)[0])(z), slopes, rtol=1e-15
    )
    np.testing.assert_allclose(
        jax.jit(lambda z: augmented_systems.evaluate_problem(circle, z, given)[0])(z), value, rtol=1e-15
    )
    assert not list(
        (cache / persistent_jit.FOLDER).glob("*/*")
    )  # the function made here is known to this process alone
