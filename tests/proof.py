"""The library held against the references over random scenes: `python -m tests.proof strobe 10000` prints numbers."""

import sys
from collections import defaultdict
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from jaxvibro.flight import flow
from jaxvibro.maps import reference_strobe
from tests.lanes import at
from tests.reference import ball, draws, flights, orbit
from tests.reference.scene import Soft
from tests.reference.search import Discard

SLOTS = 64


def scene_of(scenes):
    """One batched jaxvibro scene from reference scenes of one structure."""

    def columns(records, names):
        return {name: np.array([getattr(each, name) for each in records]) for name in names}

    def wall(side):
        walls = [getattr(scene, side) for scene in scenes]
        if walls[0] is None:
            return None
        motion = None
        if walls[0].motion is not None:
            motions = [each.motion for each in walls]
            motion = jv.Motion(**columns(motions, ("amplitude", "phase")), harmonic=motions[0].harmonic)
        names = ("position", "stiffness", "damping") if isinstance(walls[0], Soft) else ("position", "restitution")
        return jv.Wall(**columns(walls, names), motion=motion)

    def term(k):
        terms = [scene.drive[k] for scene in scenes]
        return jv.Motion(**columns(terms, ("amplitude", "phase")), harmonic=terms[0].harmonic)

    plain = columns(scenes, ("amplitude", "omega", "gamma")).values()
    drive = [term(k) for k in range(len(scenes[0].drive))]
    return jv.make_scene(*plain, 0.5, (wall("left"), wall("right")), drive=drive)


def batch(drawn):
    """The batched scene and start of draws of one structure."""
    start = jv.State(*(jnp.array([getattr(draw, key) for draw in drawn]) for key in ("x", "v", "phase")))
    return scene_of([draw.scene for draw in drawn]), start


def structure(scene):
    """What of a scene is static: the walls there are, and the harmonics of those that move."""
    walls = (scene.left, scene.right)
    return tuple(None if w is None else (w.motion.harmonic if w.motion else 0) for w in walls)


def gather(count, seed=0, kinds=None, periods=1, slowest=0.0):
    """The first draws of these structures (None: all) that keep the rules, as lists of (draw, record), a list a
    structure; and how many were discarded.

    kinds: a compilation is due for each of them, so a test takes few. slowest: every impact is faster.
    """
    groups, fair, discarded = defaultdict(list), 0, 0
    while fair < count:
        draw = draws.draw(seed)
        seed += 1
        if kinds and structure(draw.scene) not in kinds:
            continue
        try:
            record = orbit.strobe(*draw, periods=periods)
        except Discard:
            discarded += 1
            continue
        if record.least_speed > slowest:
            fair += 1
            groups[structure(draw.scene)].append((draw, record))
    return list(groups.values()), discarded


def strobe_errors(count, seed=0):
    """For draws that keep the table's rules: error over 1e-12 scale (1 + norm), and whether the itinerary is right."""
    groups, discarded = gather(count, seed)
    return np.array([row for members in groups for row in _compare(*zip(*members, strict=True))]), discarded


product = partial(jv.monodromy, slots=SLOTS)


def monodromy_errors(count, seed=0, kinds=None, run=product):
    """For the same draws (of some structures only): error of M over the product of its factors' norms; run: how M of a
    batch is found."""
    groups, _ = gather(count, seed, kinds)
    errors = []
    for members in groups:
        drawn, records = zip(*members, strict=True)
        found = np.asarray(run(*batch(drawn)))
        true = np.array([record.jacobian for record in records])
        errors += list(np.abs(found - true).max((1, 2)) / [record.product for record in records])
    return np.array(errors)


@jax.jit
def _full(scene, state):
    return reference_strobe.reference_strobe(scene, state, 1, SLOTS, 1, clearance=True)


def _compare(drawn, records):
    """The rows of some draws: of the map in two tiers and of full steps alone, the worse."""
    runs = jv.strobe(*batch(drawn), slots=SLOTS, clearance=True), _full(*batch(drawn))
    rows = []
    for k, record in enumerate(records):
        error, wrong, times, paces = np.max([_errors(*at(run, k), record) for run in runs], axis=0)
        bound, least = 1e-12 * record.scale * (1 + record.norm), [float(run[1].least_clearance[k]) for run in runs]
        close = max(0.0 if one == record.least_minimum else abs(one - record.least_minimum) for one in least)
        rows.append((error / bound, not wrong, times, paces / bound, close / bound, record.count))
    return rows


def _errors(end, impacts, record):
    """Of a lane: the error of the state, whether its itinerary is wrong, the errors of times and speeds."""
    sides = [int(side) for side in impacts.side if side]
    wrong = sides != [int(side) for side in record.sides] or impacts.status != 0
    error = max(abs(float(record.x - end.x)), abs(float(record.v - end.v)))
    if wrong:
        return error, wrong, np.inf, np.inf

    def worst(true, found):
        return max((abs(float(one - other)) for one, other in zip(true, found[: len(true)], strict=True)), default=0.0)

    return error, wrong, worst(record.times, impacts.time), worst(record.speeds, impacts.speed)


