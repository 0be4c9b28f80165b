"""What must hold of every scene, over scenes that hypothesis draws number by number: eight lanes of one structure at a
time, so that a structure is compiled once.

All numbers lie on a grid of 2^-20, so that starts on walls, R = 0 and 1, no damping and resonance are among them. Where
two motions are the same to rounding alone, lanes are left out by `decided`: by the numbers of one of the two, never by
whether they agree.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxvibro as jv
from jaxvibro.scene.codes import Status

from .lanes import at

LANES, SLOTS, GRID = 8, 8, 2.0**20
FEW, MANY = 25, 50  # draws of eight lanes
TIMES = 2.0 ** np.array([-20, 13, 1, -1, 40, -3, 7, -60])
LATER = 2 * np.pi * np.array([1, -1, 2, -3, 5, 1, -7, 10])
HARMONICS = {"one": (None, None), "two": (None, None), "moving": (2, 2), "soft": (None, 2)}


def grid(low, high):
    """Numbers of the grid."""
    return st.integers(int(low * GRID), int(high * GRID)).map(lambda n: n / GRID)


def either(*ends, low, high):
    """Some numbers themselves, and what lies between others."""
    return st.one_of(*map(st.just, ends), grid(low, high))


LANE = st.tuples(
    grid(-9, 9),  # A
    either(1.0, low=0.25, high=16),  # omega
    either(0.0, 1.0, low=0, high=1.5),  # gamma
    grid(-4, 2),  # the left wall
    grid(0.3, 4),  # the gap
    *(either(0.0, 1.0, low=0, high=1) for _ in range(2)),  # R of each
    *(grid(0, 0.45) for _ in range(2)),  # swings over the gap
    *(grid(0, 6) for _ in range(2)),  # their phases
    either(0.0, low=0.01, high=0.99),  # where between the walls the start is
    grid(-5, 5),  # v
    grid(-6, 6),  # the drive's phase
)
DRAWN = st.lists(LANE, min_size=LANES, max_size=LANES).map(lambda rows: np.array(rows).T)


def made(kind, rows, elastic=False):
    """The scene of a kind, all its numbers (LANES,), and the start; elastic: without damping and with R = 1."""
    amplitude, omega, gamma, low, gap, *rest = rows
    bounces, swings, phases, (share, v, phase) = rest[0:2], rest[2:4], rest[4:6], rest[6:]
    if elastic:
        gamma, bounces = 0.0 * gamma, [np.ones(LANES), np.ones(LANES)]
    places, walls = [], []
    for place, bounce, swing, turn, harmonic in zip(
        (low, low + gap), bounces, swings, phases, HARMONICS[kind], strict=True
    ):
        motion = None if harmonic is None else jv.Motion(swing * gap, turn, harmonic)
        soft = kind == "soft" and not walls  # the left one, as stiff as R says, damped as the flight is
        law = {"stiffness": 5.0 + 200.0 * bounce} if soft else {"restitution": bounce}
        walls.append(jv.Wall(place, motion=motion, **law))
        places.append(place_of(walls[-1], phase))
    if kind == "one":
        walls[1], places[1] = None, places[0] + 3.0
    x = places[0] + share * (places[1] - places[0])
    scene = jv.make_scene(amplitude, omega, gamma, 0.7, tuple(walls))
    return scene, jv.State(x, v, phase, np.zeros(LANES))


def place_of(wall, phase):
    """Where a wall is at a phase of the drive."""
    own = wall.motion
    return wall.position + (own.amplitude * np.cos(own.harmonic * phase + own.phase) if own else 0.0)


def rebuilt(scene, wall, sign=1.0, sides=(0, 1)):
    """The scene with each wall changed by a function, the force times sign; sides: which wall comes first."""
    walls = scene.left, scene.right
    changed = tuple(None if walls[k] is None else wall(walls[k]) for k in sides)
    return jv.make_scene(sign * scene.amplitude, scene.frequency, scene.damping, scene.restitution, changed)


def moved(wall, place, motion):
    """The wall at another place; motion: a function of amplitude, phase and harmonic."""
    told = wall.motion and jv.Motion(*motion(wall.motion.amplitude, wall.motion.phase, wall.motion.harmonic))
    return jv.Wall(place, wall.restitution, wall.stiffness, wall.damping, told)


def mapped(scene, state):
    """(State, Impacts) of a period, as NumPy's arrays."""
    return jax.tree.map(np.asarray, jv.strobe(scene, state, 1, SLOTS, True))


