"""What lean steps decide is what the full ones do: `python -m tests.tiers_proof maps 1000000` prints counts.

`maps` takes random scenes with rigid walls of all kinds, usual ones and far ends, `grazing` flights that turn back
within 64 ulp of a wall on either side, `chatter` masses that hop on a wall or rest on it; `bits` cuts and permutes
batches, calls from a loop, a vmap and by the period, and mirrors and scales lanes that lean steps decide and lanes that
they give up.
"""

import sys
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.compiled.lane_arithmetic import COMPILER_OPTIONS
from jaxvibro.compiled.lane_blocks import MIN_LANES
from jaxvibro.maps import reference_strobe, two_tier_strobe
from tests.lanes import at
from tests.status_proof import RIGID, draw

BLOCK = 1 << 16  # lanes of a scene
SLOTS = 8


class Compared(NamedTuple):
    """Of lanes: how many were given up; of the others, how many have other impacts or another status than by full
    steps, or no turning point where those have one; the largest error of x and v over 1e-12 scale (1 + the norm of M),
    and by how much more a least clearance is off; how many are nearer to a wall than by full steps, which lose one
    turning point of some thousands beside walls that move; and how many have other bits than without the clearance."""

    lanes: int
    given_up: int
    wrong: int
    error: float
    clearance: float
    nearer: int
    bits: int


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
def lean(scene, start):
    return two_tier_strobe.fast_strobe(scene, start, SLOTS, MIN_LANES)


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
def measured(scene, start):
    return two_tier_strobe.fast_strobe(scene, start, SLOTS, MIN_LANES, clearance=True)


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
def full(scene, start):
    return reference_strobe.reference_strobe(scene, start, 1, SLOTS, MIN_LANES, clearance=True)


def compared(scene, start):
    """The `Compared` of some lanes: with a slow impact by either, below 1e-6 of the scale, M is not asked for."""
    runs = lean(scene, start), measured(scene, start), full(scene, start)
    ((end, impacts), given_up), ((also, told), more), (true, known) = jax.device_get(runs)
    bits = _changed((end, impacts), (also, told), more) | (given_up & ~more)
    other = (impacts.count != known.count) | (impacts.status != known.status) | (impacts.side != known.side).any(-1)
    decided = ~given_up & (impacts.status < 2)
    matrix = np.nan_to_num(np.linalg.norm(np.asarray(jv.monodromy(scene, start, slots=64)), axis=(1, 2)), nan=np.inf)
    scale = np.max([abs(np.asarray(each)) for each in (scene.amplitude, start.x, start.v, true.x, true.v)], axis=0)
    for wall in scene.walls.values():
        swing = 0.0 if wall.motion is None else abs(np.asarray(wall.motion.amplitude))
        scale = np.maximum(scale, abs(np.asarray(wall.position)) + swing)
    error = np.maximum(abs(end.x - true.x), abs(end.v - true.v)) / (1e-12 * scale * (1.0 + matrix))
    fair, near, far = decided & ~other, told.least_clearance, known.least_clearance
    missed = np.isinf(near) & np.isfinite(far) & decided & ~more
    with np.errstate(invalid="ignore"):
        off = np.where(near == far, 0.0, near - far) / (1e-12 * scale * (1.0 + matrix))
    turns, wrong = fair & ~more & ~missed, (other & ~given_up) | missed
    return Compared(
        lanes=len(given_up),
        given_up=int(given_up.sum()),
        wrong=int(wrong.sum()),
        error=float(error[fair].max(initial=0)),
        clearance=float(off[turns].max(initial=0)),
        nearer=int((off[turns] < -1.0).sum()),
        bits=int(bits.sum()),
    )


def _changed(one, other, given_up):
    """The lanes that are decided and have other bits of what both runs tell."""
    plain = other[0], replace(other[1], least_clearance=None)
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(plain), strict=True)
    parts = [((a != b) & ~(np.isnan(a) & np.isnan(b))).reshape(len(given_up), -1).any(1) for a, b in pairs]
    return np.any(parts, axis=0) & ~given_up


