"""Branches of random scenes against references: `python -m tests.branch_proof WHAT N [seed]`.

specials: every SN, SB, BP, PD and GR of N random branches against tests/reference/special.py; grazings, steps, turned,
walls, extended: see the functions of these names.
"""

import sys
import time

import jax
import numpy as np

import jaxvibro as jv
from continuation.arclength import StepControl
from continuation.event_search import solve_with_fixed_entry
from jaxvibro.branches.follow import set_up_equations
from jaxvibro.problem import grazing_contact as touching
from jaxvibro.problem.grazing_contact import arclength_weights
from jaxvibro.problem.orbit_curve import dataset_row, parse_orbit_point
from jaxvibro.problem.orbit_equations import continuation_problem
from jaxvibro.problem.orbit_point import orbit_from_point
from jaxvibro.scene.typical_scales import typical_length
from tests.reference import special as reference
from tests.reference.scene import Motion, Scene, Wall
from tests.test_extend import WALLS, check_extended

BATCH = 1024  # points simulated at once
FINE = 0.0035  # between points whose flights are simulated
NAMES = ("amplitude", "frequency", "damping", "restitution", "right.position", "right.motion.amplitude")


def scene_of(rng):
    """A random scene: two walls or one, R per wall, perhaps a moving right wall."""
    gamma, omega, amplitude = rng.uniform((0.02, 0.5, 0.3), (0.3, 3.2, 6.0))
    if rng.random() < 0.15:
        gamma = rng.uniform(0.3, 1.4)
    left, right = -rng.uniform(0.3, 1.5), rng.uniform(-0.1, 1.5)
    own = None if rng.random() < 0.5 else rng.uniform(0.3, 0.95)
    kind = rng.integers(4)
    motion = jv.Motion(rng.uniform(0.05, 0.25), rng.uniform(0, 6.28)) if kind == 2 else None
    walls = (None if kind == 3 else jv.Wall(left, own), jv.Wall(right, motion=motion))
    if kind == 0:
        walls = (jv.Wall(-1.0), jv.Wall(1.0))
    return jv.make_scene(amplitude, omega, gamma, rng.uniform(0.5, 0.9), walls)


def branches(rng, count, **settings):
    """(branch, orbit) of so many random scenes that settle on an orbit that can be followed."""
    found = 0
    while found < count:
        scene = scene_of(rng)
        name = NAMES[rng.choice(len(NAMES), p=(0.5, 0.15, 0.1, 0.1, 0.1, 0.05))]
        if name not in scene.names:
            name = "amplitude"
        start = jv.State(float(scene.right.position) - 0.1, 0.0)
        try:
            orbit = jv.find_orbit(scene, start)
            if orbit.periods > 4 or orbit.impacts.count > 8:
                continue
            value = float(scene.parameter(name))
            low, high = (0.0, 1.0) if "rest" in name else (0.5 * value - 0.2, 1.8 * value + 0.3)
            branch = jv.follow(orbit, name, (low, high), **settings)
        except (jv.OrbitError, jv.ArgumentError) as error:
            print("  skipped:", str(error)[:100])
            continue
        found += 1
        yield branch, orbit


def plain(scene):
    """The references' form of a scene."""

    def wall(one):
        if one is None:
            return None
        own = float(scene.restitution if one.restitution is None else one.restitution)
        move = one.motion
        moving = None if move is None else Motion(float(move.amplitude), float(move.phase), move.harmonic)
        return Wall(float(one.position), own, moving)

    return Scene(
        float(scene.damping), float(scene.frequency), float(scene.amplitude), wall(scene.left), wall(scene.right)
    )


def called(point):
    """The parameter as the references call it: there "restitution" is that of both walls, of their own or not."""
    shared = [key for key in ("left", "right") if (wall := getattr(point.scene, key)) and wall.restitution is None]
    return f"{shared[0]}.restitution" if point.name == "restitution" and len(shared) == 1 else point.name


def error(point):
    """How far a special point's value is from the reference's."""
    spot = point.spot
    touch = None
    if point.kind == "GR":
        along, z = set_up_equations(point.scene, point.name, spot)
        touches = touching.find_grazing_contacts(along, z, typical_length(point.scene))
        if not any(one.is_impact for one in touches):
            one = touches[0]
            begin = spot.times[one.row] if len(spot.times) else 0.0
            touch = (one.row, begin + one.time_since_impact, one.side)
    rows = [part.tolist() for part in (spot.times, spot.speeds)]
    sides = [int(side) for side in spot.sides]
    true = reference.special(
        plain(point.scene), called(point), point.kind, point.value, *rows, sides, spot.periods, touch
    )
    return abs(float(true - point.value))


