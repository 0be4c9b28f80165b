"""`jaxvibro warm`: a later process traces nothing of the host's questions, and has the same numbers."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxvibro as jv
from continuation import augmented_systems, numpy_evaluation, persistent_jit
from jaxvibro.branches.follow import set_up_equations
from jaxvibro.problem.orbit_equations import continuation_problem
from jaxvibro.problem.orbit_point import OrbitPoint

ROOT = Path(__file__).parents[1]
LATER = """
import numpy as np, jaxvibro as jv
from continuation.numpy_evaluation import NumpyEvaluator
traced, plain = [], NumpyEvaluator.trace_function
NumpyEvaluator.trace_function = lambda self, args: traced.append(self.function.__name__) or plain(self, args)
scene = jv.make_scene({numbers})
state, _ = jv.strobe(scene, jv.State({start}))
branch = jv.follow(jv.find_orbit(scene, state), "amplitude", (0.0, 6.0))
jv.switch(branch.points("SB")[0])
jv.locus(branch.points("SN")[0], ("amplitude", "frequency"), dict(amplitude=(0.0, 9.0), frequency=(1.8, 2.4)))
jv.find_attractors(scene)
print(*traced)
print(branch.table())
"""


@pytest.fixture
def cache(tmp_path):
    """jax's compile cache in a folder of its own."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def placed():
    """(equations, z) of a motion without impacts."""
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    none = np.zeros(0)
    return set_up_equations(scene, "amplitude", OrbitPoint(2.0, none, none, none, 1, 0.0, 0.0, 0.0))


def test_the_text_is_read_and_the_module_made_only_where_it_is_compiled(placed, cache, monkeypatch):
    along, z = placed
    asked, plain = [], numpy_evaluation.NumpyEvaluator.trace_function
    monkeypatch.setattr(
        numpy_evaluation.NumpyEvaluator, "trace_function", lambda self, args: asked.append(1) or plain(self, args)
    )

    def found():
        anew = persistent_jit.persistent_jit(
            augmented_systems.evaluate_problem.__wrapped__, static_argnums=0, numpy_first=True
        )
        return [np.asarray(each) for each in anew(continuation_problem(along), z, along)]

    def kept(kind):
        return [each for each in cache.glob(f"{persistent_jit.FOLDER}/*/*") if each.is_file() and each.suffix == kind]

    first = found()
    assert len(asked) == 1 and len(kept(".code")) == 1 and not kept("")
    for one, other in zip(first, found(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(asked) == 1
    monkeypatch.setattr(numpy_evaluation, "MAX_EVALUATIONS", 0)
    compiled = found()
    assert len(asked) == 1 and len(kept("")) == 1
    for one, other in zip(first, compiled, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
    (text,) = kept(".code")
    text.write_bytes(text.read_bytes()[:-20])  # half a file
    monkeypatch.setattr(numpy_evaluation, "MAX_EVALUATIONS", np.inf)
    for one, other in zip(first, found(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(asked) == 2


def fresh(*words, **environment):
    plain = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, env=plain | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_later_process_traces_nothing(tmp_path):
    told = fresh("-m", "jaxvibro", "warm", XDG_CACHE_HOME=str(tmp_path)).splitlines()
    assert [line.split()[0] for line in told[:4]] == ["strobe", "find_orbit", "follow", "switch"]
    settings = dict(line.removeprefix("export ").split("=") for line in told if line.startswith("export "))
    assert settings["JAX_COMPILATION_CACHE_DIR"].startswith(str(tmp_path))
    same = LATER.format(numbers="2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)", start="0.9, -1.1")
    functions, *table = fresh("-c", same, **settings).splitlines()
    assert functions == ""
    without = {"JAX_ENABLE_X64": "1"}
    functions, *plain = fresh("-c", same, **without).splitlines()
    assert len(functions.split()) > 5 and plain == table


def test_without_a_cache_it_says_so():
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        with pytest.raises(jv.ArgumentError, match="jax_compilation_cache_dir: must be set"):
            jv.warm()
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_a_batch_of_scenes_is_refused(cache):
    with pytest.raises(jv.ArgumentError):
        jv.warm(jv.make_scene(np.array([2.0, 3.0]), 2.1, 0.05, 0.7, (-1.0, 1.0)))
    assert numpy_evaluation.MAX_EVALUATIONS > 0