def usual(rng, count, kind):
    """(scene, start) of random lanes as users draw them, with walls of a kind; `draw` takes the far ends."""
    walls, ends = [], []
    for sign, given in zip((-1.0, 1.0), kind, strict=True):
        if given is None:
            walls.append(None)
            ends.append(np.full(count, 0.2 * sign))
            continue
        where, phase = sign * rng.uniform(0.3, 2.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
        motion = jv.Motion(rng.uniform(0.0, 0.2, count), phase, given[1]) if given[1] else None
        walls.append(jv.Wall(where, rng.uniform(0.1, 1.0, count), motion=motion))
        ends.append(where if motion is None else where + motion.amplitude * np.cos(phase))
    amplitude, omega, damping = rng.uniform((0.0, 0.5, 0.0), (6.0, 6.0, 1.2), (count, 3)).T
    start = jv.State(rng.uniform(*ends), rng.normal(0.0, 2.0, count), np.zeros(count), np.zeros(count))
    return jv.make_scene(amplitude, omega, damping, 0.5, tuple(walls)), start


def grazing(rng, count):
    """(scene, start): flights that turn back up to so many ulp of the largest length beyond the right wall."""
    amplitude, omega = 10.0 ** rng.uniform(-1.0, 1.0, (2, count))
    x, v, (phase, damping, bounce) = rng.uniform(-1, 1, count), rng.normal(size=count), rng.uniform(size=(3, count))
    scene, top = jv.make_scene(amplitude, omega, damping, bounce, (None, np.zeros(count))), np.full(count, 1e3)
    start = jv.State(x, v, 6.0 * phase, np.zeros(count))
    for beyond in (0.0, 1.0):  # the clearance from far away, then from nearby: that is exact to an ulp
        far = scene.replace(**{"right.position": top + beyond})
        told = jax.device_get(jv.strobe(far, start, slots=0, clearance=True)[1])
        fair = np.isfinite(told.least_clearance) & (told.count == 0)
        top = np.where(fair, top + beyond - told.least_clearance, 20.0)
    keep = (top < 20.0) & (top > x + 1e-3)
    size = np.max([abs(x), abs(v), amplitude, abs(top)], axis=0)
    ulp = rng.uniform(-64.0, 64.0, count)
    scene = scene.replace(**{"right.position": top - ulp * np.finfo(float).eps * size})
    return at((scene, start), keep)


def chatter(rng, count):
    """(scene, start): masses that hop on a wall that presses them, or rest there, the press ending in the period."""
    omega, phase = rng.uniform(0.2, 1.0, count), rng.uniform(-2.0, 2.0, count)
    bounce = rng.choice([0.0, 0.2, 0.5, 0.8], count)
    walls = (jv.Wall(np.full(count, side), bounce) for side in (-1.0, 1.0))
    scene = jv.make_scene(rng.uniform(1.5, 4.0, count), omega, np.full(count, 0.1), 0.5, tuple(walls))
    hop = 10.0 ** rng.uniform(-6.0, -0.5, count)
    return scene, jv.State(1.0 - hop * rng.random(count), hop, phase, np.zeros(count))


def same(one, other):
    """Whether two trees hold the same bits."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True) for a, b in pairs)


def bits(rng, count, kind):
    """Names of what has changed a bit, of lanes of a kind, a few of which are given up."""
    scene, start = draw(rng, count, kind)
    numbers = jax.tree.map(lambda leaf: np.broadcast_to(leaf, count), scene)  # each lane its own: one compiled shape
    run = partial(jv.strobe, slots=SLOTS)
    whole, order, wrong = run(numbers, start), rng.permutation(count), []

    def part(tree, lanes):
        return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], tree)

    def check(name, found, expected):
        if not same(found, expected):
            wrong.append(name)

    check("permuted", run(*part((numbers, start), order)), part(whole, order))
    cut = slice(count // 3, count // 3 + MIN_LANES + 7)
    check("cut", run(*part((numbers, start), cut)), part(whole, cut))
    check("jit", jax.jit(run)(numbers, start), whole)
    check("vmap", jax.jit(jax.vmap(run))(numbers, start), whole)
    twice = run(*(numbers, start), periods=3)
    end, counts = start, 0
    for _ in range(3):
        end, impacts = run(numbers, end)
        counts = counts + np.asarray(impacts.count)
    check("periods", (twice[0], twice[1].count), (end, counts))
    mirrored = _mirrored(numbers), jv.State(-start.x, -start.v, start.phase, -start.contact)
    image, told = run(*mirrored)
    check("mirror", (-image.x, -image.v, told.time, -told.side), (whole[0].x, whole[0].v, whole[1].time, whole[1].side))
    for power in (-20, 13):
        k = 2.0**power
        grown, told = run(_scaled(numbers, k), jv.State(k * start.x, k * start.v, start.phase, start.contact))
        check("scaled", (grown.x / k, grown.v / k, told.time), (whole[0].x, whole[0].v, whole[1].time))
    return wrong, int(np.asarray(lean(numbers, start)[1]).sum())


def _scaled(scene, k):
    names = {"amplitude": k * scene.amplitude}
    for side, wall in scene.walls.items():
        names[f"{side}.position"] = k * wall.position
        if wall.motion is not None:
            names[f"{side}.motion.amplitude"] = k * wall.motion.amplitude
    return scene.replace(**names)


def _mirrored(scene):
    """The scene turned over, its force and its walls': the same motion with another sign."""

    def wall(given):
        if given is None:
            return None
        motion = given.motion
        if motion is not None:
            motion = jv.Motion(-motion.amplitude, motion.phase, motion.harmonic)
        return jv.Wall(-given.position, given.restitution, motion=motion)

    return jv.make_scene(
        -scene.amplitude, scene.frequency, scene.damping, scene.restitution, (wall(scene.right), wall(scene.left))
    )


def main(what, count):
    """Print what was found, a line a kind of scene."""
    jax.config.update("jax_enable_x64", True)
    rng, kinds = np.random.default_rng(23), RIGID[1:]
    if what == "bits":
        for kind in kinds:
            print(kind, *bits(rng, count // len(kinds), kind), flush=True)
        return
    draws = {"grazing": [grazing], "chatter": [chatter]}
    if what == "maps":
        draws = {f"{one.__name__} {kind}": [one, kind] for kind in kinds for one in (usual, draw)}
    for name, (make, *kind) in draws.items():
        rows, left = [], count // len(draws)
        while left > 0:
            rows.append(compared(*make(rng, BLOCK, *kind)))
            left -= rows[-1].lanes
        lanes, given_up, wrong, error, clearance, nearer, other = zip(*rows, strict=True)
        worst = max(error), max(clearance)
        found = Compared(sum(lanes), sum(given_up), sum(wrong), *worst, sum(nearer), sum(other))
        print(name, found, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(float(sys.argv[2])))