def same(*pairs):
    """Bit for bit."""
    for found, true in pairs:
        assert np.array_equal(found, true, equal_nan=True)


def decided(scene, start, end, impacts):
    """Lanes whose motion no rounding turns: at most SLOTS impacts, none slower than 1e-2 or within 1e-3 of begin and
    end, no turning point within 1e-6 of a wall, a start that is off the walls; and how far roundings may grow."""
    period = 2 * np.pi / scene.frequency
    hits = np.where(np.isfinite(impacts.time), impacts.time, 0.5 * period[:, None])
    keep = (impacts.status < Status.CAP) & (impacts.count <= SLOTS) & (impacts.least_speed > 1e-2)
    keep &= (impacts.least_clearance > 1e-6) & (hits.min(-1) > 1e-3) & (hits.max(-1) < period - 1e-3)
    for state in (start, end):
        for wall in scene.walls.values():
            b, own, m = (
                (wall.motion.amplitude, wall.motion.phase, wall.motion.harmonic) if wall.motion else (0.0, 0.0, 1)
            )
            keep &= abs(state.x - wall.position - b * np.cos(m * state.phase + own)) > 1e-6
    slopes = np.asarray(jv.monodromy(scene, start, slots=SLOTS))
    keep &= np.isfinite(slopes).all((1, 2))
    size = sum(abs(each) for each in (start.x, start.v, end.x, end.v, scene.amplitude)) + 5.0
    return keep, size * (1.0 + np.linalg.norm(np.where(keep[:, None, None], slopes, 0.0), axis=(1, 2)))


def close(keep, bound, *pairs):
    """To rounding, on the lanes that are kept."""
    for found, true in pairs:
        assert np.all(abs(found - true)[keep] < 1e-10 * bound[keep])


def scaling(kind, rows):
    """Lengths times 2^k, k another on each lane, give the same bits times 2^k, and the same times and codes."""
    scene, state = made(kind, rows)
    grown = rebuilt(scene, lambda wall: moved(wall, TIMES * wall.position, lambda b, *more: (TIMES * b, *more)), TIMES)
    end, told = mapped(scene, state)
    large, heard = mapped(grown, replace(state, x=TIMES * state.x, v=TIMES * state.v))
    same((large.x, TIMES * end.x), (large.v, TIMES * end.v), (large.contact, end.contact), (heard.time, told.time))
    same((heard.side, told.side), (heard.count, told.count), (heard.status, told.status))
    same((heard.speed, TIMES[:, None] * told.speed), (heard.least_speed, TIMES * told.least_speed))
    same((heard.least_clearance, TIMES * told.least_clearance))


def mirror(kind, rows):
    """All turned over, the force by its sign, gives the same bits turned over; the force by half a turn of its phase,
    the same to rounding."""
    scene, state = made(kind, rows)
    over = partial(rebuilt, scene, sides=(1, 0))
    end, told = mapped(scene, state)
    turned = replace(state, x=-state.x, v=-state.v)
    image, heard = mapped(over(lambda wall: moved(wall, -wall.position, lambda b, *more: (-b, *more)), -1.0), turned)
    same((image.x, -end.x), (image.v, -end.v), (image.contact, -end.contact), (heard.time, told.time))
    same((heard.side, -told.side), (heard.speed, told.speed), (heard.count, told.count), (heard.status, told.status))
    same((heard.least_clearance, told.least_clearance))
    late = over(lambda wall: moved(wall, -wall.position, lambda b, own, m: (-b, own - m * np.pi, m)))
    alike(scene, state, (end, told), mapped(late, replace(turned, phase=state.phase + np.pi)), -1)


