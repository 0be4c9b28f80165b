"""Statuses and end states of degenerate scenes: `python -m tests.degenerate_proof 1000000 [structure ...]`.

Draws lanes over every subset of drive, spring, damping, constant force and walls at 0, with R from 0 to 1, and strobes
each lane three times in a row. Counts the lanes

- beyond a rigid wall with a good status,
- with nan and a good status,
- with a bad status although the start is valid and there were few impacts,
- at rest that leave a still wall which presses them on,
- without drive on still rigid walls that gain energy.
"""

import sys
import time
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.scene.codes import Contact, Status

BLOCK = 2000  # lanes of a call
CALLS = 3  # strobes of each lane
ROUNDINGS = 64.0  # of the largest length, by which a state may be beyond a wall
FEW = 500  # impacts: the caps are 1,000 of them, and some steps for each
KINDS = ("beyond", "blank", "faulty", "released", "gained")


@dataclass(frozen=True)
class Structure:
    """What is compiled once.

    force: "linear" (spring and damper), "constant" (the same with a constant force), "polynomial", "cubic" (drag) or
    "solver"; walls: letters of the left and the right wall, "-" none, "r" rigid, "m" rigid and moving, "s" soft.
    """

    force: str
    walls: str
    dtype: type = np.float64

    @property
    def name(self):
        return f"{self.force} {self.walls}{' single' if self.dtype is np.float32 else ''}"


LINEAR = [Structure("linear", walls) for walls in ("r-", "-r", "rr", "m-", "rm", "s-", "rs", "--")]
CONSTANT = [Structure("constant", walls) for walls in ("r-", "rr", "mr", "sr", "--")]
POLYNOMIAL = [Structure("polynomial", walls) for walls in ("r-", "-r", "rr", "m-", "s-", "rs", "--")]
OTHERS = [Structure("cubic", "r-"), Structure("cubic", "rr"), Structure("solver", "r-"), Structure("solver", "rr")]
SINGLE = [Structure(force, "r-", np.float32) for force in ("linear", "polynomial", "solver")]
STRUCTURES = LINEAR + CONSTANT + POLYNOMIAL + OTHERS + SINGLE


def cubic_drag(t, x, v, p):
    """A constant force, a spring, and drag by the cube of the speed."""
    return -p["c0"] - p["c1"] * x - p["damping"] * v**3


def draw(rng, count, structure):
    """(scene, start) of random lanes of a structure."""

    def logarithmic(low, high):
        return 10.0 ** rng.uniform(low, high, count)

    def some(values, share, *instead):
        return np.where(rng.random(count) < share, rng.choice(instead, count), values)

    single = structure.dtype is np.float32
    unit = 2.0 ** np.round(rng.uniform(-20.0, 20.0, count))
    if single or structure.force == "cubic":
        unit = np.ones(count)
    gap, phase = logarithmic(-3.0, 0.5), rng.uniform(0.0, 2.0 * np.pi, count)
    left, right, at = structure.walls[0] != "-", structure.walls[1] != "-", rng.integers(0, 3, count)
    place = np.where(at == 0, rng.uniform(-1.0, 1.0, count), 0.0)  # of the wall, or of one of two
    places = [np.where(at == 2, place - gap, place), np.where(at == 2, place, place + gap)]
    if left != right:
        places = [place, place + gap] if left else [place - gap, place]
    walls, ends = [], []
    for letter, where in zip(structure.walls, places, strict=True):
        if letter == "-":
            walls.append(None)
            ends.append(where)
            continue
        swing, turn = gap * rng.uniform(0.0, 0.3, count), rng.uniform(0.0, 2.0 * np.pi, count)
        motion = jv.Motion(swing * unit, turn) if letter == "m" else None
        own = {"restitution": some(rng.random(count), 0.4, 0.0, 1.0, 0.999)}
        if letter == "s":
            own = {"stiffness": logarithmic(0.0, 4.0), "damping": some(rng.random(count), 0.5, 0.0)}
        walls.append(jv.Wall(where * unit, motion=motion, **own))
        ends.append(where + (swing * np.cos(phase + turn) if letter == "m" else 0.0))
    amplitude = some(logarithmic(-2.0, 1.0), 0.5, 0.0) * unit
    omega, damping = logarithmic(-1.0, 0.7), some(rng.uniform(0.0, 2.0, count), 0.5, 0.0)
    constant = some(logarithmic(-2.0, 1.5) * rng.choice([-1.0, 1.0], count), 0.3, 0.0) * unit
    spring = some(rng.uniform(0.0, 2.0, count), 0.5, 0.0)
    terms = {"damping": damping}
    if structure.force == "constant":
        terms["drive"] = ((constant, 0, 0.0),)
    elif structure.force != "linear":
        given = {"c0": constant, "c1": spring, "damping": damping}
        function, solver = "polynomial", "Dopri8" if structure.force == "solver" else None
        if structure.force == "cubic":
            function = cubic_drag
        tolerance = 1e-6 if single else 1e-10 if solver else 1e-13
        terms = {"force": jv.Force(function, given, tolerance=tolerance, solver=solver)}
    scene = jv.make_scene(amplitude, omega, restitution=0.5, walls=tuple(walls), **terms)
    if single:
        scene = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), scene)
    share = some(rng.random(count) ** 3, 0.3, 0.0, 1.0)
    if "m" in structure.walls:
        share = np.clip(share, 1e-6, 1.0 - 1e-6)  # where a wall is, is rounded to whoever works it out
    x = np.clip(ends[0] + share * (ends[1] - ends[0]), *ends) * unit
    speed = some(logarithmic(-2.0, 0.7), 0.4, 0.0) * rng.choice([-1.0, 1.0], count) * unit
    state = jv.State(x, speed, phase, np.zeros(count))
    state = jax.tree.map(lambda leaf: np.asarray(leaf, structure.dtype), state)
    return scene, resting(rng, scene, state, structure)


