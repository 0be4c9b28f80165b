"""What is traced lowers for a graphics card, without the hints that a processor gets: this finds what cannot be told to
one at all. Where there is a card, a map and studies on it are compared with those on the processor."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import jaxvibro as jv
from continuation import augmented_systems, event_search
from continuation.arclength import StepControl, TrackState
from jaxvibro.attractors import basin_labels, local_manifold, sweep, tangent_growth
from jaxvibro.branches.follow import set_up_equations
from jaxvibro.compiled import kernel_calls, lane_arithmetic, lane_blocks
from jaxvibro.loci import codim2_points
from jaxvibro.loci.locus_start import LocusStart, problems_at_locus_start
from jaxvibro.maps import long_iteration, simulate, sticking_phase_intervals
from jaxvibro.orbits import orbit_from_impacts
from jaxvibro.problem import grazing_contact, orbit_diagnostics
from jaxvibro.problem.orbit_equations import continuation_problem
from jaxvibro.problem.orbit_point import OrbitPoint

WALLS = {
    "none": (None, None),
    "one": (None, 1.0),
    "two": (-1.0, 1.0),
    "moving": (jv.Wall(-1.5, 0.6), jv.Wall(1.0, 0.8, motion=jv.Motion(0.1, 0.3, 2))),
    "soft": (jv.Wall(-1.5, stiffness=90.0, damping=1.0), jv.Wall(1.0, 0.8)),
}
TRACED_FOR_CPU = kernel_calls.is_traced_for_cpu
LANES = jv.State(*(np.linspace(-0.5, 0.5, 16) * k for k in (1.0, 2.0, 0.0, 0.0)))


@pytest.fixture(scope="module", autouse=True)
def on_card():
    """What these tests trace they share, and no other test."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (lane_blocks, lane_arithmetic, kernel_calls):
            patch.setattr(module, "is_traced_for_cpu", lambda: False)
        jax.clear_caches()
        yield
    jax.clear_caches()


def scene(walls):
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS[walls])


def lowered(function, *args):
    """The module of a function that `persistent_jit` or nothing keeps, for a card."""
    module = export.export(jax.jit(getattr(function, "__wrapped__", function)), platforms=["cuda"])(*args)
    assert module.platforms == ("cuda",)
    text = module.mlir_module()
    assert "inlineable" not in text and "xla_cpu" not in text
    return text


def strobes(state, walls):
    end, impacts = jv.strobe(scene(walls), state, clearance=True)
    return end.x, end.v, impacts.speed, impacts.least_clearance


@pytest.mark.parametrize("walls", WALLS)
def test_the_map_and_its_derivatives(walls):
    for function in (
        partial(strobes, walls=walls),
        lambda state: jax.vmap(lambda x: jax.grad(lambda x: jv.strobe(scene(walls), jv.State(x, 0.2))[0].x)(x))(
            state.x
        ),
        lambda state: jv.monodromy(scene(walls), state),
    ):
        assert "func.func public @main" in lowered(function, LANES)


@pytest.mark.parametrize("walls", ["two", "soft"])
def test_long_runs(walls):
    one = scene(walls)
    states = [np.asarray(each) for each in (LANES.x, LANES.v, LANES.phase, LANES.contact)]
    begun = np.zeros(LANES.x.shape, np.int32)
    for lean in (False, True)[: 1 + (walls == "two")]:
        run = partial(long_iteration._iterate_block.__wrapped__, slots=16, is_fast_path_only=lean)
        lowered(lambda *given, run=run: run(one, *given), LANES, begun, 3)
    lowered(lambda state: simulate._sample_trajectory(one, state, 1, 20), jax.tree.map(lambda leaf: leaf[0], LANES))
    values = np.linspace(1.0, 2.0, 3)[:, None] * np.ones(16)
    chunk = partial(sweep._sweep_chunk.__wrapped__, name="amplitude", keep=2)
    lowered(lambda *given: chunk(one, *given), values, 3, LANES, LANES, 5)
    lowered(lambda *given: sticking_phase_intervals._scan_for_sticking.__wrapped__(one, *given), *_single())
    if walls == "two":
        wide = [np.resize(each, 64) for each in states]
        lowered(
            lambda *given: basin_labels._advance_blocks_to_check.__wrapped__(one, *given),
            wide[0],
            wide[1],
            wide[3],
            0.0,
            1,
        )
        for back in (False, True):
            run = partial(local_manifold._iterate_blocks.__wrapped__, one, inverse=back)
            lowered(run, wide[0], wide[1], 0.0, 2, 1)
        unit = np.ones_like(LANES.x)
        lanes = tangent_growth.TangentLanes(LANES, unit, 0.0 * unit)
        lanes = long_iteration.take_padded_block(lanes, 0, tangent_growth.BLOCKS_PER_CALL * kernel_calls.BLOCK_WIDTH)
        lowered(lambda lanes: tangent_growth._run_strip.__wrapped__(one, lanes, 2, 2), lanes)


