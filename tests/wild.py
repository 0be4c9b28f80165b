"""Random scenes at the far ends of their numbers: batches of many lanes, drawn from a random generator.

wild: amplitudes to 1e3, gaps from 1e-6, damping to 3, frequencies from 0.05 to 20. narrow: the same, nearly elastic,
with little room, so that many lanes reach the cap on impacts. usual: kinds of `tests/kinds.py`. degenerate: subsets of
drive, spring, damping, constant force, and walls at 0.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np

import jaxvibro as jv

from . import kinds
from .lanes import at
from .properties.motions import Contact, Status

ROUNDINGS = 64.0  # of the largest length, by which a state may lie beyond a wall
FEW = 500  # impacts: the caps are 1,000 of them, and some steps for each
PLAIN = {"share": (0.1, 0.9, ()), "left_restitution": (0.1, 1.0, ()), "right_restitution": (0.1, 1.0, ())}
HARMONICS = {"r": 0, "s": 0, "m": 1, "t": 1, "2": 2, "3": 3}  # of walls: rigid; soft; moving; soft and moving


def logarithmic(rng, count, low, high):
    """Draw numbers whose decimal logarithms are uniform."""
    return 10.0 ** rng.uniform(low, high, count)


def mixed(rng, values, share, *instead):
    """Replace a share of values by others."""
    count = np.shape(values)[0]
    return np.where(rng.random(count) < share, rng.choice(instead, count), values)


def make_walls(rng, letters, positions, swings, phase, law):
    """Return walls, and their positions at a drive phase; law: function of a letter to the numbers of an impact."""
    walls, ends = [], []
    for letter, position, swing in zip(letters, positions, swings, strict=True):
        if letter == "-":
            walls.append(None)
            ends.append(position)
            continue
        harmonic, turn = HARMONICS[letter], rng.uniform(0.0, 6.28, len(phase))
        walls.append(jv.Wall(position, motion=jv.Motion(swing, turn, harmonic) if harmonic else None, **law(letter)))
        ends.append(position + (swing * np.cos(harmonic * phase + turn) if harmonic else 0.0))
    return tuple(walls), ends


def lengths(scene, *states):
    """Return the largest length and speed of each lane: of the drive, the walls and the states."""
    size = np.asarray(scene.amplitude)
    for wall in scene.walls.values():
        motion = wall.motion or jv.Motion(0.0)
        rate = motion.harmonic * scene.frequency * abs(motion.amplitude)
        size = np.maximum(size, np.maximum(abs(wall.position) + abs(motion.amplitude), rate))
    return np.maximum(size, np.max([np.maximum(abs(each.x), abs(each.v)) for each in states], axis=0))


def beyond_walls(scene, end, size, eps):
    """Return the lanes that end beyond a rigid wall by more than roundings of the wall's distance and a size."""
    beyond = np.zeros(np.shape(end.x), bool)
    positions = kinds.wall_ends(scene, np.asarray(end.phase, float))
    for sign, wall, position in zip((-1.0, 1.0), (scene.left, scene.right), positions, strict=True):
        if wall is not None and not wall.soft:
            reach = abs(np.asarray(wall.position)) + abs(wall.motion.amplitude if wall.motion else 0.0)
            beyond |= sign * (np.asarray(end.x) - position) > ROUNDINGS * eps * (size + reach)
    return beyond


@dataclass(frozen=True)
class Wild:
    """Lanes at the far ends; walls: a letter of HARMONICS of each, or "-"; narrow: see above."""

    walls: str
    narrow: bool = False

    @property
    def name(self):
        return f"{'narrow' if self.narrow else 'wild'} {self.walls}"

    def draw(self, rng, count):
        """Return scene and state of random lanes."""
        low, often = (0.9, (1.0, 1.0)) if self.narrow else (0.0, (1.0, 0.0))

        def law(letter):
            if letter in "st":
                return {"stiffness": logarithmic(rng, count, 0.0, 6.0), "damping": rng.random(count)}
            return {"restitution": mixed(rng, rng.uniform(low, 1.0, count), 0.2, *often)}

        gap = logarithmic(rng, count, *((-5.0, -1.0) if self.narrow else (-6.0, 0.5)))
        phase, middle = rng.uniform(0, 6.28, count), rng.choice([0.0, -1.0, 0.3], count) * rng.random(count)
        swings = [gap * rng.uniform(0.0, 3.0, count) * bool(HARMONICS.get(letter)) for letter in self.walls]
        positions = [middle + side * (0.5 * gap + swing) for side, swing in zip((-1.0, 1.0), swings, strict=True)]
        walls, ends = make_walls(rng, self.walls, positions, swings, phase, law)
        amplitude = logarithmic(rng, count, 0.0 if self.narrow else -3.0, 3.0)
        frequency = logarithmic(rng, count, np.log10(0.05), np.log10(20.0))
        damping = mixed(rng, rng.uniform(0.0, 3.0, count), 0.2, 0.0, 1.0)
        scene = jv.make_scene(amplitude, frequency, damping, 0.5, walls)
        x = np.clip(ends[0] + mixed(rng, rng.random(count), 0.1, 0.0, 1.0) * (ends[1] - ends[0]), *ends)
        speed = logarithmic(rng, count, -2.0, 1.0) * mixed(rng, np.ones(count), 0.02, 0.0, 1e-100, 1e-300)
        state = jv.State(x, speed * rng.choice([-1.0, 1.0], count), phase, np.zeros(count))
        order = np.argsort(gap * frequency / (amplitude + abs(x) + speed))  # lanes of a block wait for each other
        return at((scene, state), order)

    def mistakes(self, scene, start, end, impacts):
        """Return {kind of mistake: mask of lanes} of a strobe."""
        good = np.asarray(impacts.status) < Status.CAP
        beyond = beyond_walls(scene, end, np.asarray(scene.amplitude), np.finfo(float).eps)
        return {"beyond": good & beyond, "with a state": ~good & ~(np.isnan(end.x) & np.isnan(end.v))}