def resting(rng, scene, state, structure):
    """The state with some lanes that rest on a rigid wall, or have landed on it."""
    x, v, contact = (np.array(each) for each in (state.x, state.v, state.contact))
    for sign, letter, wall in zip((-1, 1), structure.walls, (scene.left, scene.right), strict=True):
        if letter != "r":
            continue
        lanes = rng.random(len(x)) < 0.2
        rests = rng.random(len(x)) < 0.7
        x = np.where(lanes, wall.position, x)
        v = np.where(lanes, np.where(rests, 0.0, -sign * abs(v)), v)
        contact = np.where(lanes, sign * np.where(rests, Contact.STUCK, Contact.LANDED), contact)
    return replace(state, x=x, v=v, contact=contact.astype(x.dtype))


def wall_places(scene, phase):
    """[(sign, position, largest distance)] of the rigid walls."""
    found = []
    for sign, wall in ((-1.0, scene.left), (1.0, scene.right)):
        if wall is None or wall.soft:
            continue
        where, swing = np.asarray(wall.position), 0.0
        if wall.motion is not None:
            swing = np.asarray(wall.motion.amplitude)
            where = where + swing * np.cos(wall.motion.harmonic * phase + np.asarray(wall.motion.phase))
        found.append((sign, where, abs(np.asarray(wall.position)) + abs(swing)))
    return found


def pull(scene, structure, x, v, phase):
    """The acceleration of a free mass, and the potential energy of one without a drive."""
    drive = np.asarray(scene.amplitude) * np.cos(phase)
    if scene.force is None:
        constant = -np.asarray(scene.drive[0].amplitude) if scene.drive else 0.0
        spring, drag = 1.0, 2.0 * np.asarray(scene.damping) * v
    else:
        constant, spring = (np.asarray(scene.force.numbers[key]) for key in ("c0", "c1"))
        drag = np.asarray(scene.force.numbers["damping"])
        drag = drag * v**3 if structure.force == "cubic" else 2.0 * drag * v
    return drive - constant - spring * x - drag, constant * x + 0.5 * spring * x * x