def _single():
    state = jax.tree.map(lambda leaf: leaf[0], LANES)
    return state, sticking_phase_intervals.MatrixSinceRelease(*np.array([1.0, 0.0, 0.0, 1.0, 0.0, np.nan]))


def spot():
    """An orbit's impacts, or what may be some."""
    return OrbitPoint(2.0, *np.array([[0.4, 1.9], [1.5, 1.4], [1.0, -1.0]]), 1, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("walls", ["two", "soft"])
def test_orbits_and_branches(walls):
    one = scene(walls)
    guess = orbit_from_impacts.padded_sequence(one, *spot()[1:4], 0.0, 1)
    lowered(orbit_from_impacts.solve_guess, one, guess)
    lowered(orbit_from_impacts._solve_guesses_compiled, one, jax.tree.map(lambda leaf: np.stack([leaf] * 4), guess))
    along, z = set_up_equations(one, "amplitude", spot())
    carried(along, z)
    seen = partial(orbit_diagnostics._evaluate_compiled.__wrapped__, orbit_diagnostics.impact_diagnostics, n_periods=1)
    lowered(lambda zs: seen(along, zs, np.int32(2)), np.stack([z, z]))
    row = np.int32(0)
    lowered(lambda y: grazing_contact._relative_motion.__wrapped__(y, along, row, row), np.append(z, 0.1))


def carried(along, z):
    """What a branch or locus is carried by."""
    task, size = continuation_problem(along), len(z)
    numbers = (np.float64(each) for each in (1e-8, 0.1, 1e-10, -9.0, 9.0))
    place = TrackState(z, np.eye(size)[-1], np.float64(0.1), np.int32(0))
    track = partial(event_search._track_chunk.__wrapped__, task, capacity=8)
    lowered(
        lambda place, control: track(place, control, along, max_steps=np.int32(8)),
        place,
        StepControl(np.ones(size), *numbers),
    )
    lowered(lambda z: augmented_systems.evaluate_problem.__wrapped__(task, z, along), z)


@pytest.mark.parametrize(("kind", "walls"), [("PD", "two"), ("SN", "soft")])
def test_loci(kind, walls):
    start = LocusStart(kind, "amplitude", scene(walls), spot())
    ((curve, z),) = problems_at_locus_start(start, ("amplitude", "left.position"))
    carried(curve, z)
    blank = tuple(np.zeros((2, 2 * len(curve.sequence.sides))))
    for order in (2, 3):
        bend = partial(codim2_points._evaluate_normal_forms.__wrapped__, order=order, high_accuracy=True)
        lowered(lambda zs, bend=bend: bend(curve, zs, blank, np.int32(2)), jnp.stack([z, z]))


def test_what_only_a_processor_can_is_found():
    with pytest.raises(NotImplementedError, match="schur"):
        lowered(jax.scipy.linalg.schur, jnp.eye(2))


@pytest.fixture
def devices():
    """A card and the processor; what was traced for the tests above is dropped."""
    if jax.default_backend() != "gpu":
        pytest.skip("there is no graphics card")
    with pytest.MonkeyPatch.context() as patch:
        for module in (lane_blocks, lane_arithmetic, kernel_calls):
            patch.setattr(module, "is_traced_for_cpu", TRACED_FOR_CPU)
        jax.clear_caches()
        yield jax.devices("gpu")[0], jax.devices("cpu")[0]


def on_each(devices, function):
    """Return what a function of a device returns on each."""
    results = []
    for device in devices:
        with jax.default_device(device):
            results.append(jax.device_get(function(device)))
    return results


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
