"""Properties of the stroboscopic map that hold for every kind of scene."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from jaxvibro.scene.codes import Status
from tests.kinds import LANES, wall_ends
from tests.reference.search import Discard
from tests.tiers import of_batches, of_numbers

from .motions import (
    SLOTS,
    assert_alike,
    assert_close,
    assert_same,
    decided,
    elastic,
    move,
    rebuild,
    strobe,
    take,
)

FACTORS = 2.0 ** np.array([-20, 13, 1, -1, 40, -3, 7, -60])
PERIODS_LATER = 2.0 * np.pi * np.array([1, -1, 2, -3, 5, 1, -7, 10])


@of_numbers
def test_reference(kind, number):
    """The end, the impacts, the clearance and the monodromy matrix are those of the reference implementation."""
    scene, state = kind.draw(number)
    end, impacts = strobe(scene, state)
    matrices, compared = np.asarray(jv.monodromy(scene, state, slots=SLOTS)), 0
    for lane in range(LANES):
        try:
            truth = kind.truth(take(scene, lane), *(float(each[lane]) for each in (state.x, state.v, state.phase)))
        except Discard:
            continue
        compared += 1
        bound = kind.tolerance * truth.allowed
        assert impacts.status[lane] < Status.CAP
        assert max(abs(float(truth.x - float(end.x[lane]))), abs(float(truth.v - float(end.v[lane])))) < bound
        if truth.sides is None:
            continue
        assert impacts.count[lane] == len(truth.sides)
        assert [side for side in impacts.side[lane] if side] == list(truth.sides[:SLOTS])
        for time, speed, true_time, true_speed in zip(
            impacts.time[lane], impacts.speed[lane], truth.times, truth.speeds, strict=False
        ):
            assert abs(float(true_speed - float(speed))) < bound
            assert abs(float(true_time - float(time))) * float(true_speed) < 10.0 * bound
        if truth.least_clearance is not None:
            expected = truth.least_clearance
            assert impacts.least_clearance[lane] == expected or abs(impacts.least_clearance[lane] - expected) < bound
        assert abs(matrices[lane] - truth.matrix).max() < max(
            bound, 1e-8 * bound / kind.tolerance * (not kind.exact)
        ) * (1.0 + abs(truth.matrix).max())
    assert compared >= 1


@of_batches
def test_permutation(kind, scene, state):
    """A batch in another order gives the same bits."""
    backward = slice(None, None, -1)
    turned = take(strobe(*take((scene, state), backward)), backward)
    assert_same(*zip(jax.tree.leaves(turned), jax.tree.leaves(strobe(scene, state)), strict=True))


@of_batches
def test_splitting(kind, scene, state):
    """Parts of a batch give the bits of the whole, single scenes the same to rounding."""
    whole = strobe(scene, state)
    for lanes in (slice(0, LANES // 2), slice(LANES // 2, LANES), slice(2, 3)):
        part = strobe(*take((scene, state), lanes))
        assert_same(*zip(jax.tree.leaves(part), jax.tree.leaves(take(whole, lanes)), strict=True))
    keep, bound = decided(kind, scene, state, *whole)
    for lane in range(LANES):
        end, impacts = strobe(*take((scene, state), lane))
        if keep[lane]:
            assert_same((impacts.side, whole[1].side[lane]), (impacts.status, whole[1].status[lane]))
            assert max(abs(end.x - whole[0].x[lane]), abs(end.v - whole[0].v[lane])) <= bound[lane]


@of_batches
def test_scaling(kind, scene, state):
    """Lengths times a power of two give the same bits times it, and the same times and codes."""
    grown = rebuild(
        scene, lambda wall: move(wall, FACTORS * wall.position, lambda b, *rest: (FACTORS * b, *rest)), sign=FACTORS
    )
    end, impacts = strobe(scene, state)
    large, others = strobe(grown, replace(state, x=FACTORS * state.x, v=FACTORS * state.v))
    assert_same((large.x, FACTORS * end.x), (large.v, FACTORS * end.v), (large.contact, end.contact))
    assert_same((others.time, impacts.time), (others.side, impacts.side), (others.status, impacts.status))
    assert_same((others.speed, FACTORS[:, None] * impacts.speed), (others.count, impacts.count))
    assert_same((others.least_clearance, FACTORS * impacts.least_clearance))


@of_batches
def test_mirror(kind, scene, state):
    """The mirror image gives the mirrored bits; the drive half a period later instead of negated, to rounding."""

    def flip(wall):
        return move(wall, -wall.position, lambda b, *rest: (-b, *rest))

    end, impacts = strobe(scene, state)
    turned = replace(state, x=-state.x, v=-state.v)
    image, others = strobe(rebuild(scene, flip, (1, 0), -1.0), turned)
    if kind.exact:
        assert_same((image.x, -end.x), (image.v, -end.v), (image.contact, -end.contact), (others.time, impacts.time))
        assert_same((others.side, -impacts.side), (others.speed, impacts.speed), (others.status, impacts.status))
        assert_same((others.least_clearance, impacts.least_clearance))
    else:
        assert_alike(kind, scene, state, (end, impacts), (image, others), -1)


@of_batches
def test_shift(kind, scene, state):
    """A start some periods of the drive later gives the same motion to the rounding of its phase."""
    later = replace(state, phase=state.phase + PERIODS_LATER)
    assert_alike(kind, scene, state, strobe(scene, state), strobe(scene, later))


@of_batches
def test_semigroup(kind, scene, state):
    """Two periods are one after another: bit for bit between rigid walls under the spring, else to rounding."""
    end, impacts = strobe(scene, state)
    last, more = strobe(scene, end)
    both, total = jax.device_get(jv.strobe(scene, state, 2, 0))
    if kind.exact and not scene.soft_sides:
        assert_same((both.x, last.x), (both.v, last.v), (both.contact, last.contact))
        good = total.status < Status.CAP
        assert_same((total.count[good], (impacts.count + more.count)[good]))
        return
    (keep, bound), (then, further) = decided(kind, scene, state, end, impacts), decided(kind, scene, end, last, more)
    assert_close(keep & then, bound * (1.0 + further / kind.tolerance), (both.x, last.x), (both.v, last.v))


@of_batches
def test_sample(kind, scene, state):
    """`sample` gives at the end of a period what the map gives, whatever other times are asked for."""
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)
    times = 2.0 * np.pi / scene.frequency[:, None] * np.array([0.0, 0.5, 1.0])
    states, _ = jv.sample(scene, state, times)
    assert_close(keep, bound, (states.x[:, 0], state.x), (states.v[:, 0], state.v))
    assert_close(keep, bound, (states.x[:, 2], end.x), (states.v[:, 2], end.v))


@jax.jit
def _jacobian(scene, state):
    """The derivatives of the strobe by x and v, (LANES, 2, 2)."""

    def end(x, v):
        last = jv.strobe(scene, replace(state, x=x, v=v), 1, 0)[0]
        return jnp.stack([last.x, last.v], -1)

    ones, zeros = jnp.ones(LANES), jnp.zeros(LANES)
    columns = [jax.jvp(end, (state.x, state.v), tangent)[1] for tangent in ((ones, zeros), (zeros, ones))]
    return jnp.stack(columns, -1)


@of_batches
def test_derivative(kind, scene, state):
    """The monodromy matrix is what automatic differentiation gives."""
    keep, bound = decided(kind, scene, state, *strobe(scene, state))
    product, derivative = np.asarray(jv.monodromy(scene, state, slots=SLOTS)), np.asarray(_jacobian(scene, state))
    error = abs(product - derivative).max((1, 2))
    norm = np.linalg.norm(np.where(keep[:, None, None], product, 0.0), axis=(1, 2))
    assert np.all(error[keep] <= (bound * (1.0 + norm))[keep])


@of_batches
def test_determinant(kind, scene, state):
    """det M = exp(-2 gamma T) times R^2 of each impact on a rigid wall.

    A soft wall as damped as the flight changes nothing in it.
    """
    scene = rebuild(scene, lambda wall: replace(wall, damping=scene.damping) if wall.soft else wall)
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)
    matrix = np.where(keep[:, None, None], np.asarray(jv.monodromy(scene, state, slots=SLOTS)), 0.0)
    expected = np.exp(-4.0 * np.pi * scene.damping / scene.frequency)
    for side, wall in scene.walls.items():
        hits = (impacts.side == (-1 if side == "left" else 1)).sum(-1)
        expected = expected if wall.soft else expected * np.broadcast_to(wall.restitution, LANES) ** (2 * hits)
    norm = np.linalg.norm(matrix, axis=(1, 2))
    assert_close(keep, bound * (1.0 + norm), (np.linalg.det(matrix), expected))


@of_batches
def test_reversal(kind, scene, state):
    """Without losses the end, turned round, leads back to the start."""
    scene = elastic(scene)
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)

    def backward(wall):
        return move(wall, wall.position, lambda b, phase, m: (b, -phase, m))

    back = rebuild(scene, backward, drive=lambda term: replace(term, phase=-term.phase))
    again, others = strobe(back, jv.State(end.x, -end.v, -state.phase, 0.0 * end.x))
    for side, wall in zip((-1, 1), (scene.left, scene.right), strict=True):
        if wall is not None and not wall.soft:  # an entry into a soft wall is an exit on the way back
            assert_same(((others.side == side).sum(-1)[keep], (impacts.side == side).sum(-1)[keep]))
    assert_close(keep, bound, (again.x, state.x), (-again.v, state.v))


@of_batches
def test_status(kind, scene, state):
    """A status is never better than the state, and a state with a good one lies between the rigid walls."""
    end, impacts = strobe(scene, state)
    good = impacts.status < Status.CAP
    finite = np.isfinite(end.x) & np.isfinite(end.v)
    assert np.array_equal(good, finite)
    size = abs(scene.amplitude) + abs(state.x) + abs(state.v) + 10.0
    for side, wall, position in zip((-1, 1), (scene.left, scene.right), wall_ends(scene, end.phase), strict=True):
        if wall is not None and not wall.soft:
            assert np.all((side * (end.x - position) <= 100.0 * kind.tolerance * size)[good])
