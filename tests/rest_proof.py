"""Motions that rest against 50 digits: `python -m tests.rest_proof chatter N`, `... orbits N`, `... complete N`,
`... plastic N`.

chatter: hops on a wall, still or moving: whether and when they end in rest, and the simulator's state a drive period
after they began, where that is soon after the release. orbits: what random scenes settle on and rests, each impact and
release. complete: branches through the point at which a chatter just completes: its place, by halving. plastic:
branches with R = 0 on a wall or two: why they end, whether their orbits are the motion's, and where the press is zero
at an impact.
"""

import sys
from types import SimpleNamespace

import jax
import numpy as np
from mpmath import mpf, workdps

import jaxvibro as jv
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.maps.strobe import strobe
from jaxvibro.orbits import chatter_and_release
from jaxvibro.problem.orbit_equations import are_releases, sides_with_release_codes
from tests.branch_proof import plain, scene_of
from tests.reference import rests
from tests.reference.special import exact, place, span, with_value

DIGITS = 50
LOOKS = 200  # at the press, a drive period


def wall_scene(rng):
    """(scene, side, its R) of one wall, still or moving."""
    side, bounce = int(rng.choice((-1, 1))), 0.0 if rng.random() < 0.1 else rng.uniform(0.02, 0.95)
    motion = jv.Motion(rng.uniform(0.05, 0.4), rng.uniform(0, 6.28), int(rng.choice((1, 2))))
    wall = jv.Wall(rng.uniform(-1.0, 1.0), bounce, motion=motion if rng.random() < 0.5 else None)
    damping = rng.uniform(0.0, 0.4) if rng.random() < 0.8 else rng.uniform(0.9, 1.6)
    walls = (None, wall) if side > 0 else (wall, None)
    return jv.make_scene(rng.uniform(0.5, 4.0), rng.uniform(0.3, 2.5), damping, 0.5, walls), side, bounce


def pressed(given, side):
    """(times in two drive periods, the press at them)."""
    with workdps(20):
        length = float(span(given, 1))
        times = np.linspace(0.0, 2.0 * length, 2 * LOOKS + 1)
        return times, np.array([float(rests.press_alone(given, side, mpf(time))) for time in times])


def start(rng, given, side):
    """(a time from which on a wall presses, the press there, about when it lets go), None where it never does."""
    times, push = pressed(given, side)
    ends = np.flatnonzero((push[LOOKS:-1] > 0) & (push[LOOKS + 1 :] <= 0)) + LOOKS
    if not len(ends):
        return None
    last = int(rng.choice(ends))
    first = last - int(np.argmax(push[last::-1] <= 0))
    if last - first < 10 or push[first:last].min() > 0:
        return None
    begin = int(rng.integers(first + 3, last - 3))
    return times[begin], push[begin], times[last]


def chatter(count, seed=1):
    """Prints the largest errors of so many chatters, and how many hops there were."""
    rng = np.random.default_rng(seed)
    done, apart, worst, hops, foreseen = 0, 0, np.zeros(2), [], []
    while done < count:
        scene, side, bounce = wall_scene(rng)
        given = exact(plain(scene))
        found = start(rng, given, side)
        if found is None:
            continue
        phase = float(scene.frequency) * found[0]
        with workdps(DIGITS):
            now = mpf(phase) / given.omega  # the phase is the double
            end = rests.release(given, side, mpf(found[2]))
            tau = float(now - end)
            reach = 0.3 * min(1.0, 1.0 / float(scene.frequency), -tau)
            speed = rng.uniform(0.0, 1.0) ** 2 * reach * found[1]
            before = speed / bounce if bounce else 1.0
            leaving = given.right.restitution * mpf(before) if side > 0 else given.left.restitution * mpf(before)
            hits, began = rests.until_rest(given, side, now, leaving, end)
        numbers = (np.float64(each) for each in (side, float(given.omega * end), tau, before))
        rest, _, plainly, *_ = (
            float(np.asarray(each).ravel()[0]) for each in chatter_and_release._follow_bounces_compiled(scene, *numbers)
        )
        if plainly <= 0:
            continue
        done += 1
        if (began is None) != (rest <= 0):
            apart += 1
            print(done, "decided otherwise:", rest, began, tau, before, scene, flush=True)
        if began is None or rest <= 0:
            continue
        worst = np.maximum(worst, [abs(rest - float(end - began)), state_error(scene, given, side, now, before, end)])
        hops.append(len(hits))
        foreseen.append(np.log(max(speed, 1e-300) / 1e-13) / -np.log(bounce) if bounce else 0.0)
        if len(hops) % 100 == 0:
            print(f"{done}: {worst}", flush=True)
    print(
        f"{done} chatters, {apart} decided otherwise, {len(hops)} rest; error of when {worst[0]:.2g}, of the state "
        f"after the release {worst[1]:.2g}; hops {np.mean(hops):.1f}, ln(v0 / v_c) / ln(1 / R) {np.mean(foreseen):.1f}"
    )


