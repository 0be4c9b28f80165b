"""What is traced lowers for a graphics card, without the hints that a processor gets: this finds what cannot be told to
one at all. `python -m tests.cuda_proof` runs on one."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import jaxvibro as jv
from continuation import event_search, locate
from continuation.arclength import Control, Place
from jaxvibro.attractors import assign, local_manifold, sweep, tangent
from jaxvibro.branches.follow import place_orbit
from jaxvibro.compiled import blocks, compiler_hints, kernels
from jaxvibro.loci import codim2
from jaxvibro.loci.first_point import LocusStart, equations
from jaxvibro.maps import long_run, rests, simulate
from jaxvibro.orbits import by_impacts
from jaxvibro.problem import diagnostics, touches
from jaxvibro.problem.equations import problem
from jaxvibro.problem.orbit_on_branch import OrbitPoint
from tests.cuda_proof import WALLS

MARKS = {"two": (), "moving": pytest.mark.slow}
LANES = jv.State(*(np.linspace(-0.5, 0.5, 16) * k for k in (1.0, 2.0, 0.0, 0.0)))


@pytest.fixture(scope="module", autouse=True)
def on_card():
    """What these tests trace they share, and no other test."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (blocks, compiler_hints, kernels):
            patch.setattr(module, "on_processor", lambda: False)
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


@pytest.mark.parametrize("walls", [pytest.param(one, marks=MARKS.get(one, pytest.mark.long)) for one in WALLS])
def test_the_map_and_its_derivatives(walls):
    for function in (
        partial(strobes, walls=walls),
        lambda state: jax.vmap(lambda x: jax.grad(lambda x: jv.strobe(scene(walls), jv.State(x, 0.2))[0].x)(x))(
            state.x
        ),
        lambda state: jv.monodromy(scene(walls), state),
    ):
        assert "func.func public @main" in lowered(function, LANES)


@pytest.mark.slow
@pytest.mark.parametrize("walls", ["two", "soft"])
def test_long_runs(walls):
    one = scene(walls)
    states = [np.asarray(each) for each in (LANES.x, LANES.v, LANES.phase, LANES.contact)]
    begun = np.zeros(LANES.x.shape, np.int32)
    for lean in (False, True)[: 1 + (walls == "two")]:
        run = partial(long_run._run.__wrapped__, slots=16, lean=lean)
        lowered(lambda *given, run=run: run(one, *given), LANES, begun, 3)
    lowered(lambda state: simulate._sampled(one, state, 1, 20), jax.tree.map(lambda leaf: leaf[0], LANES))
    values = np.linspace(1.0, 2.0, 3)[:, None] * np.ones(16)
    chunk = partial(sweep._chunk.__wrapped__, name="amplitude", keep=2)
    lowered(lambda *given: chunk(one, *given), values, 3, LANES, LANES, 5)
    lowered(lambda *given: rests._watched.__wrapped__(one, *given), *_single())
    if walls == "two":
        wide = [np.resize(each, 64) for each in states]
        lowered(lambda *given: assign._round.__wrapped__(one, *given), wide[0], wide[1], wide[3], 0.0, 1)
        for back in (False, True):
            run = partial(local_manifold._run.__wrapped__, one, back=back)
            lowered(run, wide[0], wide[1], 0.0, 2, 1)
        unit = np.ones_like(LANES.x)
        lanes = tangent.TangentLanes(LANES, unit, 0.0 * unit)
        lanes = long_run.padded(lanes, 0, tangent.STRIP * kernels.WIDTH)
        lowered(lambda lanes: tangent._run.__wrapped__(one, lanes, 2, 2), lanes)


def _single():
    state = jax.tree.map(lambda leaf: leaf[0], LANES)
    return state, rests.SinceRelease(*np.array([1.0, 0.0, 0.0, 1.0, 0.0, np.nan]))


def spot():
    """An orbit's impacts, or what may be some."""
    return OrbitPoint(2.0, *np.array([[0.4, 1.9], [1.5, 1.4], [1.0, -1.0]]), 1, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("walls", ["two", pytest.param("soft", marks=pytest.mark.slow)])
def test_orbits_and_branches(walls):
    one = scene(walls)
    guess = by_impacts.padded(one, *spot()[1:4], 0.0, 1)
    lowered(by_impacts.solution, one, guess)
    lowered(by_impacts._many, one, jax.tree.map(lambda leaf: np.stack([leaf] * 4), guess))
    along, z = place_orbit(one, "amplitude", spot())
    carried(along, z)
    seen = partial(diagnostics._seen.__wrapped__, diagnostics.hitting, periods=1)
    lowered(lambda zs: seen(along, zs, np.int32(2)), np.stack([z, z]))
    row = np.int32(0)
    lowered(lambda y: touches._contact.__wrapped__(y, along, row, row), np.append(z, 0.1))


def carried(along, z):
    """What a branch or locus is carried by."""
    task, size = problem(along), len(z)
    numbers = (np.float64(each) for each in (1e-8, 0.1, 1e-10, -9.0, 9.0))
    place = Place(z, np.eye(size)[-1], np.float64(0.1), np.int32(0))
    track = partial(event_search._track.__wrapped__, task, count=8)
    lowered(
        lambda place, control: track(place, control, along, most=np.int32(8)), place, Control(np.ones(size), *numbers)
    )
    lowered(lambda z: locate.evaluated.__wrapped__(task, z, along), z)


@pytest.mark.parametrize(
    ("kind", "walls"), [("PD", "two"), *(pytest.param("SN", one, marks=pytest.mark.long) for one in ("two", "soft"))]
)
def test_loci(kind, walls):
    start = LocusStart(kind, "amplitude", scene(walls), spot())
    ((curve, z),) = equations(start, ("amplitude", "left.position"))
    carried(curve, z)
    blank = tuple(np.zeros((2, 2 * len(curve.cycle.sides))))
    for order in (2, 3):
        bend = partial(codim2._bending.__wrapped__, order=order, fine=True)
        lowered(lambda zs, bend=bend: bend(curve, zs, blank, np.int32(2)), jnp.stack([z, z]))


def test_what_only_a_processor_can_is_found():
    with pytest.raises(NotImplementedError, match="schur"):
        lowered(jax.scipy.linalg.schur, jnp.eye(2))
