"""Properties of batches of many lanes at the far ends of their numbers: statuses, and the two paths of the map."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS
from jaxvibro.maps.reference_strobe import reference_strobe
from jaxvibro.maps.two_tier_strobe import fast_strobe
from tests import wild
from tests.kinds import wall_ends
from tests.lanes import at
from tests.reference import flights
from tests.tiers import generator, of_numbers

from .motions import Status, assert_same, move, rebuild, wall_speed

OWN_KINDS = wild.KINDS
MANY, FEW = 1024, 256  # lanes
SLOTS, MIN_LANES = 8, 16  # recorded impacts; least lanes of a block
EPS = float(np.finfo(float).eps)


@partial(jax.jit, compiler_options=COMPILER_OPTIONS, static_argnames="clearance")
def fast(scene, state, clearance=False):
    """Run the fast path: ((end, impacts), whether a lane was given up)."""
    return fast_strobe(scene, state, SLOTS, MIN_LANES, clearance=clearance)


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
def full(scene, state):
    """Run the reference path."""
    return reference_strobe(scene, state, 1, SLOTS, MIN_LANES, clearance=True)


def norms_of(matrices):
    """Return the norms of matrices, infinity where one is not known."""
    return np.nan_to_num(np.linalg.norm(np.asarray(matrices), axis=(1, 2)), nan=np.inf)


@of_numbers
def test_end_states(kind, number):
    """Over three periods there is a state exactly where the status says so, and none is impossible."""
    scene, start = kind.draw(generator(kind, number), MANY)
    alive, capped = np.ones(MANY, bool), 0
    for period in range(3):
        end, impacts = jax.device_get(jv.strobe(scene, start, slots=0))
        good = impacts.status < Status.CAP
        has_state, has_none = np.isfinite(end.x) & np.isfinite(end.v), np.isnan(end.x) & np.isnan(end.v)
        faults = {"a state": np.where(good, ~has_state, ~has_none)} | kind.mistakes(scene, start, end, impacts)
        for name, lanes in faults.items():
            wrong = np.flatnonzero(lanes & alive)
            assert not len(wrong), (name, period, len(wrong), at((scene, start, end, impacts), wrong[0]))
        capped += np.sum(alive & (impacts.status == Status.CAP))
        alive &= good
        start = jax.tree.map(partial(np.where, alive), end, start)
    assert alive.any()
    assert not kind.name.startswith("narrow") or capped > 0.05 * MANY


@of_numbers
def test_fast_path(kind, number):
    """What the fast path decides is what the reference path decides, with or without the clearance.

    It gives up what turns back within roundings of a wall.
    """
    scene, start = kind.draw(generator(kind, number), MANY)
    runs = jax.device_get((fast(scene, start), fast(scene, start, True), full(scene, start)))
    ((end, impacts), given_up), ((same_end, measured), more), (true, known) = runs
    pairs = (jax.tree.leaves(tree) for tree in ((end, impacts), (same_end, replace(measured, least_clearance=None))))
    assert_same(*((one[~more], other[~more]) for one, other in zip(*pairs, strict=True)))
    assert not np.any(given_up & ~more)
    other = (impacts.count != known.count) | (impacts.status != known.status) | (impacts.side != known.side).any(-1)
    assert not np.any(other & ~given_up)
    decided = ~given_up & (impacts.status < Status.CAP)
    bound = 1e-12 * wild.lengths(scene, start, true) * (1.0 + norms_of(jv.monodromy(scene, start, slots=64)))
    assert np.all((np.maximum(abs(end.x - true.x), abs(end.v - true.v)) <= bound)[decided])
    turns, near, far = decided & ~more, measured.least_clearance, known.least_clearance
    assert not np.any(turns & np.isinf(near) & np.isfinite(far))
    with np.errstate(invalid="ignore"):
        off = np.where(near == far, 0.0, near - far)
    assert np.all((off <= bound)[turns])
    assert np.all((off >= -bound)[turns])
    if kind.name == "grazing":
        assert given_up.all()
    elif kind.name == "chatter":
        after = np.asarray(scene.right.restitution) * np.nan_to_num(impacts.least_speed)
        assert 0 < given_up.sum() < len(given_up)
        assert after[~given_up & (impacts.count > 0)].min() > 2e-3  # a slower impact is not decided by the fast path
    else:
        assert given_up.mean() < (0.45 if kind.name.startswith("usual") else 0.9)


@jax.jit
def _jacobian(scene, state):
    """The derivatives of the strobe by x and v, (lanes, 2, 2)."""

    def end(x, v):
        last = jv.strobe(scene, replace(state, x=x, v=v), slots=0)[0]
        return jnp.stack([last.x, last.v], -1)

    ones = jnp.ones_like(state.x)
    columns = [jax.jvp(end, (state.x, state.v), tangent)[1] for tangent in ((ones, 0.0 * ones), (0.0 * ones, ones))]
    return jnp.stack(columns, -1)


@of_numbers
def test_carried_derivatives(kind, number):
    """Derivatives are those of the product of matrices in lanes of both paths, and nan where there is no end.

    A replay has 32 impacts; without them there is no derivative either.
    """
    scene, start = kind.draw(generator(kind, number), FEW)
    impacts = jax.device_get(jv.strobe(scene, start, slots=SLOTS)[1])
    slopes, product = np.asarray(_jacobian(scene, start)), np.asarray(jv.monodromy(scene, start, slots=64))
    unknown, ended = np.isnan(slopes).any((1, 2)), impacts.status < Status.CAP
    assert unknown[~ended].all() and not np.any(unknown & ended & (impacts.count <= 32))
    sure = np.isfinite(product).all((1, 2)) & ~unknown & (impacts.least_speed > 1e-2)
    bound = 1e-11 * np.maximum(1.0, abs(product).max((1, 2), keepdims=True)) ** 2  # slow impacts curve the map as well
    assert sure.mean() > 0.5 and np.all((abs(slopes - product) <= bound)[sure])
    assert 0 < fast(scene, start)[1].sum() < FEW  # both paths are taken


@of_numbers
def test_contacts(kind, number):
    """No contact of a first flight is missed or invented, with a wall that it nearly touches or hardly passes."""
    harmonics = [None if letter == "-" else "rm23".index(letter) for letter in kind.walls]
    periods = 1 + number % 2
    flown = flights.make_flights(number, MANY, *harmonics, periods)
    impacts = jax.device_get(jv.strobe(*wild.scene_of_flights(flown.lanes), periods=periods, slots=1)[1])
    assert np.all(impacts.status < Status.CAP)
    assert_same((impacts.side[:, 0], flown.side))
    assert np.all(abs(impacts.time[:, 0] - flown.time)[flown.contact] < 1e-5)


@of_numbers
def test_batches(kind, number):
    """Order, parts, `jit`, `vmap`, and periods one by one change no bit, whichever path a lane takes."""
    rng = generator(kind, number)
    scene, start = kind.draw(rng, FEW)
    scene = jax.tree.map(lambda leaf: np.broadcast_to(leaf, FEW), scene)  # each lane its own: one compiled shape
    run = partial(jv.strobe, slots=SLOTS)
    whole, order, part = jax.device_get(run(scene, start)), rng.permutation(FEW), slice(80, 80 + MIN_LANES + 7)
    pairs = [(run(*at((scene, start), order)), at(whole, order))]
    pairs += [(jax.jit(run)(*at((scene, start), part)), at(whole, part)), (jax.jit(jax.vmap(run))(scene, start), whole)]
    for computed, expected in pairs:
        assert_same(*zip(jax.tree.leaves(computed), jax.tree.leaves(expected), strict=True))
    thrice, total = run(scene, start, periods=3)
    end, counts = start, 0
    for _ in range(3):
        end, impacts = run(scene, end)
        counts = counts + np.asarray(impacts.count)
    assert_same((thrice.x, end.x), (thrice.v, end.v), (total.count, counts))
    assert 0 < fast(scene, start)[1].sum() < FEW  # both paths are taken


@of_numbers
def test_mirrored_lanes(kind, number):
    """Mirror images and lengths times powers of two give the same bits, in blocks of both paths, from rest too."""
    rng = generator(kind, number)
    scene, start = kind.draw(rng, FEW)
    start = replace(start, v=np.where(rng.random(FEW) < 0.3, 0.0, start.v))
    run = partial(jv.strobe, slots=SLOTS)
    end, impacts = run(scene, start)

    def changed(factor):
        def wall(given):
            return move(given, factor * given.position, lambda b, *rest: (factor * b, *rest))

        sides = (1, 0) if factor < 0 else (0, 1)
        return run(rebuild(scene, wall, sides, factor), replace(start, x=factor * start.x, v=factor * start.v))

    for factor in (-1.0, 2.0**-20, 2.0**13):
        image, others = changed(factor)
        assert_same((image.x, factor * end.x), (image.v, factor * end.v), (others.time, impacts.time))
        assert_same((others.side, np.sign(factor) * impacts.side))


@of_numbers
def test_slow_starts(kind, number):
    """A start on a wall with next to no speed goes as one without speed."""
    rng = generator(kind, number)
    scene, start = kind.draw(rng, MANY)
    (name, wall), *_ = scene.walls.items()
    position = wall_ends(scene, start.phase)[name == "right"]
    speed = wall_speed(scene, wall, start.phase)
    into = (-1.0 if name == "left" else 1.0) * 10.0 ** rng.uniform(-308.0, -9.0, MANY)
    into[::4] *= -1.0
    still, impacts = jv.strobe(scene, jv.State(position, speed, start.phase), slots=0)
    slow, others = jv.strobe(scene, jv.State(position, speed + into, start.phase), slots=0)
    good = np.asarray(impacts.status) < Status.CAP
    assert (np.asarray(others.status) < Status.CAP).mean() > 0.97
    assert np.array_equal(good, np.asarray(others.status) < Status.CAP)
    assert (abs(np.asarray(slow.x - still.x)) / (1.0 + np.asarray(scene.amplitude)))[good].max() < 1e-6


@of_numbers
def test_periods_in_one_call(kind, number):
    """Four periods in one call are one by one to their roundings, as the product of monodromy matrices grows them."""
    scene, state = kind.draw(generator(kind, number), FEW)
    whole, total = jax.device_get(jv.strobe(scene, state, periods=4, slots=0))
    states, motions = [state], []
    for _ in range(4):
        end, impacts = jax.device_get(jv.strobe(scene, states[-1], slots=0))
        states, motions = [*states, end], [*motions, impacts]
    product, norms = np.eye(2), np.ones(FEW)
    for each in states[-2:0:-1]:
        product = product @ np.asarray(jv.monodromy(scene, each))
        norms = norms + norms_of(product)
    span = 1.0 + 2.0 * np.pi / np.asarray(scene.frequency)
    bound = 16.0 * EPS * span * wild.lengths(scene, *states) * norms
    count, slowest = sum(each.count for each in motions), np.min([each.least_speed for each in motions], axis=0)
    fair = (count == total.count) & (slowest > 1e-4) & (norms < 1e6) & (total.status < Status.CAP)
    assert fair.mean() > 0.1
    error = np.maximum(abs(whole.x - states[-1].x), abs(whole.v - states[-1].v))
    assert np.all((error < bound)[fair])
    assert np.median((error / bound)[fair]) < 1e-2