def shift(kind, rows):
    """A start some periods later is the same to the rounding of its phase."""
    scene, state = made(kind, rows)
    alike(scene, state, mapped(scene, state), mapped(scene, replace(state, phase=state.phase + LATER)), 1)


def alike(scene, start, one, other, sign):
    """Two motions from a start are the same to rounding, the other one's sides times sign."""
    (end, told), (image, heard) = one, other
    keep, bound = decided(scene, start, end, told)
    same((heard.side[keep], sign * told.side[keep]), (heard.count[keep], told.count[keep]))
    close(keep, bound, (sign * image.x, end.x), (sign * image.v, end.v))
    late, early = (np.where(np.isfinite(told.time), each.time, 0.0) for each in (heard, told))
    close(keep, bound, (late.max(-1), early.max(-1)), (late.sum(-1), early.sum(-1)))


def semigroup(kind, rows):
    """Two periods are one after another: bit for bit between rigid walls, else to rounding."""
    scene, state = made(kind, rows)
    end, told = mapped(scene, state)
    last, more = mapped(scene, end)
    both, heard = jax.tree.map(np.asarray, jv.strobe(scene, state, 2, 0))
    if kind == "soft":
        (keep, bound), (then, further) = decided(scene, state, end, told), decided(scene, end, last, more)
        close(keep & then, bound * further, (both.x, last.x), (both.v, last.v))
        return
    same((both.x, last.x), (both.v, last.v), (both.contact, last.contact))
    there = heard.status < Status.CAP
    same((heard.count[there], (told.count + more.count)[there]))


def sampled(kind, rows):
    """What `sample` gives at the ends of periods, times between them asked for too, is what the map gives."""
    scene, state = made(kind, rows)
    end, told = mapped(scene, state)
    last, more = mapped(scene, end)
    (keep, bound), (then, further) = decided(scene, state, end, told), decided(scene, end, last, more)
    times = 2 * np.pi / scene.frequency[:, None] * np.array([0.5, 1.0, 1.5, 2.0])
    found, _ = jv.sample(scene, state, times)
    x, v = np.asarray(found.x), np.asarray(found.v)
    close(keep, bound, (x[:, 1], end.x), (v[:, 1], end.v))
    close(keep & then, bound * further, (x[:, 3], last.x), (v[:, 3], last.v))


def order(kind, rows):
    """A batch in another order gives the same bits; single numbers, which are computed as scalars, to rounding."""
    scene, state = made(kind, rows)
    end, told = mapped(scene, state)
    turned = mapped(*at((scene, state), slice(None, None, -1)))
    same(*zip(jax.tree.leaves(at(turned, slice(None, None, -1))), jax.tree.leaves((end, told)), strict=True))
    keep, bound = decided(scene, state, end, told)
    for lane in range(LANES):
        alone, heard = mapped(*at((scene, state), lane))
        if keep[lane]:
            same((heard.side, told.side[lane]), (heard.status, told.status[lane]))
            assert max(abs(alone.x - end.x[lane]), abs(alone.v - end.v[lane])) < 1e-10 * bound[lane]


