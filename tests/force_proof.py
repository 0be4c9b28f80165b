"""Forces of one's own, proved at length: `python -m tests.force_proof spring 10000` prints numbers.

Others are `series 500`, scenes of each kind, or `series 500 duffing` of one, beside series by hand; `grazing 100000`,
beside other solvers; `points`; `branch` and `located 50`, special points and their gradients; `ball 100`, those of a
bouncing ball; `attractors`.
"""

import sys
import time

import jax
import mpmath
import numpy as np
from mpmath import mpf

import jaxvibro as jv
from jaxvibro.scene.codes import Status

from .force_attractors import attractors
from .force_grazing import grazing
from .force_specials import ball, branch, located
from .reference import own_force

jax.config.update("jax_enable_x64", True)

TOLERANCES = 1e-13, 1e-9, 1e-6
SERIES = 1e-12, 1e-9, 1e-6
DEPTH = 100.0  # tolerances, times scale and growth: so near a wall a flight is left out
SLOTS = 64  # impacts a period at most
ALLOWED = 20.0  # the same, where the reference is exact
APART, FEW = mpf(10) ** -8, 20  # of states, for a derivative's size, and digits
STRUCTURES = 1, 2  # of walls in `series`: two, one of them moving, and one
RANGES = {
    "duffing": {"cubic": (-0.3, 3.0), "damping": (0.0, 1.2)},
    "pendulum": {"damping": (0.0, 1.2)},
    "stribeck": {"belt": (-1.0, 1.0), "low": (0.0, 0.3), "high": (0.3, 0.6), "slip": (0.5, 2.0), "smooth": (0.4, 1.0)},
    "van_der_pol": {"gain": (0.0, 1.0)},
}


def plain(t, x, v, p):
    return -x - 2.0 * p["damping"] * v


