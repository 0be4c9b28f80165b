"""Properties of the stroboscopic map that hold for every kind of scene."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from jaxvibro.design.impact_chain_equations import ChainNodes
from jaxvibro.design.impact_prediction import Impact, min_clearances, next_impacts
from jaxvibro.maps.strobe_inverse import strobe_backward
from tests import truths
from tests.kinds import GRID, LANES, wall_ends
from tests.reference.search import Discard
from tests.tiers import generator, of_batches, of_numbers

from .motions import (
    SLOTS,
    Status,
    assert_alike,
    assert_close,
    assert_same,
    between,
    decided,
    direction_in,
    elastic,
    energy,
    is_reversible,
    lane_of,
    move,
    moved,
    rebuild,
    slope_bound,
    smooth,
    strobe,
    take,
    wall_speed,
)

STEP = 2.0**-16  # of differences: exact in the numbers of scene and state
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
            truth = kind.truth(*lane_of(scene, state, lane))
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
        if impacts.count[lane] > SLOTS:
            assert np.isnan(matrices[lane]).all()
            continue
        size = 1.0 + abs(truth.matrix).max()
        assert abs(matrices[lane] - truth.matrix).max() < max(bound, slope_bound(kind, truth)) * size
    assert compared >= 1


@partial(jax.jit, static_argnames="order")
def _slopes(scene, state, direction, order=1):
    """The derivative of (x, v, *times, *speeds) of each lane along a direction in all numbers of scene and state."""

    def result(step):
        moved = jax.tree.map(lambda value, by: value + step * by, (scene, state), direction)
        end, impacts = jv.strobe(*moved, 1, SLOTS)
        times = jnp.where(impacts.side == 0, 0.0, impacts.time)
        return jnp.concatenate([end.x[:, None], end.v[:, None], times, impacts.speed], 1)

    for _ in range(order):
        result = jax.jacfwd(result)
    return result(0.0)


@jax.jit
def _gradients(scene, state, weights):
    """The gradients of a weighted sum of (x, v) of each lane by all numbers."""

    def total(scene, state):
        end, _ = jv.strobe(scene, state, 1, SLOTS)
        return jnp.sum(weights[0] * end.x + weights[1] * end.v)

    return jax.grad(total, (0, 1))(scene, state)


@of_numbers
def test_slopes(kind, number):
    """Derivatives along a direction in all numbers of scene and state are those of differences of the reference.

    Forward mode gives those of the end and of the impacts' times and speeds, reverse mode the same of the end.
    """
    (scene, state), rng, compared = kind.draw(number), generator(kind, number), 0
    scene, state, direction = direction_in(rng, scene, state)
    keep = smooth(kind, scene, state)
    slopes = np.asarray(_slopes(scene, state, direction))
    weights = rng.choice([-1.0, 1.0, 2.0], (2, LANES))
    gradients = jax.tree.leaves(jax.device_get(_gradients(scene, state, weights)))
    backward = sum(a * b for a, b in zip(gradients, jax.tree.leaves(direction), strict=True))
    for lane in np.flatnonzero(keep):
        try:
            lines = [lane_of(*moved(scene, state, direction, k * STEP), lane) for k in (-2, -1, 1, 2)]
            motions = [kind.truth(*line) for line in lines]
            expected, apart = truths.derivative(motions, STEP)
        except Discard:
            continue
        compared += 1
        hits = len(motions[0].sides)
        computed = slopes[lane, [0, 1, *range(2, 2 + hits), *range(2 + SLOTS, 2 + SLOTS + hits)]]
        size = 1.0 + abs(expected).max()
        bound = max(1e-11 * motions[0].allowed, slope_bound(kind, motions[0])) * size + 0.02 * apart
        assert np.all(abs(computed - expected) <= bound)
        assert abs(backward[lane] - weights[:, lane] @ expected[:2]) <= 4.0 * bound.max()
    assert compared or not keep.any()


@of_numbers
def test_second_derivatives(kind, number):
    """Second derivatives along a direction are those of differences of first ones."""
    (scene, state), rng = kind.draw(number), generator(kind, number)
    scene, state, direction = direction_in(rng, scene, state)
    keep = smooth(kind, scene, state)
    second = np.asarray(_slopes(scene, state, direction, 2))
    ends = [np.asarray(_slopes(*moved(scene, state, direction, k * STEP), direction)) for k in (-2, -1, 1, 2)]
    near, far = (ends[2] - ends[1]) / (2.0 * STEP), (ends[3] - ends[0]) / (4.0 * STEP)
    growth = (1.0 + abs(values).max(1, keepdims=True) for values in (second, ends[1]))
    bound = 0.05 * abs(near - far) + 1e-8 * np.prod(list(growth), axis=0)
    assert np.all(abs(second - near - (near - far) / 3.0)[keep] <= bound[keep])


@jax.jit
def _sample_slopes(scene, state, times, direction):
    """States at times of each lane, and their derivatives along a direction in all numbers and the times."""

    def result(step):
        changed = jax.tree.map(lambda value, by: value + step * by, (scene, state), direction)
        states, status = jv.sample(*changed, times + step)
        return jnp.stack([states.x, states.v], -1), status

    slopes, status = jax.jacfwd(result, has_aux=True)(0.0)
    return result(0.0)[0], slopes, status


@of_numbers
def test_sampled_states(kind, number):
    """States at given times and their derivatives by every number and the time are those of the reference."""
    (scene, state), rng, compared = kind.draw(number), generator(kind, number), 0
    scene, state, direction = direction_in(rng, scene, state)
    keep = smooth(kind, scene, state)
    ends = np.round(2.0 * np.pi / scene.frequency[:, None] * rng.uniform(0.02, 0.98, (LANES, 3)) * GRID) / GRID
    times = np.sort(ends, -1)
    states, slopes, status = jax.device_get(_sample_slopes(scene, state, times, direction))
    assert not np.any(status[keep])
    for lane in np.flatnonzero(keep):
        for k, time in enumerate(times[lane]):
            try:
                motions = [
                    truths.closed_form_at(*lane_of(*moved(scene, state, direction, n * STEP), lane), time + n * STEP)
                    for n in (-2, -1, 0, 1, 2)
                ]
                expected, apart = truths.derivative([motions[n] for n in (0, 1, 3, 4)], STEP)
            except Discard:
                continue
            compared += 1
            truth = motions[2]
            bound = kind.tolerance * truth.allowed
            state_error = [float(truth.x - float(states[lane, k, 0])), float(truth.v - float(states[lane, k, 1]))]
            assert np.abs(state_error).max() < bound
            size = 1.0 + abs(expected).max()
            assert np.all(abs(slopes[lane, k] - expected[:2]) <= 1e-11 * truth.allowed * size + 0.02 * apart[:2])
    assert compared or not keep.any()


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

    def flip_later(wall):
        return move(wall, -wall.position, lambda b, phase, m: (-b, phase - m * np.pi, m))

    def term_later(term):
        return jv.Motion(-term.amplitude, term.phase - term.harmonic * np.pi, term.harmonic)

    end, impacts = strobe(scene, state)
    turned = replace(state, x=-state.x, v=-state.v)
    image, others = strobe(rebuild(scene, flip, (1, 0), -1.0), turned)
    if kind.exact:
        assert_same((image.x, -end.x), (image.v, -end.v), (image.contact, -end.contact), (others.time, impacts.time))
        assert_same((others.side, -impacts.side), (others.speed, impacts.speed), (others.status, impacts.status))
        assert_same((others.least_clearance, impacts.least_clearance))
    else:
        assert_alike(kind, scene, state, (end, impacts), (image, others), -1)
    if not scene.force or "c0" not in scene.force.numbers:
        later = rebuild(scene, flip_later, (1, 0), drive=term_later)
        image = strobe(later, replace(turned, phase=state.phase + np.pi))
        assert_alike(kind, scene, state, (end, impacts), image, -1)


@of_batches
def test_shift(kind, scene, state):
    """A start some periods of the drive later gives the same motion to the rounding of its phase."""
    later = replace(state, phase=state.phase + PERIODS_LATER)
    assert_alike(kind, scene, state, strobe(scene, state), strobe(scene, later))


@of_batches
def test_semigroup(kind, scene, state):
    """Two periods are one after another: bit for bit where the fast path takes periods one by one, else to rounding."""
    end, impacts = strobe(scene, state)
    last, more = strobe(scene, end)
    both, total = jax.device_get(jv.strobe(scene, state, 2, SLOTS, True))
    if kind.exact and not scene.soft_sides and not scene.drive:
        assert_same((both.x, last.x), (both.v, last.v), (both.contact, last.contact))
        good = total.status < Status.CAP
        assert_same((total.count[good], (impacts.count + more.count)[good]))
        return
    (keep, bound), (then, further) = decided(kind, scene, state, end, impacts), decided(kind, scene, end, last, more)
    assert_close(keep & then, bound * (1.0 + further / kind.tolerance), (both.x, last.x), (both.v, last.v))


@of_batches
def test_sample(kind, scene, state):
    """`sample` gives at the ends of periods what the map gives, whatever other times are asked for."""
    end, impacts = strobe(scene, state)
    last, more = strobe(scene, end)
    (keep, bound), (then, further) = decided(kind, scene, state, end, impacts), decided(kind, scene, end, last, more)
    times = 2.0 * np.pi / scene.frequency[:, None] * np.array([0.0, 0.5, 1.0, 1.7, 2.0])
    states, _ = jv.sample(scene, state, times)
    assert_close(keep, bound, (states.x[:, 0], state.x), (states.v[:, 0], state.v))
    assert_close(keep, bound, (states.x[:, 2], end.x), (states.v[:, 2], end.v))
    growing = bound * (1.0 + further / kind.tolerance)
    assert_close(keep & then, growing, (states.x[:, 4], last.x), (states.v[:, 4], last.v))


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
def test_inverse(kind, scene, state):
    """The inverse map leads from the end of a period to its start, with losses too."""
    scene = rebuild(
        scene, lambda wall: wall if wall.soft else replace(wall, restitution=np.maximum(wall.restitution, 0.2))
    )
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)
    matrix = np.where(keep[:, None, None], np.asarray(jv.monodromy(scene, state, slots=SLOTS)), np.eye(2))
    for side, wall in scene.walls.items():
        keep &= (impacts.side != (-1 if side == "left" else 1)).all(-1) | is_reversible(wall)
    keep &= (abs(np.linalg.det(matrix)) > 1e-6) & (np.asarray(0.0 if scene.force else scene.damping) < 0.95)
    growth = 1.0 + np.linalg.norm(np.linalg.inv(np.where(keep[:, None, None], matrix, np.eye(2))), axis=(1, 2))
    start, others = _strobe_backward(scene, jv.State(end.x, end.v, end.phase, 0.0 * end.x))
    one, other = others.count + contacts_at(scene, end), impacts.count + contacts_at(scene, state)  # begins, then ends
    assert_same((np.asarray(one)[keep], np.asarray(other)[keep]))
    bound = bound * growth * (1.0 + growth)
    assert_close(keep, bound, (start.x, state.x), (start.v, state.v))


def contacts_at(scene, state):
    """Return the number of soft walls that the mass presses."""
    depths = zip((scene.left, scene.right), (-1.0, 1.0), wall_ends(scene, state.phase), strict=True)
    return sum((wall is not None and wall.soft) * (side * (state.x - end) > 0.0) for wall, side, end in depths)


_strobe_backward = jax.jit(partial(strobe_backward, min_lanes=1))


@of_batches
def test_energy(kind, scene, state):
    """Without a drive, losses and motion of the walls the energy stays that of the start."""

    def still(wall):
        return move(wall, wall.position, lambda b, *rest: (0.0 * b, *rest))

    def silent(term):
        return replace(term, amplitude=0.0 * term.amplitude)

    scene = rebuild(elastic(scene), still, drive=silent).replace(amplitude=0.0 * scene.amplitude)
    keep, start, count = between(scene, state), energy(scene, state), 0
    end = state
    for _ in range(5):
        end, impacts = strobe(scene, end)
        keep &= impacts.status < Status.CAP
        count = count + np.where(keep, impacts.count, 0)
        end = replace(end, phase=state.phase)
    bound = 20.0 * kind.tolerance * (10.0 + count) * (1.0 + abs(start)) * (1.0 + 10.0 / scene.frequency)
    assert_close(keep, bound, (energy(scene, end), start))


@of_batches
def test_return_map(kind, scene, state):
    """The map from impact to impact leads from the first recorded impact on a wall to the next one."""
    end, impacts = strobe(scene, state)
    keep, bound = decided(kind, scene, state, end, impacts)
    name, side = next((name, -1 if name == "left" else 1) for name in scene.walls)
    wall, hits = getattr(scene, name), impacts.side == side
    keep &= hits.sum(-1) > 1
    first = np.argmax(hits, -1)
    second = np.argmax(hits & (np.arange(SLOTS) > first[:, None]), -1)
    lanes = np.arange(LANES)
    phase, late = (state.phase + scene.frequency * impacts.time[lanes, k] for k in (first, second))
    rebound = 1.0 if wall.soft else -np.broadcast_to(wall.restitution, LANES)
    velocity, expected = (
        wall_speed(scene, wall, at) + rebound * side * impacts.speed[lanes, k]
        for at, k in ((phase, first), (late, second))
    )
    phase, velocity = (np.where(keep, values, 0.0) for values in (phase, velocity))
    found = jax.device_get(jv.return_map(scene, name, phase, velocity, slots=SLOTS))
    assert np.all(found.found[keep])
    assert_same((found.between[keep], (second - first - 1)[keep]))
    bound = 10.0 * bound / np.minimum(1.0, np.where(keep, impacts.least_speed, 1.0)) ** 2
    times = impacts.time[lanes, second] - impacts.time[lanes, first]
    assert_close(keep, bound, (found.time, times), (found.velocity, expected))


@of_numbers
def test_impact_prediction(kind, number):
    """Impacts predicted one by one, forward and backward, are those of the map, and so are clearances.

    A clearance is negative where an impact was left out.
    """
    scene, state = kind.draw_single(number)
    _, first = jax.device_get(jv.strobe(scene, replace(state, contact=0.0), periods=30, slots=64, clearance=True))
    hit = np.flatnonzero(first.side)[:20]
    if len(hit) < 10 or first.least_speed < 1e-2:
        return
    nodes = ChainNodes(first.side[hit].astype(float), first.time[hit], first.speed[hit])
    rows = np.array(nodes).T
    for way, expected in ((1, rows), (-1, rows[::-1])):
        for before, after in pairwise(expected):
            (found,) = next_impacts(scene, state.phase, Impact(*before), expected[-1][1] + way, 1, way)
            loss = before[2] / after[2] + after[2] / before[2] + 1.0 / min(before[2], after[2]) ** 2
            growth = np.exp(2.0 * scene.damping * max(0.0, before[1] - after[1]))  # of roundings, backward
            assert np.allclose(found, after, rtol=0, atol=1e-11 * loss * (1.0 + growth))
        early = expected[1][1] - 0.01 * way
        assert next_impacts(scene, state.phase, Impact(*expected[0]), early, 5, way) == []
    assert len(next_impacts(scene, state.phase, Impact(*rows[0]), rows[9, 1] + 1e-6, 20)) == 9
    least, _, _ = min_clearances(scene, state.phase, nodes)
    assert np.all(least > 0) and np.min(least) >= first.least_clearance - 1e-6
    least, sides, when = min_clearances(scene, state.phase, ChainNodes(*(np.delete(each, 3) for each in nodes)))
    assert least[2] < 0 and sides[2] == nodes.sides[3] and nodes.times[3] < when[2] < nodes.times[4]
    assert np.all(np.delete(least, 2) > 0)


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