def chunks(kind, rows):
    """Halves of a batch, and batches of one, give the bits of the whole."""
    scene, state = made(kind, rows)
    whole = mapped(scene, state)
    for some in (slice(0, LANES // 2), slice(LANES // 2, LANES), *(slice(k, k + 1) for k in range(LANES))):
        part = mapped(*at((scene, state), some))
        same(*zip(jax.tree.leaves(part), jax.tree.leaves(at(whole, some)), strict=True))


@jax.jit
def slopes(scene, state):
    """The derivatives of the strobe by x and v, (LANES, 2, 2)."""

    def end(x, v):
        return (lambda there: jnp.stack([there.x, there.v], -1))(jv.strobe(scene, replace(state, x=x, v=v), 1, 0)[0])

    ones, none = jnp.ones(LANES), jnp.zeros(LANES)
    return jnp.stack([jax.jvp(end, (state.x, state.v), pair)[1] for pair in ((ones, none), (none, ones))], -1)


def derivative(kind, rows):
    """P Q is what autodiff gives."""
    scene, state = made(kind, rows)
    keep, _ = decided(scene, state, *mapped(scene, state))
    found, true = np.asarray(jv.monodromy(scene, state, slots=SLOTS)), np.asarray(slopes(scene, state))
    bound = 1e-10 * (1.0 + np.linalg.norm(np.where(keep[:, None, None], found, 0.0), axis=(1, 2)) ** 2)
    assert np.all(abs(found - true).max((1, 2))[keep] < bound[keep])


def areas(kind, rows):
    """det M = exp(-2 gamma T) times R^2 of each impact on a rigid wall; a soft one as damped as the flight changes
    nothing in it."""
    scene, state = made(kind, rows)
    end, told = mapped(scene, state)
    keep, _ = decided(scene, state, end, told)
    found = np.asarray(jv.monodromy(scene, state, slots=SLOTS))
    true = np.exp(-4.0 * np.pi * scene.damping / scene.frequency)
    for side, wall in scene.walls.items():
        hits = (told.side == (-1 if side == "left" else 1)).sum(-1)
        true = true if wall.soft else true * np.broadcast_to(wall.restitution, LANES) ** (2 * hits)
    bound = 1e-13 * (1.0 + np.linalg.norm(np.where(keep[:, None, None], found, 0.0), axis=(1, 2)) ** 2)
    assert np.all(abs(np.linalg.det(np.where(keep[:, None, None], found, 0.0)) - true)[keep] < bound[keep])


def reversal(kind, rows):
    """Without damping and with R = 1 the end, turned round, leads back to the start."""
    scene, state = made(kind, rows, elastic=True)
    end, told = mapped(scene, state)
    keep, bound = decided(scene, state, end, told)
    back = rebuilt(scene, lambda wall: moved(wall, wall.position, lambda b, own, m: (b, -own, m)))
    again, heard = mapped(back, jv.State(end.x, -end.v, -state.phase, 0.0 * end.x))
    for side in (-1, 1)[kind == "soft" :]:  # an entry into a soft wall is an exit on the way back
        same(((heard.side == side).sum(-1)[keep], (told.side == side).sum(-1)[keep]))
    close(keep, bound, (again.x, state.x), (-again.v, state.v))


FAST = [(reversal, "moving")]
SLOW = [(each, "moving") for each in (areas, order, shift, derivative, mirror)] + [(semigroup, "one"), (sampled, "one")]
LONG = [(each, "soft") for each in (scaling, shift, areas, reversal, semigroup)]
LONG += [(chunks, "moving"), (scaling, "moving"), (derivative, "one"), (mirror, "two")]
MARKED = [
    *(pytest.param(*each, marks=pytest.mark.slow) for each in SLOW),
    *(pytest.param(*each, marks=pytest.mark.long) for each in LONG),
]


def hold(check, kind, examples):
    """Whether a property holds of so many draws."""

    @settings(max_examples=examples)
    @given(rows=DRAWN)
    def holds(rows):
        check(kind, rows)

    holds()


@pytest.mark.parametrize(("check", "kind"), FAST)
def test_it_holds_of_any_scene(check, kind):
    hold(check, kind, FEW)


@pytest.mark.parametrize(("check", "kind"), MARKED)
def test_it_holds_of_many_scenes(check, kind):
    hold(check, kind, MANY)


def test_the_rule_leaves_most_lanes_in():
    rng, kept = np.random.default_rng(3), []
    low = [-9, 0.25, 0, -4, 0.3, 0, 0, 0, 0, 0, 0, 0.01, -5, -6]
    high = [9, 6, 1.5, 2, 4, 1, 1, 0.45, 0.45, 6, 6, 0.99, 5, 6]
    for _ in range(40):
        scene, state = made("moving", np.round(rng.uniform(low, high, (LANES, len(low))) * GRID).T / GRID)
        kept.append(decided(scene, state, *mapped(scene, state))[0])
    assert np.mean(kept) > 0.5