def specials(count, seed):
    """Every special point of random branches against the reference."""
    rng, worst, kinds = np.random.default_rng(seed), 0.0, {}
    for number, (branch, orbit) in enumerate(branches(rng, count)):
        began = time.perf_counter()
        told = []
        for point in branch.special:
            if point.kind == "EP":
                continue
            try:
                off = error(point)
            except (ArithmeticError, ValueError, IndexError) as why:
                told.append(f"{point.kind} {point.value:.6g} {point.label}: {type(why).__name__} {why}")
                continue
            kinds[point.kind] = kinds.get(point.kind, 0) + 1
            worst = max(worst, off / (1.0 + abs(point.value)))
            if off > 1e-11:
                told.append(f"{point.kind} {point.value:.12g} {point.label} off by {off:.1e}")
        ends = "; ".join(why.split(":")[0] for why in branch.reasons)
        walls = "".join("-LR"[0 if one is None else 1] for one in (branch.scene.left, branch.scene.right))
        size = f"{len(branch)} points, {len(branch.segments)} segments"
        print(
            f"{number} {walls} {branch.name} {orbit.label}: {size}; {ends};",
            *told,
            f"({time.perf_counter() - began:.1f} s)",
            flush=True,
        )
    print("largest error over 1 + value", worst, kinds)


def grazings(count, seed):
    """GR points of random branches: each orbit that is said to meet there, simulated 1e-6 of the parameter from it, on
    its side; the itinerary that the strobe sees must be the one told. Where a multiplier is so large that the strobe
    cannot stay on the orbit for its periods, the 50-digit reference must have the orbit."""
    rng, seen, orbits, looked, wrong = np.random.default_rng(seed), 0, 0, 0, 0
    for branch, _ in branches(rng, 10 * count):
        for point in branch.points("GR"):
            seen += 1
            spots = [near(point, spot) for spot in point.joins]
            orbits += len(spots)
            lost = [spot for spot in spots if not is_simulated(point, spot)]
            looked += len(lost)
            false = [spot for spot in lost if not is_orbit(point, spot)]
            wrong += len(false)
            if false or len(spots) < 2:
                print(point, len(spots), "meet, wrong:", false, flush=True)
        if seen >= count:
            break
    print(f"{seen} grazings, {orbits} orbits, {looked} by the reference, {wrong} wrong")


def is_simulated(point, spot):
    """Whether the strobe sees the impacts of a `OrbitPoint`, and comes back to it."""
    one = orbit_from_point(point.scene.replace(**{point.name: spot.value}), spot)
    end, impacts = jv.strobe(one.scene, one.state, one.periods, 64, slots=32)
    sides = np.asarray(impacts.side)[np.asarray(impacts.side) != 0]
    back = max(abs(float(end.x) - one.state.x), abs(float(end.v) - one.state.v))
    return np.array_equal(sides, one.impacts.side) and back < 1e-6 * (1.0 + abs(one.multipliers[0]))


def is_orbit(point, spot):
    """Whether the reference has the orbit of a `OrbitPoint`, its impacts having a speed; and no flight passes a
    wall."""
    given = plain(point.scene), called(point), spot.value, spot.times, spot.speeds, spot.sides, spot.periods
    exact = reference.orbit(*given)
    apart = max(abs(float(time - mine)) for (time, _), mine in zip(exact, spot.times, strict=True))
    fast = min(speed for _, speed in exact) > 0
    clear = orbit_from_point(point.scene.replace(**{point.name: spot.value}), spot).least_clearance
    return fast and apart < 1e-9 and clear > 0