def first_flights(count, left, right, periods, seed=0):
    """(flights, contacts missed, invented, wrong wall, largest error of the time over its condition)."""
    flown = flights.make_flights(seed, count, left, right, periods)
    lanes = flown.lanes

    def wall(side):
        for each in lanes.walls:
            if each.side == side:
                motion = None
                if each.harmonic:
                    motion = jv.Motion(double(each.swing), double(each.phase), int(each.harmonic))
                return jv.Wall(double(each.position), 0.7, motion=motion)
        return None

    scene = jv.make_scene(*map(double, (lanes.amplitude, lanes.omega, lanes.gamma)), 0.7, (wall(-1), wall(1)))
    start = jv.State(*map(double, (lanes.x, lanes.v, lanes.phase)))
    impacts = jax.jit(lambda scene, start: jv.strobe(scene, start, periods=periods, slots=1)[1])(scene, start)
    time, side = np.asarray(impacts.time)[:, 0], np.asarray(impacts.side)[:, 0]
    assert np.all(np.asarray(impacts.status) < 2), np.bincount(np.asarray(impacts.status))
    hit = side != 0
    missed, invented = flown.contact & ~hit, ~flown.contact & hit
    wrong = flown.contact & hit & ((side != flown.side) | (abs(time - double(flown.time)) > 1e-5))
    return count, int(missed.sum()), int(invented.sum()), int(wrong.sum())


def double(values):
    """The values as float64."""
    return np.asarray(values, dtype=np.float64)


def flow_errors(count, seed=0):
    """Errors of `flow.fly` over 1e-13 (1 + t)^2 (abs x + abs v + A), against ball arithmetic."""
    rng = np.random.default_rng(seed)
    gamma, omega = rng.uniform(0, 5, count), np.exp(rng.uniform(np.log(0.05), np.log(20), count))
    gamma[::7], gamma[1::7] = (
        0.0,
        1.0 + rng.choice([-1, 0, 1], len(gamma[1::7])) * 10.0 ** -rng.integers(1, 16, len(gamma[1::7])),
    )
    omega[::5], omega[1::5] = (
        1.0,
        1.0 + 10.0 ** -rng.integers(1, 16, len(omega[1::5])) * rng.choice([-1, 1], len(omega[1::5])),
    )
    amplitude, time, phase = rng.uniform(0, 10, count), rng.uniform(0, 10, count), rng.uniform(0, 2 * np.pi, count)
    x, v = rng.normal(0, 2, (2, count))
    scene = jv.make_scene(amplitude, omega, gamma, 1.0, (None, None))
    fly = flow.fly
    at_x, at_v = map(np.asarray, fly(scene, jv.State(x, v, phase), time))
    rows = []
    for k in range(count):
        true = ball.flow(*(float(a[k]) for a in (gamma, omega, amplitude, phase, x, v, time)))
        error = max(abs(float(true[0] - at_x[k])), abs(float(true[1] - at_v[k])))
        rows.append(error / (1e-13 * (1 + time[k]) ** 2 * (abs(x[k]) + abs(v[k]) + amplitude[k])))
    return np.array(rows)


STRUCTURES = [(0, 0), (0, None), (None, 0), (1, 0), (0, 2), (3, None), (None, 1), (1, 2)]


def main(what, count):
    """Print one row of the table."""
    jax.config.update("jax_enable_x64", True)
    if what == "flow":
        errors = flow_errors(count)
        print(f"flow: {count} flights, largest error over its bound {errors.max():.3g}")
    if what == "strobe":
        rows, discarded = strobe_errors(count)
        print(f"strobe: {count} draws ({discarded} discarded), itineraries wrong {int((rows[:, 1] == 0).sum())}")
        state, _, times, speeds, clearance, _ = rows.max(axis=0)
        print(f"largest over the bound: state {state:.3g}, speeds {speeds:.3g}; of a time {times:.3g}")
        far = int((rows[:, 4] > 1).sum())
        print(f"clearance: {far} over the bound, largest of the others {rows[rows[:, 4] <= 1, 4].max():.3g}")
        print(f"impacts a draw: {rows[:, 5].mean():.2f}; largest clearance error over the bound {clearance:.3g}")
    if what == "monodromy":
        errors = monodromy_errors(count)
        print(f"monodromy: {count} draws, largest error over the product of the norms {errors.max():.3g}")
    if what == "flights":
        for left, right in STRUCTURES:
            for periods in (1, 2):
                print("flights", (left, right), "periods", periods, first_flights(count // 16, left, right, periods))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