def state_error(scene, given, side, now, before, end):
    """How far the simulator's state is from the reference's a little after the release, where it is in a period."""
    with workdps(DIGITS):
        late = now + span(given, 1)
        if late < end + rests.SHORT or late > end + 3:
            return 0.0
        wall = place(given, side, now)
        x, v = rests.state_after(given, side, end, mpf(0), late)
        begin = jv.State(float(wall.x), float(wall.v + side * before), float(given.omega * now))
    state = strobe(scene, begin)[0]
    return max(abs(float(state.x) - float(x)), abs(float(state.v) - float(v)))


def resting(rng):
    """(scene, orbit) that a random scene settles on, and that rests."""
    while True:
        scene = scene_of(rng)
        scene = scene.replace(frequency=rng.uniform(0.25, 1.0), restitution=rng.uniform(0.05, 0.85))
        try:
            orbit = jv.find_orbit(scene, jv.State(float(scene.right.position) - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if orbit.rests and orbit.periods <= 4:
            yield scene, orbit


def orbits(count, seed=2):
    """Prints the largest errors of times and speeds of so many orbits that rest."""
    rng, worst, several, hits = np.random.default_rng(seed), np.zeros(2), 0, 0
    source = resting(rng)
    for k in range(count):
        scene, orbit = next(source)
        found = errors(scene, orbit)
        worst = np.maximum(worst, found[:2])
        several += found[3] > 1
        hits += found[2]
        assert not orbit.multipliers.any(), orbit.multipliers
        if found[:2].max() > 1e-10:
            print(k, orbit.label, found, scene)
    print(
        f"{count} orbits that rest, {several} more than once, {hits} impacts: "
        f"times {worst[0]:.2g}, speeds {worst[1]:.2g}"
    )


def errors(scene, orbit):
    """(largest error of a time, of a speed; impacts and releases compared), from release to release."""
    along, z = polish_orbit(orbit, "amplitude")
    rows, count = len(along.sequence.sides), int(np.sum(along.sequence.sides != 0))
    sides = sides_with_release_codes(along.sequence)[:count]
    spot = SimpleNamespace(times=z[:count], speeds=z[rows : rows + count], sides=sides)
    given, length = exact(plain(scene)), 2.0 * np.pi / float(scene.frequency) * orbit.periods
    frees = np.flatnonzero(are_releases(spot.sides))
    worst, count = np.zeros(2), 0
    for begin in frees:
        with workdps(DIGITS):
            side = int(np.sign(spot.sides[begin]))
            now = rests.release(given, side, mpf(spot.times[begin]))
            worst[0] = max(worst[0], abs(float(now - mpf(spot.times[begin]))))
            hits, _, own = rests.from_release(given, side, now)
            k = begin
            for hit in hits:
                k = (k + 1) % len(spot.times)
                if are_releases(spot.sides[k]):
                    assert own == np.sign(spot.sides[k])
                    break
                late = float((hit.time - mpf(spot.times[k])) % mpf(length))
                worst = np.maximum(worst, [min(late, length - late), abs(float(hit.speed - mpf(spot.speeds[k])))])
                assert hit.side == spot.sides[k]
                count += 1
    return np.array([*worst, count, len(frees)])


def complete(count, seed=3):
    """Prints how far so many CH of branches are from where the reference's hops just end in rest."""
    rng, worst, done, ends = np.random.default_rng(seed), 0.0, 0, {}
    for scene, orbit in resting(rng):
        value = float(scene.amplitude)
        branch = jv.follow(orbit, "amplitude", (0.6 * value, 1.6 * value))
        for one in branch.ends:
            ends[one.name] = ends.get(one.name, 0) + 1
        for point in branch.points("CH"):
            worst = max(worst, abs(point.value - halved(point)))
            done += 1
        print(done, orbit.label, branch, f"{worst:.2g}", ends, flush=True)
        if done >= count:
            break
    print(f"{done} CH: {worst:.2g}; ends {ends}")


def plastic(count, seed=4):
    """Prints why so many branches with R = 0 end, how far their stable orbits are from the motion's, and how far CH and
    RL from where an impact of 50 digits meets no press."""
    rng, ends, apart, named, places, done = np.random.default_rng(seed), {}, 0.0, 0, [0.0], 0
    while done < count:
        scene = scene_of(rng)
        takes = {f"{side}.restitution": 0.0 for side, wall in scene.walls.items() if wall and rng.random() < 0.7}
        scene = scene.replace(frequency=rng.uniform(0.25, 1.6), **takes)
        try:
            orbit = jv.find_orbit(scene, jv.State(float(scene.right.position) - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if not takes or orbit.periods > 2 or not int(orbit.impacts.count):
            continue
        done += 1
        value = float(scene.amplitude)
        branch = jv.follow(orbit, "amplitude", (0.4 * value, 1.8 * value))
        for one in branch.ends:
            ends[one.name] = ends.get(one.name, 0) + 1
        kinks = np.isin(branch.values, [each.value for each in branch.special])
        for k in np.flatnonzero(branch.stable & ~kinks)[::7]:
            one = branch.orbit(k)
            end, _ = strobe(one.scene, one.state, one.periods)
            apart = max(apart, abs(float(end.x - one.state.x)), abs(float(end.v - one.state.v)))
            found = jv.find_orbit(one.scene, one.state)
            if found.label != one.label:
                named += 1
                print("named otherwise:", one.label, found.label, one.scene)
        near = [met(point) for point in branch.special if point.kind in ("CH", "RL")]
        places += [abs(one - point.value) for one, point in near if one is not None]
        print(done, orbit.label, branch, f"{apart:.2g} {named} {max(places):.2g}", flush=True)
    print(f"ends {ends}; orbits {apart:.2g} from the motion's, {named} named otherwise")
    print(f"{len(places) - 1} places {max(places):.2g}")


def met(point):
    """(the amplitude near a CH or RL at which an impact without speed after it meets no press, None: there is none; the
    point)."""
    spot, base = point.spot, exact(plain(point.scene))
    count, length = len(spot.times), float(span(base, spot.periods))
    hits = [k for k in range(count) if abs(spot.sides[k]) == 1]
    takes = [k for k in hits if not point.scene.bounce(("left", "right")[int(spot.sides[k] > 0)])]
    with workdps(DIGITS):
        pushes = [(abs(float(rests.press_alone(base, int(spot.sides[k]), mpf(spot.times[k])))), k) for k in takes]
        if not pushes or min(pushes)[0] > 1e-9:
            return None, point
        row = min(pushes)[1]
        frees = [k for k in range(count) if are_releases(spot.sides[k])] or [row]
        begin = min(frees, key=lambda k: (spot.times[row] - spot.times[k]) % length or length)
        late = (spot.times[row] - spot.times[begin]) % length or length

        def press(value):
            given = with_value(base, "amplitude", value)
            side = int(np.sign(spot.sides[begin]))
            now, speed = rests.release(given, side, mpf(spot.times[begin])), mpf(0)
            end = now + late
            while True:
                hit = rests.next_hit(given, side, now, speed)
                side, now, speed = hit.side, hit.time, rests.restitution(given, hit.side) * hit.speed
                if now > end - 1e-6:
                    return rests.press_alone(given, side, now)

        one, two = mpf(point.value) - mpf(10) ** -9, mpf(point.value) + mpf(10) ** -9
        low, high = press(one), press(two)
        return float(one - low * (two - one) / (high - low)), point


def halved(point):
    """The amplitude at which hops just end in rest, by halving."""
    spot = point.spot
    frees = np.flatnonzero(are_releases(spot.sides))
    base = exact(plain(point.scene))
    found = []
    for begin in frees:
        with workdps(80):  # with 50 some hops next to the CH are decided otherwise
            for reach in (1e-10, 1e-7):
                low, high = (mpf(point.value) + sign * reach for sign in (-1, 1))
                first = _ends(base, spot, begin, low)
                if first != _ends(base, spot, begin, high):
                    break
            else:
                continue
            while high - low > 1e-13:
                middle = (low + high) / 2
                low, high = (middle, high) if _ends(base, spot, begin, middle) == first else (low, middle)
            found.append(float(low))
    return min(found, key=lambda one: abs(one - point.value), default=np.inf)


def _ends(base, spot, begin, value):
    """Whether the hops after a release end in rest before the next one."""
    given = with_value(base, "amplitude", value)
    side, count = int(np.sign(spot.sides[begin])), len(spot.times)
    now = rests.release(given, side, mpf(spot.times[begin]))
    after = next((begin + k) % count for k in range(1, count + 1) if are_releases(spot.sides[(begin + k) % count]))
    own, late = int(np.sign(spot.sides[after])), spot.times[after]
    late += 0 if late > spot.times[begin] else float(span(given, spot.periods))
    end = rests.release(given, own, mpf(late))
    try:
        _, began, last = rests.from_release(given, side, now, end)
    except ArithmeticError:
        return False
    return began is not None and last == own and began < end


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    {"chatter": chatter, "orbits": orbits, "complete": complete, "plastic": plastic}[sys.argv[1]](
        *(int(each) for each in sys.argv[2:])
    )