def near(point, spot):
    """The `OrbitPoint` of an orbit that joins a GR, 1e-6 of the parameter from there; where that is far along its
    branch, or Newton's method does not come there, the one that is told."""
    along, z = set_up_equations(point.scene, point.name, spot)
    value = point.value + np.copysign(1e-6, spot.value - point.value)
    numbers = (np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
    found = solve_with_fixed_entry(
        continuation_problem(along), z, -1, value, StepControl(arclength_weights(along, 1.0), *numbers), along
    )
    count, rows = len(spot.times), len(along.sequence.sides)
    if found.converged and abs(found.z - z).max() < 1e-4:
        spot = spot._replace(value=value, times=found.z[:count], speeds=found.z[rows : rows + count])
        if not rows:
            spot = spot._replace(x=found.z[0], v=found.z[1])
    return spot


def steps(count, seed):
    """First and largest step from 0.05 to 1, tolerance from 1e-8 to 1e-13: the same kinds, itineraries and values, as
    far as eight impacts: beyond, towards complete chatter, there is no end of special points."""
    ways = [(0.05, 0.05, 1e-10), (0.05, 0.2, 1e-8), (0.2, 0.5, 1e-13), (1.0, 1.0, 1e-9), (0.05, 1.0, 1e-11)]
    differ, worst = 0, 0.0
    rng = np.random.default_rng(seed)
    for number, (branch, orbit) in enumerate(branches(rng, count)):
        told = None
        for first, largest, tolerance in ways:
            one = jv.follow(orbit, branch.name, branch.bounds, "both", first, largest, tolerance)
            few = [each for each in one.special if len(each.spot.times) <= 8 and each.kind not in ("EP", "CH")]
            kinds = [(each.kind, each.label) for each in few]
            values = np.array([each.value for each in few])
            if told is None:
                told = kinds, values
            elif kinds != told[0]:
                differ += 1
                print(number, branch.name, "differ", (first, largest), kinds, told[0])
            else:
                worst = max(worst, abs(values - told[1]).max(initial=0.0))
    print(f"{count} branches, {differ} differences, values within {worst:.1e}")


def turned(count, seed):
    """Branches followed forwards, then backwards from the end: the points of one on the other, no jump between them."""
    rng, worst, jumps, points = np.random.default_rng(seed), 0.0, 0, 0
    for number, (branch, _) in enumerate(branches(rng, count, direction="forward")):
        crossed = {one.place for one in branch.special if one.kind in ("SB", "BP")}  # where no Newton's method is sure
        if "repeated" in branch.reasons[1]:
            crossed.add(len(branch) - 1)
        last = branch.orbit(max({len(branch) - 1, len(branch) - 2} - crossed))
        if not last.impacts.count and len(branch.segments) == 1:
            continue
        try:
            back = jv.follow(last, branch.name, branch.bounds, largest_step=0.07)
        except jv.OrbitError as error:
            print(number, "not begun:", error)
            continue
        places = [place for place in range(0, len(branch), max(1, len(branch) // 12)) if place not in crossed]
        far = max(nearest(branch, back, place) for place in places)
        worst, points = max(worst, far), points + len(places)
        if far > 1e-9:
            jumps += 1
            print(number, branch, far, branch.reasons, back.reasons, flush=True)
        if number % 50 == 49:
            print(f"{number + 1} so far: {jumps}, {worst:.1e}", flush=True)
    print(f"{count} branches, {points} points, {jumps} branches with one not on the way back; worst {worst:.1e}")


def nearest(branch, other, place):
    """How far a point of a branch is from another branch: from the nearest rows of the other, Newton's method to the
    point that has the value, or the speed, that changes most along the branch here."""
    row = branch.data.isel(point=place)
    hit = row["side"].values != 0
    speeds, slopes = row["speed"].values[hit], row["speed_slope"].values[hit]
    value, best = float(row[branch.name]), np.inf
    count = (other.data["side"].values != 0).sum(axis=1)
    theirs = np.sort(np.where(other.data["side"].values != 0, other.data["speed"].values, np.inf), axis=1)
    apart = abs(theirs[:, : hit.sum()] - np.sort(speeds)).sum(axis=1) + abs(other.values - value)
    apart = np.where(count == hit.sum(), apart, np.inf)
    for k in np.argsort(apart)[:8]:
        if not np.isfinite(apart[k]):
            break
        spot = parse_orbit_point(dataset_row(other.data, k), other.name)
        along, z = set_up_equations(other.scene.replace(**{other.name: spot.value}), other.name, spot)
        index, goal = len(z) - 1, value
        if hit.any() and abs(slopes).max() > abs(float(row["value_slope"])):
            most = int(np.argmax(abs(slopes)))
            rank = int(np.argsort(np.argsort(speeds))[most])
            index, goal = len(z) // 2 + int(np.argsort(spot.speeds)[rank]), speeds[most]
        control = StepControl(
            arclength_weights(along, 1.0), *(np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
        )
        found = solve_with_fixed_entry(continuation_problem(along), z, index, goal, control, along)
        if found.converged:
            near = np.sort(found.z[len(z) // 2 : len(z) // 2 + len(speeds)])
            off = max(abs(near - np.sort(speeds)).max(initial=0.0), abs(found.z[-1] - value))
            best = min(best, off)
    return best


def walls(count, seed):
    """Every reported point of random branches, a few thousandths apart, simulated by certified flights: none passes
    through a wall. At every SN, SB, BP and PD the monodromy matrix of a simulation has the multiplier 1 or -1; where an
    impact is so slow that this matrix has lost its digits, the 50-digit reference has the point."""
    rng, points, wrong, false, kinds, looked = np.random.default_rng(seed), 0, 0, 0, {}, 0
    for number, (branch, _) in enumerate(branches(rng, count, largest_step=FINE)):
        for segment in branch.segments:
            for first in range(segment.first, segment.last + 1, BATCH):
                rows = branch.data.isel(point=slice(first, min(first + BATCH, segment.last + 1)))
                points += rows.sizes["point"]
                wrong += passing(branch, rows, number)
        for point in branch.special:
            kinds[point.kind] = kinds.get(point.kind, 0) + 1
            if singular(point) > 1e-6:
                looked += 1
                if not is_confirmed(point):
                    false += 1
                    print(number, point.kind, point.label, point.value, point.spot.speeds, branch, flush=True)
        if number % 25 == 24:
            print(
                f"{number + 1}: {points} points, {wrong} through a wall, {looked} by reference, {false} false",
                flush=True,
            )
    print(f"{count} branches, {points} points, {wrong} pass through a wall, {false} false special points", kinds)


def is_confirmed(point):
    """Whether the reference, from the point's times and speeds, comes to the same special point."""
    try:
        return error(point) < 1e-9 * (1.0 + abs(point.value))
    except (ArithmeticError, ValueError, IndexError) as why:
        print("  no reference:", type(why).__name__, why)
        return False


def singular(point):
    """How far det(M - 1), or det(M + 1) at a PD, is from zero, over the size of what is added up."""
    if point.kind not in ("SN", "SB", "BP", "PD"):
        return 0.0
    orbit = point.orbit
    (a, b), (c, d) = np.asarray(jv.monodromy(point.scene, orbit.state, orbit.periods))
    sign = -1.0 if point.kind == "PD" else 1.0
    terms = 1.0, -sign * a, -sign * d, a * d, -b * c
    return abs(sum(terms)) / sum(abs(each) for each in terms)


def passing(branch, rows, number):
    """How many rows of one itinerary are not confirmed: the flight after each impact meets the next wall, then."""
    size = rows.sizes["point"]
    rows = rows.isel(point=np.minimum(np.arange(BATCH), size - 1))  # of one size, compiled once
    values = rows[branch.name].values
    scene = branch.scene.replace(**{branch.name: values})
    period = 2 * np.pi / np.broadcast_to(np.asarray(scene.frequency), values.shape)
    times, speeds, sides = (rows[key].values[:, rows["side"].values[0] != 0] for key in ("time", "speed", "side"))
    if not sides.shape[1]:
        _, impacts = jv.strobe(scene, jv.State(rows["x"].values[:, 0], rows["v"].values[:, 0]), 1, 4)
        deep = np.asarray(impacts.count)[:size] > 0
        return int((deep[1:-1]).sum())
    wrong = np.zeros(len(values), bool)
    count = sides.shape[1]
    for k in range(count):
        following = (k + 1) % count
        span = times[:, following] - times[:, k] + (rows.sizes["period"] * period if following <= k else 0.0)
        phase = np.asarray(scene.frequency) * times[:, k]
        x, v = leaving(scene, sides[:, k], speeds[:, k], phase)
        whole = int(np.ceil((span / period).max() + 1e-6))
        _, impacts = jv.strobe(scene, jv.State(x, v, phase, sides[:, k].astype(float)), whole, 16, slots=32)
        first, side = np.asarray(impacts.time)[:, 0], np.asarray(impacts.side)[:, 0]
        off = (abs(first - span) > 1e-5 * period) | (side != sides[:, following])
        slow = (speeds[:, k] < 1e-6) | (speeds[:, following] < 1e-6) | (rows["least_clearance"].values < 1e-9)
        bad = off & ~slow
        if bad.any():
            places = np.flatnonzero(bad)[:3]
            print(number, branch, "row", places, first[places], span[places], speeds[places], flush=True)
        wrong |= bad
    return int(wrong[:size].sum())


def leaving(scene, sides, speeds, phase):
    """x and v just after impacts."""
    x, v = np.zeros(len(phase)), np.zeros(len(phase))
    for side, wall in ((-1, scene.left), (1, scene.right)):
        if wall is None:
            continue
        own = scene.restitution if wall.restitution is None else wall.restitution
        place, pace = np.asarray(wall.position) + 0.0 * phase, 0.0 * phase
        if wall.motion is not None:
            angle = wall.motion.harmonic * phase + np.asarray(wall.motion.phase)
            rate = wall.motion.harmonic * np.asarray(scene.frequency)
            place = place + np.asarray(wall.motion.amplitude) * np.cos(angle)
            pace = pace - np.asarray(wall.motion.amplitude) * rate * np.sin(angle)
        hit = sides == side
        x, v = np.where(hit, place, x), np.where(hit, pace - side * np.asarray(own) * speeds, v)
    return x, v


def extended(number, seed):
    """Branches extended against the same followed at once, for so many seeds and each kind of walls."""
    for each in range(seed, seed + number):
        for name in WALLS:
            check_extended(name, each)
            print("seed", each, name, "ok", flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, number, *rest = sys.argv[1:]
    {each.__name__: each for each in (specials, grazings, steps, turned, walls, extended)}[what](
        int(number), int(rest[0]) if rest else 0
    )
