"""What is traced lowers for a graphics card, without the hints that a processor gets; this finds what no card can run.

Where there is a card, maps and studies on it are compared with those on the processor.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import jaxvibro as jv
from continuation.hostcall import CompilationQueue, module_store

WALLS = {
    "none": (None, None),
    "one": (None, 1.0),
    "two": (-1.0, 1.0),
    "moving": (jv.Wall(-1.5, 0.6), jv.Wall(1.0, 0.8, motion=jv.Motion(0.1, 0.3, 2))),
    "soft": (jv.Wall(-1.5, stiffness=90.0, damping=1.0), jv.Wall(1.0, 0.8)),
}
LANES = jv.State(*(np.linspace(-0.5, 0.5, 16) * k for k in (1.0, 2.0, 0.0, 0.0)))


@pytest.fixture
def on_card():
    """Tests trace as on a card, and share nothing of it with others."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("lane_blocks", "lane_arithmetic", "kernel_calls"):
            patch.setattr(f"jaxvibro.compiled.{module}.is_traced_for_cpu", lambda: False)
        jax.clear_caches()
        yield
    jax.clear_caches()


def scene(walls):
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS[walls])


def lowered(function, *args):
    """The module of a function that `persistent_jit` or nothing keeps, for a card."""
    module = export.export(jax.jit(function), platforms=["cuda"])(*args)
    assert module.platforms == ("cuda",)
    text = module.mlir_module()
    assert "inlineable" not in text and "xla_cpu" not in text
    return text


def strobes(state, walls):
    end, impacts = jv.strobe(scene(walls), state, clearance=True)
    return end.x, end.v, impacts.speed, impacts.least_clearance


@pytest.mark.parametrize("walls", WALLS)
def test_the_map_and_its_derivatives(walls, on_card):
    def slopes(state):
        return jax.vmap(jax.grad(lambda x: jv.strobe(scene(walls), jv.State(x, 0.2))[0].x))(state.x)

    for function in (partial(strobes, walls=walls), slopes, partial(jv.monodromy, scene(walls))):
        assert "func.func public @main" in lowered(function, LANES)


def test_functions_that_only_a_processor_runs_are_detected(on_card):
    with pytest.raises(NotImplementedError, match="schur"):
        lowered(jax.scipy.linalg.schur, jnp.eye(2))


def branches(given):
    """An orbit, its branch, and the curves of the first special points."""
    branch = jv.follow(jv.find_orbit(given, jv.State(0.9, -1.1)), "amplitude", (0.4, 2.5))
    for kind in ("SN", "PD"):
        for point in branch.points(kind)[:1]:
            jv.locus(point, ("amplitude", "left.position"), {"amplitude": (0.4, 2.5), "left.position": (-1.6, -0.9)})


def runs(given):
    """Studies of few states."""
    jv.sweep(given, "amplitude", np.linspace(1.0, 2.0, 3), jv.State(0.1, 0.2), settle=5, keep=2)
    jv.simulate(given, jv.State(0.9, -1.1), samples=8)


def surveys(given):
    """Studies of many states."""
    jv.basins(given, np.linspace(-0.9, 0.9, 4), np.linspace(-2.0, 2.0, 4))
    jv.spectrum(given, "amplitude", np.linspace(1.0, 2.0, 2), jv.State(0.1, 0.2), settle=5)
    jv.map_parameters(given, {"amplitude": [1.0, 2.0], "frequency": [2.0, 2.1]})


@pytest.mark.parametrize("study", [branches, surveys, runs])
@pytest.mark.parametrize("walls", ["two", "soft"])
def test_the_programs_of_studies(study, walls, monkeypatch, request):
    programs, load = {}, module_store.load_or_export_module

    def record(function, args, kwargs):
        leaves, tree = jax.tree.flatten((args, kwargs))
        traced = [isinstance(leaf, jax.core.Tracer) for leaf in leaves]
        shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves if isinstance(leaf, jax.core.Tracer)]
        programs[function] = tree, leaves, traced, shapes
        return load(function, args, kwargs)

    monkeypatch.setattr(module_store, "load_or_export_module", record)
    jax.clear_caches()
    with CompilationQueue() as waiting:
        study(scene(walls))
    while waiting.compile_next():
        pass
    assert len(programs) > 1
    request.getfixturevalue("on_card")
    for function, (tree, leaves, traced, shapes) in programs.items():

        def call(*given, tree=tree, leaves=leaves, traced=traced, function=function):
            values = iter(given)
            filled = [next(values) if new else leaf for leaf, new in zip(leaves, traced, strict=True)]
            args, kwargs = tree.unflatten(filled)
            return function(*args, **kwargs)

        lowered(call, *shapes)


@pytest.fixture
def devices():
    """A card and the processor; what was traced for the tests above is dropped."""
    jax.clear_caches()
    return jax.devices("gpu")[0], jax.devices("cpu")[0]


def on_each(devices, function):
    """Return what a function of a device returns on each."""
    results = []
    for device in devices:
        with jax.default_device(device):
            results.append(jax.device_get(function(device)))
    return results


@pytest.mark.card
@pytest.mark.parametrize("walls", WALLS)
def test_a_card_maps_as_the_processor_does(walls, devices):
    rng, count = np.random.default_rng(1), 100_000
    numbers = rng.uniform(0.5, 4.0, count), rng.uniform(0.6, 3.0, count), rng.uniform(0.0, 0.4, count)
    given = jv.make_scene(*numbers, 0.7, WALLS[walls])
    state = jv.State(rng.uniform(-0.8, 0.8, count), rng.uniform(-2.0, 2.0, count))
    (end, impacts), (true, others) = on_each(
        devices, lambda device: jv.strobe(*jax.device_put((given, state), device), slots=4)
    )
    differ = (impacts.status != others.status) | (impacts.side != others.side).any(-1)
    assert differ.mean() < 1e-4
    apart = np.maximum(abs(end.x - true.x), abs(end.v - true.v)) / (1.0 + abs(true.v))
    assert np.quantile(apart[~differ & np.isfinite(true.x)], 0.999) < 1e-9


@pytest.mark.card
def test_studies_on_a_card_are_those_on_the_processor(devices):
    def study(_):
        given = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
        state, _ = jv.strobe(given, jv.State(0.9, -1.1))
        slope = jax.grad(lambda x: jv.strobe(given, jv.State(x, -1.1))[0].x)(0.9)
        branch = jv.follow(jv.find_orbit(given, state), "amplitude", (0.0, 6.0))
        grid = {"amplitude": np.linspace(0.5, 6.0, 16), "frequency": np.linspace(1.5, 4.0, 16)}
        cells = jv.map_parameters(given, grid)["label"].values
        basins = jv.basins(given, np.linspace(-0.9, 0.9, 20), np.linspace(-2.0, 2.0, 20))["label"].values
        return float(slope), [each.value for each in branch.special], np.append(cells, basins)

    (slope, places, labels), (other, others, expected) = on_each(devices, study)
    assert abs(slope - other) < 1e-12 and np.allclose(places, others, rtol=0, atol=1e-9)
    assert np.mean(labels != expected) < 0.02