def drawn(rng, count, structure):
    """(walls, amplitude, frequency, damping, a restitution each, states) of scenes of a kind: one wall or two, at any
    place, standing or moving."""
    left = rng.uniform(-2.0, 0.5, count)
    right = left + rng.uniform(0.3, 3.0, count)
    bounces = rng.uniform(0.2, 1.0, (2, count))
    swing = rng.uniform(0.0, 0.3, count) * (right - left)
    motion = jv.Motion(swing, rng.uniform(0, 6, count), int(rng.integers(1, 4))) if structure % 2 else None
    walls = jv.Wall(left, bounces[0]), jv.Wall(right, bounces[1], motion=motion)
    walls = (walls, (None, walls[1]), (walls[0], None))[structure // 2 % 3]
    low, high = left + 0.05 * (right - left), right - 0.35 * (right - left)
    state = jv.State(rng.uniform(low, high), rng.normal(size=count) * (right - left), rng.uniform(0, 6, count))
    numbers = rng.uniform(0, 5, count), rng.uniform(0.4, 6, count), rng.uniform(0, 1.5, count)
    return walls, *numbers, state


def spring(count, seed=0):
    """Print how a spring as a force of one's own flies, beside the spring itself."""
    rng = np.random.default_rng(seed)
    for tolerance in TOLERANCES:
        wrong, left_out, worst, ratios, seen = 0, 0, 0.0, [], 0
        for structure in range(6):
            walls, amplitude, frequency, damping, state = drawn(rng, count // 6, structure)
            exact = jv.make_scene(amplitude, frequency, damping, 0.5, walls)
            force = jv.Force(plain, {"damping": damping}, tolerance)
            found = jv.make_scene(amplitude, frequency, restitution=0.5, walls=walls, force=force)
            (end, hits), (other, others) = (told(scene, state) for scene in (exact, found))
            ratios.append(timed(found, state) / timed(exact, state))
            norm = abs(np.asarray(jv.monodromy(exact, state, slots=64))).max(axis=(1, 2))
            size = np.maximum(np.maximum(abs(end.x), abs(end.v)), np.maximum(abs(np.asarray(state.v)), 4.0) + amplitude)
            unit = tolerance * size * (1.0 + norm)
            depth = np.minimum(hits.least_clearance, 0.5 * hits.least_speed**2 / size)
            sure = (hits.status == 0) & (depth > DEPTH * unit) & np.isfinite(norm)
            alike = (hits.side == others.side).all(axis=1) & (others.status == 0)
            error = np.maximum(abs(end.x - other.x), abs(end.v - other.v)) / (20.0 * unit)
            seen, left_out = seen + sure.size, left_out + int((~sure).sum())
            wrong += int((sure & ~alike).sum())
            worst = max(worst, error[sure & alike].max())
        ratios = ", ".join(f"{each:.1f}" for each in ratios)
        print(
            f"tolerance {tolerance:g}: {seen} scenes, {left_out} left out, {wrong} wrong itineraries, largest error "
            f"{worst:.2g} of what is allowed; times over the spring's {ratios}",
            flush=True,
        )


def told(scene, state):
    return jax.tree.map(np.asarray, jv.strobe(scene, state, slots=64, clearance=True))


def timed(scene, state):
    """Seconds of a strobe, the median of 5."""
    found = []
    for _ in range(5):
        begin = time.perf_counter()
        jax.block_until_ready(jv.strobe(scene, state))
        found.append(time.perf_counter() - begin)
    return float(np.median(found))


def series(count, *kinds, seed=0, digits=40):
    """Print how forces fly beside their series by hand, of each so many scenes, over one period of the drive."""
    for kind, ranges in ((each, RANGES[each]) for each in kinds or RANGES):
        rng, tally = np.random.default_rng(seed), {tolerance: Tally() for tolerance in SERIES}
        refused, away = 0, 0
        for structure in STRUCTURES:
            some = count // len(STRUCTURES)
            walls, amplitude, frequency, _, state = drawn(rng, some, structure)
            numbers = {name: rng.uniform(*each, some) for name, each in ranges.items()}
            scenes = {
                each: jv.make_scene(
                    amplitude, frequency, restitution=0.5, walls=walls, force=jv.Force(kind, numbers, each)
                )
                for each in SERIES
            }
            found = {each: jax.tree.map(np.asarray, jv.strobe(one, state, slots=SLOTS)) for each, one in scenes.items()}
            with mpmath.workdps(digits):
                for k in range(some):
                    given = own_force.FORCES[kind], {name: each[k] for name, each in numbers.items()}
                    given += amplitude[k], frequency[k], *plain_walls(walls, k)
                    try:
                        true, norm = with_norm(given, state.x[k], state.v[k], state.phase[k])
                    except own_force.RunsAwayError:
                        away += 1
                        for tolerance, (_, hits) in found.items():
                            tally[tolerance].kept += int(hits.status[k] < Status.CAP)
                        continue
                    except ArithmeticError:  # hops that die out
                        refused += 1
                        continue
                    size = max(*map(abs, true.end), abs(state.v[k]), 4.0 + amplitude[k])
                    for tolerance, (end, hits) in found.items():
                        unit = tolerance * size * (1.0 + norm)
                        tally[tolerance].add(true, size, unit, jax.tree.map(lambda leaf, k=k: leaf[k], (end, hits)))
        for tolerance, each in tally.items():
            left = f"{refused} hop without end, {away} run away ({each.kept} of them given an end)"
            print(f"{kind}, tolerance {tolerance:g}: {count} scenes, {left}, {each}", flush=True)


class Tally:
    """What came of scenes beside series by hand."""

    def __init__(self):
        self.near, self.seen, self.wrong, self.worst, self.late, self.kept = 0, 0, [], 0.0, 0.0, 0

    def __str__(self):
        return (
            f"{self.near} within the stated depth of a wall, {self.seen} seen: {len(self.wrong)} wrong itineraries, "
            f"largest error {self.worst:.2g} of what is allowed, of impact times {self.late:.2g}"
        )

    def add(self, true, size, unit, ours):
        """One more. unit: the tolerance, times scale and growth: 20 are allowed, and so near a wall none is judged."""
        if not min(true.nearest, true.least**2 / (2 * size)) > ALLOWED * unit:
            self.near += 1
            return
        self.seen += 1
        end, hits = ours
        if hits.status != 0 or [side for _, side, _ in true.hits] != hits.side[hits.side != 0].tolist():
            self.wrong.append(true)
            return
        error = max(abs(float(end.x) - true.end[0]), abs(float(end.v) - true.end[1]))
        self.worst = max(self.worst, float(error / (ALLOWED * unit)))
        late = [abs(t - float(own)) * speed for (t, _, speed), own in zip(true.hits, hits.time, strict=False)]
        self.late = max(self.late, float(max(late, default=0.0) / (ALLOWED * unit)))


def plain_walls(walls, k):
    """(walls, restitutions) of the k-th scene, as the reference takes them."""
    found, bounces = [], []
    for wall in walls:
        if wall is None:
            found.append(None)
        elif wall.motion is None:
            found.append(wall.position[k])
        else:
            found.append((wall.position[k], wall.motion.amplitude[k], wall.motion.phase[k], wall.motion.harmonic))
        bounces.append(0 if wall is None else wall.restitution[k])
    return tuple(found), tuple(bounces)


def with_norm(given, x, v, phase):
    """(`Flown`, the largest entry of the derivative of its end by its start, from differences)."""
    true, norm = own_force.flown(*given, x, v, phase=phase, most=SLOTS), 0.0
    with mpmath.workdps(FEW):
        for change in ((APART, 0), (0, APART)):
            other = own_force.flown(*given, mpf(x) + change[0], mpf(v) + change[1], phase=phase, most=SLOTS)
            norm = max(norm, *(abs(float((b - a) / APART)) for a, b in zip(true.end, other.end, strict=True)))
    return true, norm


def points():
    """Print how far special points of Duffing's oscillator without its cubic term are from the spring's."""
    for walls, bounce in (((-1.0, 1.0), 0.7), ((None, 0.4), 0.6), ((-0.8, 1.1), 0.8)):
        exact = jv.make_scene(2.0, 2.1, 0.05, bounce, walls)
        force = jv.Force("duffing", {"cubic": 0.0, "damping": 0.05})
        found = jv.make_scene(2.0, 2.1, restitution=bounce, walls=walls, force=force)
        branches = [jv.follow(jv.find_orbit(s, jv.State(0.3, -1.1)), "amplitude", (0.0, 6.0)) for s in (exact, found)]
        one, two = (branch.special for branch in branches)
        apart = [abs(a.value - b.value) for a, b in zip(one, two, strict=True)]
        print(walls, [f"{each.kind} {each.value:.6g}" for each in one], f"apart by {max(apart):.1e}", flush=True)


if __name__ == "__main__":
    commands = {each.__name__: each for each in (spring, series, grazing, points, branch, located, ball, attractors)}
    name, *rest = sys.argv[1:]
    commands[name](*(int(each) if each.isdigit() else each for each in rest))