@dataclass(frozen=True)
class Usual:
    """Lanes of a kind of `tests/kinds.py`."""

    kind: str

    @property
    def name(self):
        return f"usual {self.kind}"

    def draw(self, rng, count):
        """Return scene and state of random lanes."""
        return kinds.KINDS[self.kind].batch(kinds.draw_rows(rng.integers(2**32), count, PLAIN))


@dataclass(frozen=True)
class Grazing:
    """Flights that turn back up to 64 roundings of the largest length before or beyond the right wall."""

    name = "grazing"
    dtype: type = np.float64  # that holds all numbers

    def draw(self, rng, count):
        """Return scene and state of random lanes, of most of those drawn."""
        amplitude, frequency = logarithmic(rng, (2, count), -1.0, 1.0)
        x, v, (phase, damping, bounce) = rng.uniform(-1, 1, count), rng.normal(size=count), rng.random((3, count))
        scene = jv.make_scene(amplitude, frequency, damping, bounce, (None, np.zeros(count)))
        start = jv.State(x, v, 6.0 * phase, np.zeros(count))
        scene, start = jax.tree.map(lambda leaf: np.asarray(np.asarray(leaf, self.dtype), float), (scene, start))
        top = np.full(count, 1e3)
        for beyond in (0.0, 1.0):  # the clearance from far away, then from nearby: that is exact to a rounding
            far = scene.replace(**{"right.position": top + beyond})
            impacts = jax.device_get(jv.strobe(far, start, slots=0, clearance=True)[1])
            fair = np.isfinite(impacts.least_clearance) & (impacts.count == 0)
            top = np.where(fair, top + beyond - impacts.least_clearance, 20.0)
        size = np.finfo(self.dtype).eps * np.max([abs(x), abs(v), amplitude, abs(top)], axis=0)
        position = np.asarray(np.asarray(top - rng.uniform(-64.0, 64.0, count) * size, self.dtype), float)
        scene = scene.replace(**{"right.position": position})
        return at((scene, start), np.flatnonzero((top < 20.0) & (top > x + 1e-3))[: count // 4])


class Chatter:
    """Masses that hop on a wall that presses them, or stick there; the contact force ends in the period."""

    name = "chatter"

    def draw(self, rng, count):
        """Return scene and state of random lanes."""
        frequency, phase = rng.uniform(0.2, 1.0, count), rng.uniform(-2.0, 2.0, count)
        bounce = rng.choice([0.0, 0.2, 0.5, 0.8], count)
        walls = tuple(jv.Wall(np.full(count, side), bounce) for side in (-1.0, 1.0))
        scene = jv.make_scene(rng.uniform(1.5, 4.0, count), frequency, np.full(count, 0.1), 0.5, walls)
        hop = logarithmic(rng, count, -6.0, -0.5)
        return scene, jv.State(1.0 - hop * rng.random(count), hop, phase, np.zeros(count))


def cubic_drag(t, x, v, p):
    """A constant force, a spring, and drag by the cube of the speed."""
    return -p["c0"] - p["c1"] * x - p["damping"] * v**3


@dataclass(frozen=True)
class Degenerate:
    """Lanes without some of drive, spring, damping and constant force, with walls at 0 and R from 0 to 1.

    force: "linear" (spring and damper), "constant" (the same with a constant force), "polynomial", "cubic" (drag) or
    "solver"; walls: the letters of `Wild`.
    """

    force: str
    walls: str
    dtype: type = np.float64

    @property
    def name(self):
        return f"{self.force} {self.walls}{' single' if self.dtype is np.float32 else ''}"

    def draw(self, rng, count):
        """Return scene and state of random lanes."""

        def law(letter):
            if letter == "s":
                damping = mixed(rng, rng.random(count), 0.5, 0.0)
                return {"stiffness": logarithmic(rng, count, 0.0, 4.0), "damping": damping}
            return {"restitution": mixed(rng, rng.random(count), 0.4, 0.0, 1.0, 0.999)}

        unit = 2.0 ** np.round(rng.uniform(-20.0, 20.0, count))
        if self.dtype is np.float32 or self.force == "cubic":
            unit = np.ones(count)
        gap, phase = logarithmic(rng, count, -3.0, 0.5) * unit, rng.uniform(0.0, 6.28, count)
        choice = rng.integers(0, 3, count)  # of the wall, or of one of two, at 0
        place = np.where(choice == 0, rng.uniform(-1.0, 1.0, count), 0.0) * unit
        is_right = choice == 2 if (self.walls[0] == "-") == (self.walls[1] == "-") else self.walls[0] == "-"
        positions = [np.where(is_right, place - gap, place), np.where(is_right, place, place + gap)]
        walls, ends = make_walls(rng, self.walls, positions, [gap * rng.uniform(0.0, 0.3, count)] * 2, phase, law)
        scene = self._scene(rng, count, unit, walls)
        share = mixed(rng, rng.random(count) ** 3, 0.3, 0.0, 1.0)
        if "m" in self.walls:
            share = np.clip(share, 1e-6, 1.0 - 1e-6)  # the position of a moving wall is rounded
        x = np.clip(ends[0] + share * (ends[1] - ends[0]), *ends)
        speed = mixed(rng, logarithmic(rng, count, -2.0, 0.7), 0.4, 0.0) * rng.choice([-1.0, 1.0], count) * unit
        state = jv.State(x, speed, phase, np.zeros(count))
        state = jax.tree.map(lambda leaf: np.asarray(leaf, self.dtype), state)
        return scene, self._with_contacts(rng, scene, state)

    def _scene(self, rng, count, unit, walls):
        amplitude = mixed(rng, logarithmic(rng, count, -2.0, 1.0), 0.5, 0.0) * unit
        frequency = logarithmic(rng, count, -1.0, 0.7)
        damping = mixed(rng, rng.uniform(0.0, 2.0, count), 0.5, 0.0)
        constant = logarithmic(rng, count, -2.0, 1.5) * rng.choice([-1.0, 1.0], count)
        constant = mixed(rng, constant, 0.3, 0.0) * unit
        spring = mixed(rng, rng.uniform(0.0, 2.0, count), 0.5, 0.0)
        terms = {"damping": damping}
        if self.force == "constant":
            terms["drive"] = ((constant, 0, 0.0),)
        elif self.force != "linear":
            function = cubic_drag if self.force == "cubic" else "polynomial"
            solver = "Dopri8" if self.force == "solver" else None
            tolerance = 1e-6 if self.dtype is np.float32 else 1e-10 if solver else 1e-13
            numbers = {"c0": constant, "c1": spring, "damping": damping}
            terms = {"force": jv.Force(function, numbers, tolerance=tolerance, solver=solver)}
        scene = jv.make_scene(amplitude, frequency, restitution=0.5, walls=walls, **terms)
        return jax.tree.map(lambda leaf: np.asarray(leaf, self.dtype), scene)

    def _with_contacts(self, rng, scene, state):
        """Return the state with some lanes that stick to a rigid wall, or have landed on it."""
        x, v, contact = (np.array(values) for values in (state.x, state.v, state.contact))
        for sign, letter, wall in zip((-1, 1), self.walls, (scene.left, scene.right), strict=True):
            if letter != "r":
                continue
            lanes, sticks = rng.random(len(x)) < 0.2, rng.random(len(x)) < 0.7
            x = np.where(lanes, wall.position, x)
            v = np.where(lanes, np.where(sticks, 0.0, -sign * abs(v)), v)
            contact = np.where(lanes, sign * np.where(sticks, Contact.STUCK, Contact.LANDED), contact)
        return replace(state, x=x, v=v, contact=contact.astype(x.dtype))

    def force_and_energy(self, scene, x, v, phase):
        """Return the acceleration of a free mass, and the potential energy of one without a drive."""
        drive = np.asarray(scene.amplitude) * np.cos(phase)
        if scene.force is None:
            constant = -np.asarray(scene.drive[0].amplitude) if scene.drive else 0.0
            spring, drag = 1.0, 2.0 * np.asarray(scene.damping) * v
        else:
            constant, spring, damping = (np.asarray(scene.force.numbers[key]) for key in ("c0", "c1", "damping"))
            drag = damping * v**3 if self.force == "cubic" else 2.0 * damping * v
        return drive - constant - spring * x - drag, constant * x + 0.5 * spring * x * x

    def mistakes(self, scene, start, end, impacts):
        """Return {kind of mistake: mask of lanes} of a strobe."""
        eps = float(np.finfo(self.dtype).eps)
        x0, v0, phase, contact0 = (np.asarray(each, float) for each in (start.x, start.v, start.phase, start.contact))
        x, v, contact = (np.asarray(each, float) for each in (end.x, end.v, end.contact))
        status, count = np.asarray(impacts.status), np.asarray(impacts.count)
        good, span = status < Status.CAP, 2.0 * np.pi / np.asarray(scene.frequency)
        released, gained = np.zeros((2, *x.shape), bool)
        force, energy = self.force_and_energy(scene, x0, v0, phase)
        size = abs(x0) + (abs(v0) + np.asarray(scene.amplitude) * span + abs(force) * span) * span
        still, reach = np.asarray(scene.amplitude) == 0, 0.0
        for sign, letter, wall in zip((-1, 1), self.walls, (scene.left, scene.right), strict=True):
            if letter == "r":
                reach = reach + abs(np.asarray(wall.position))
                pressed = still & (contact0 == sign * Contact.STUCK) & (sign * force > 0)
                moved = (x != wall.position) | (v != 0) | (contact != sign * Contact.STUCK)
                released |= good & pressed & moved & ("m" not in self.walls)
        if not set(self.walls) & {"m", "s"}:
            _, later = self.force_and_energy(scene, x, v, phase)
            near = 1e4 * (scene.force.tolerance if scene.force else eps) * (size + reach)
            loose = near * (abs(force) + abs(v0) + abs(v) + near) + ROUNDINGS * eps * (abs(energy) + abs(later))
            gained = good & still & (0.5 * v * v + later > 0.5 * v0**2 + energy + loose)
        faulty = (status == Status.INVALID) | (status == Status.NONFINITE)
        # Steps within soft walls are counted for all lanes of a block together; in single precision one lane in a
        # thousand takes more steps than are allowed, and its status says so.
        if "s" not in self.walls and self.dtype is np.float64:
            faulty |= (status == Status.CAP) & (count < FEW)
        return {
            "beyond": good & beyond_walls(scene, end, size, eps),
            "a bad status of a valid start": faulty,
            "released while pressed on": released,
            "with more energy": gained,
        }


@dataclass(frozen=True)
class Flights:
    """First flights that come near a wall, and turn back at least 8 roundings of the length before or beyond it."""

    walls: str

    @property
    def name(self):
        return f"flights {self.walls}"


def scene_of_flights(lanes):
    """Return scene and state of the flights of `tests.reference.flights`."""
    walls = {-1: None, 1: None}
    for wall in lanes.walls:
        motion = jv.Motion(np.float64(wall.swing), np.float64(wall.phase), wall.harmonic) if wall.harmonic else None
        walls[wall.side] = jv.Wall(np.float64(wall.position), 0.7, motion=motion)
    numbers = map(np.float64, (lanes.amplitude, lanes.omega, lanes.gamma))
    state = jv.State(*map(np.float64, (lanes.x, lanes.v, lanes.phase)))
    return jv.make_scene(*numbers, 0.7, (walls[-1], walls[1])), state


FORCES = {
    "linear": ("r-", "-r", "rr", "m-", "rm", "s-", "rs", "--"),
    "constant": ("r-", "rr", "mr", "sr", "--"),
    "polynomial": ("r-", "-r", "rr", "m-", "s-", "rs", "--"),
    "cubic": ("r-", "rr"),
    "solver": ("r-", "rr"),
}
ALL = [
    *(Wild(walls) for walls in ("--", "r-", "-r", "-m", "rr", "rm", "23", "s-", "-s", "-t", "sm", "rt")),
    *(Wild(walls, narrow=True) for walls in ("rm", "sr")),
    *(Usual(kind) for kind in ("one_wall", "two_walls", "moving_walls")),
    *(Flights(walls) for walls in ("rr", "r-", "-r", "mr", "r2", "3-", "-m", "m2")),
    Grazing(),
    Chatter(),
    *(Degenerate(force, walls) for force, letters in FORCES.items() for walls in letters),
    *(Degenerate(force, "r-", np.float32) for force in ("linear", "polynomial", "solver")),
]
KINDS = {kind.name: kind for kind in ALL}