def judged(structure, scene, start, end, impacts):
    """{kind of mistake: mask of lanes} of a strobe."""
    eps = float(np.finfo(structure.dtype).eps)
    before = [np.asarray(each, float) for each in (start.x, start.v, start.phase, start.contact)]
    x, v, _, contact = (np.asarray(each, float) for each in (end.x, end.v, end.phase, end.contact))
    status, count = np.asarray(impacts.status), np.asarray(impacts.count)
    good, span = status < Status.CAP, 2.0 * np.pi / np.asarray(scene.frequency)
    beyond, released = np.zeros(x.shape, bool), np.zeros(x.shape, bool)
    force, energy = pull(scene, structure, before[0], before[1], before[2])
    fastest = abs(before[1]) + np.asarray(scene.amplitude) * span + abs(force) * span
    size = abs(before[0]) + fastest * span
    still = np.asarray(scene.amplitude) == 0
    for sign, where, distance in wall_places(scene, before[2]):
        beyond |= good & (sign * (x - where) > ROUNDINGS * eps * (distance + size))
        pressed = still & (before[3] == sign * Contact.STUCK) & (sign * force > 0)
        released |= good & pressed & ((x != where) | (v != 0) | (contact != sign * Contact.STUCK))
    moves = "m" in structure.walls
    gained = np.zeros(x.shape, bool)
    if not moves and "s" not in structure.walls:
        _, later = pull(scene, structure, x, v, before[2])
        far = size + sum(distance for *_, distance in wall_places(scene, before[2]))
        near = 1e4 * (scene.force.tolerance if scene.force else eps) * far
        loose = near * (abs(force) + abs(before[1]) + abs(v) + near) + ROUNDINGS * eps * (abs(energy) + abs(later))
        gained = good & still & (0.5 * v * v + later > 0.5 * before[1] ** 2 + energy + loose)
    faulty = (status == Status.INVALID) | (status == Status.NONFINITE)
    # Steps within soft walls are counted for all lanes of a block together; in single precision one lane in a thousand
    # takes more steps than are allowed, and its status says so.
    if "s" not in structure.walls and structure.dtype is np.float64:
        faulty |= (status == Status.CAP) & (count < FEW)
    return {
        "beyond": beyond,
        "blank": good & ~(np.isfinite(x) & np.isfinite(v)),
        "faulty": faulty,
        "released": released & ~np.array(moves),
        "gained": gained,
    }


def tried(rng, structure, count):
    """(counts of the `KINDS`, [(kind, call, scene, start, end, status, count)] of some mistakes) of random lanes."""
    scene, start = draw(rng, count, structure)
    counts, first, alive = np.zeros(len(KINDS), int), [], np.ones(count, bool)
    for call in range(CALLS):
        end, impacts = jax.device_get(jv.strobe(scene, start, slots=0))
        found = judged(structure, scene, start, end, impacts)
        for k, kind in enumerate(KINDS):
            wrong = np.flatnonzero(found[kind] & alive)
            counts[k] += len(wrong)
            for lane in wrong[:2]:
                own = jax.tree.map(lambda leaf, lane=lane: leaf[lane] if np.ndim(leaf) else leaf, (scene, start, end))
                first.append((kind, call, *own, int(impacts.status[lane]), int(impacts.count[lane])))
        alive &= np.asarray(impacts.status) < Status.CAP
        start = jax.tree.map(partial(np.where, alive), end, start)
    return counts, first


def main(count, names=()):
    """Print the counts, a line a structure and one of all; the first mistakes of each."""
    jax.config.update("jax_enable_x64", True)
    chosen = [each for each in STRUCTURES if not names or each.name in names]
    total, lanes = np.zeros(len(KINDS), int), 0
    for k, structure in enumerate(chosen):
        rng, own, begun, first = np.random.default_rng([58, k]), np.zeros(len(KINDS), int), time.perf_counter(), []
        blocks = -(-count // (BLOCK * len(chosen)))
        for _ in range(blocks):
            found, mistakes = tried(rng, structure, BLOCK)
            own += found
            first += mistakes
        total, lanes = total + own, lanes + blocks * BLOCK
        print(told(structure.name, blocks * BLOCK, own), f"{time.perf_counter() - begun:.0f} s", flush=True)
        for mistake in first[:4]:
            print("   ", mistake, flush=True)
    print(told("all", lanes, total))


def told(name, lanes, counts):
    """A row of counts in words."""
    return f"{name}: {lanes} lanes; " + ", ".join(f"{kind} {n}" for kind, n in zip(KINDS, counts, strict=True))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
