"""What follows a grazing, held against digits and long runs: `python -m tests.scenario_proof WHAT N [seed]`.

returns: M at N grazings of random branches, against products of flights in 40 digits. places: at N grazings of random
scenes that period adding follows the places found, against branches followed from the orbits, and against
tests/reference/special.py. runs: at N grazings how far long runs are from the orbit a little beyond. chaos: at N the
exponents of long runs, between the windows of period adding and in them. jumps: at N grazings of strongly damped scenes
where nothing stays near the fold of the orbit with one impact in n returns.
"""

import sys
import time

import jax
import mpmath
import numpy as np

import jaxvibro as jv
from jaxvibro.branches.scenario import grazing_return_of
from jaxvibro.problem.added_impact_orbits import added_impact_orbits
from jaxvibro.problem.orbit_point import orbit_from_point
from jaxvibro.problem.square_root_map import SquareRootMap
from jaxvibro.scene.typical_scales import typical_length
from tests.branch_proof import branches, called, error, plain
from tests.reference import special as reference

GRADUAL = ("OVERLAPPING", "ADDING", "CHAOS")
NAMES = ("amplitude", "frequency", "damping", "right.position", "right.motion.amplitude")
LAST = 6  # returns
FINE = 1e-7  # of the parameter: windows that end nearer to the grazing are rounding
SHARES = (1e-1, 1e-2, 1e-3, 1e-4)  # of a depth
FAR = 0.02  # root of the depth at a touch: nearer to the grazing the map's windows are the orbits'
DEPTHS = 24
EARLY = 0.1  # before a touch
SETTLED, KEPT = 3000, 300  # returns of a long run
NEAR = 1e-3  # of the way from the grazing: as near is the same touch


def strongly_damped(rng, low, high):
    """A random scene whose motion from rest may meet no wall, its damping between these; with one wall or two."""
    gamma, omega, r = rng.uniform((low, 0.8, 0.2), (high, 5.0, 0.95))
    place, kind = rng.uniform(0.3, 1.5), rng.integers(4)
    motion = jv.Motion(rng.uniform(0.05, 0.25), rng.uniform(0.0, 6.28), int(rng.integers(1, 3))) if kind == 1 else None
    left = {2: jv.Wall(-place, r), 3: jv.Wall(-1.3 * place, 0.5)}.get(int(kind))
    return jv.make_scene(0.1, omega, gamma, r, (left, jv.Wall(place, r, motion=motion)))


def grazings(rng, low, high, kinds):
    """Grazings, with their `Scenario`s of these kinds, on branches from rest of random strongly damped scenes; along
    other parameters than the amplitude from beside it."""
    while True:
        scene = strongly_damped(rng, low, high)
        most = 40.0 * float(scene.frequency) ** 2
        try:
            first = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, most), stop="GR")
        except (jv.OrbitError, jv.ArgumentError):
            continue
        points = first.points("GR")
        if not points:
            continue
        name = str(rng.choice([one for one in NAMES if one in scene.names]))
        point = points[0] if name == "amplitude" else along(points[0], name)
        if point is not None and jv.scenario(point).follows.name in kinds:
            yield point


def along(point, name):
    """The same grazing along another parameter."""
    value = float(point.scene.parameter(name))
    for way in (1.0, -1.0):
        scene = point.scene.replace(amplitude=point.value * (1.0 - 1e-3))
        try:
            low, high = sorted((value, value + way * 0.05 * (abs(value) + 0.1)))
            branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), name, (low, high), stop="GR")
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if branch.points("GR"):
            return branch.points("GR")[0]
    return None


def places(count, seed):
    """The places found against branches and digits, and their ratio."""
    rng, far, off, steep, compared = np.random.default_rng(seed), 0.0, 0.0, 0.0, 0
    given = grazings(rng, 1.0, 2.0, GRADUAL)
    for k in range(count):
        point, began = next(given), time.perf_counter()
        found = jv.period_adding(point, LAST)
        told, size = [], 1.0 + abs(point.value)
        for one in found.windows:
            if one.orbit is None or abs(one.found - point.value) < FINE * size:
                continue
            last = followed(point, one)
            if last is None:
                told.append(f"n {one.returns}: not followed to {one.found}")
                continue
            compared += 1
            away, exact = abs(last.value - one.found) / size, error(last) / size
            far, off = max(far, away), max(off, exact)
            share = one.ratio / found.scenario.ratio - 1.0
            told.append(f"n {one.returns}: {exact:.1e}, {away:.1e}, ratio {share:+.4f}")
        if len(told) >= LAST - 1 and np.isfinite(share) and found.scenario.multipliers[0].real < 0.4:
            steep = max(steep, abs(share))
        scene = f"{point.name} {found.scenario.follows.name} {found.scenario.multipliers.real}"
        print(k + 1, point.label, scene, "; ".join(told), f"({time.perf_counter() - began:.1f} s)", flush=True)
    print(f"{count} grazings, {compared} places: off by {off:.1e} of 1 + value, from branches by {far:.1e};", end=" ")
    print(f"ratio at n = {LAST} within {steep:.1e} of the limit where multipliers are below 0.4")


def followed(point, one):
    """The `Special` of the branch of a window's orbit where it touches, None where the branch does not come there."""
    room = sorted((point.value, one.found + 0.1 * (one.found - point.value)))
    step = 0.05 * np.sqrt(abs(one.found - point.value))
    branch = jv.follow(one.orbit, point.name, room, first_step=step, largest_step=2 * step)
    last = min(branch.points("GR"), key=lambda each: abs(each.value - one.found), default=None)
    far = NEAR * abs(one.found - point.value)
    return last if last is not None and abs(last.value - one.found) <= far else None


def matrix_in_digits(point, found):
    """M by flights and rebounds in 40 digits, from impacts polished there."""
    spot, touch = point.spot, found.omitted_grazings[0]
    scene = plain(point.scene)
    keep = np.array([speed > 1e-7 for speed in spot.speeds], bool)
    times, speeds, sides = (each[keep].tolist() for each in (spot.times, spot.speeds, spot.sides))
    with mpmath.workdps(60):
        name, exact = called(point), reference.exact(scene)
        hits = reference.orbit(scene, name, point.value, times, speeds, sides, spot.periods, 30) if times else []
        whole = reference.span(exact, spot.periods)
        at = mpmath.mpf(touch.time)
        listed = sorted((at + (t - at) % whole, u, int(side)) for (t, u), side in zip(hits, sides, strict=True))
        end = at + (reference.span(exact, spot.periods) / 2 if found.is_half_orbit else whole)
        matrix, last = mpmath.eye(2), at
        for t, u, side in listed:
            if t < end:
                matrix = reference.rebound(exact, side, t, u) / u * reference.free(exact.gamma, t - last) * matrix
                last = t
        matrix = reference.free(exact.gamma, end - last) * matrix
        return np.array((-matrix if found.is_half_orbit else matrix).tolist(), float)


def returns(count, seed):
    """Errors of M, over its largest entry."""
    rng, worst, number, seen = np.random.default_rng(seed), 0.0, 0, {}
    for branch, _ in branches(rng, 100 * count):
        for point in branch.points("GR"):
            if point.orbit.rests:
                continue
            found, told = grazing_return_of(point), jv.scenario(point)
            true = matrix_in_digits(point, found)
            off = abs(found.matrix - true).max() / abs(true).max()
            worst, number = max(worst, off), number + 1
            seen[told.follows.name] = seen.get(told.follows.name, 0) + 1
            print(number, point.name, point.label, told.follows.name, told.deeper, f"{off:.1e}", flush=True)
        if number >= count:
            break
    print(f"{number} grazings, M off by {worst:.1e} at most", seen)


def apart(point, found, depth):
    """How far a long run comes from the orbit without impacts, a while before its touch, a contact being so deep."""
    scene = point.scene.replace(**{point.name: point.value + depth / found.omitted_grazings[0].depth.slope})
    x, v = before(point, found)
    state = jv.State(x, v, float(scene.frequency) * (found.omitted_grazings[0].time - EARLY))
    state, _ = jv.strobe(scene, state, SETTLED)
    far = 0.0
    for _ in range(KEPT):
        state, _ = jv.strobe(scene, state, 1)
        far = max(far, np.hypot(float(state.x) - x, float(state.v) - v))
    return far


def before(point, found):
    """(x, v) of the orbit without impacts EARLY before its touch."""
    late = (found.omitted_grazings[0].time - EARLY) % found.return_time
    state, _ = jv.sample(point.scene, jv.State(found.z[0], found.z[1]), np.array([late]))
    return float(state.x[0]), float(state.v[0])


def runs(count, seed):
    """How the distance of long runs goes with the depth: about as its root where the motion is told to stay near, not
    at all where it jumps; depths as shares of those that orbits with one impact may have."""
    rng, right, done, seen = np.random.default_rng(seed), 0, 0, {}
    given = grazings(rng, 0.3, 2.5, (*GRADUAL, "JUMP"))
    while done < count:
        point = next(given)
        found, told = grazing_return_of(point), jv.scenario(point)
        if len(point.spot.times) or found.is_half_orbit or seen.get(told.follows.name, 0) > count / 3:
            continue
        done += 1
        seen[told.follows.name] = seen.get(told.follows.name, 0) + 1
        near = SquareRootMap(told.root, told.matrix)
        reach = (
            near.added_impact_window(told.deeper).linear_coefficient
            if told.deeper
            else min(0.1, abs(near.impact_responses(1)[1]))
        )
        far = [apart(point, found, share * reach**2) for share in SHARES]
        power = np.log10(far[0] / far[-1]) / np.log10(SHARES[0] / SHARES[-1])
        fits = power < 0.1 if told.deeper else power > 0.3
        right += fits
        shown = " ".join(f"{one:.2e}" for one in far)
        print(done, told.follows.name, told.deeper, told.multipliers, f"{shown}; power {power:.3f}", fits, flush=True)
    print(f"{right} of {done} as told", seen)


def chaos(count, seed):
    """Whether exponents are above zero at depths within a factor of the ratio, between windows as the map has them, and
    below zero in these."""
    rng, done, tables = np.random.default_rng(seed), {}, {}
    given = grazings(rng, 1.0, 2.5, GRADUAL)
    while sum(done.values()) < count:
        point = next(given)
        found, told = grazing_return_of(point), jv.scenario(point)
        kind = told.follows.name
        if len(point.spot.times) or found.is_half_orbit or done.get(kind, 0) * 3 > count:
            continue
        done[kind] = done.get(kind, 0) + 1
        near = SquareRootMap(told.root, told.matrix)
        n = next(n for n in range(2, 40) if near.added_impact_window(n).next_grazing_root < FAR)
        top = near.added_impact_window(n).depth(near.added_impact_window(n).next_grazing_root)
        depths = top * told.ratio ** -rng.random(DEPTHS)
        scene = point.scene.replace(**{point.name: point.value + top / told.rate})
        x, v = before(point, found)
        start = jv.State(x, v, float(scene.frequency) * (found.omitted_grazings[0].time - EARLY))
        seen = jv.spectrum(scene, point.name, point.value + depths / told.rate, start, settle=2000, most=2**14)
        positive = seen["exponent"].values[:, 0] > 0
        ends = [
            (one.depth(one.stable), one.depth(one.touch))
            for one in map(near.added_impact_window, range(1, 60))
            if one.stable > 0
        ]
        inside = np.array([any(low < depth < high for low, high in ends) for depth in depths])
        table = tables.setdefault(kind, np.zeros((2, 2), int))
        np.add.at(table, (inside.astype(int), positive.astype(int)), 1)
        between, within = (f"{positive[part].sum()} of {part.sum()}" for part in (~inside, inside))
        shown = f"between windows {between}, in windows {within}"
        print(kind, told.multipliers.real, "exponent above 0:", shown, flush=True)
    for kind, ((a, b), (c, d)) in tables.items():
        print(f"{kind}: chaos between windows {b} of {a + b}, in windows {d} of {c + d}")


def jumps(count, seed):
    """Where orbits with one impact in n returns fold and what they are at the grazing, against the square-root map."""
    rng, given, worst = np.random.default_rng(seed), None, []
    given = grazings(rng, 0.5, 0.97, ("JUMP",))
    done = 0
    while done < count:
        point = next(given)
        told, found = jv.scenario(point), grazing_return_of(point)
        n, near = told.deeper, SquareRootMap(told.root, told.matrix).added_impact_window(told.deeper)
        orbits = added_impact_orbits(found, n, typical_length(point.scene))
        speed, z = near.linear_coefficient * np.sqrt(2.0 * told.acceleration), orbits.grazing_z
        for share in np.linspace(0.1, 1.0, 10):
            one = orbits.point_at_speed(z, share * speed)
            z = one.z
            if not one.met:
                break
        good, _ = orbits.closest_approach(z)
        if not (one.met and good) or near.linear_coefficient > 0.1:
            print("  far:", told.deeper, near.linear_coefficient, one.met, good)
            continue
        spot = orbits.orbit_point_at(z, one.residual)
        orbit = orbit_from_point(point.scene.replace(**{point.name: spot.value}), spot)
        predicted = told.orbits[n - 1]
        size = predicted.fold - point.value
        values = (point.value + 3.0 * size, point.value - size, spot.value + size, spot.value - size)
        room = min(values), max(values)
        step = 0.1 * speed
        branch = jv.follow(orbit, point.name, room, first_step=step, largest_step=step)
        folds = [one.value for one in branch.points("SN")]
        share = min((abs((one - point.value) / (predicted.fold - point.value) - 1.0) for one in folds), default=np.inf)
        done += 1
        worst.append(share / near.linear_coefficient)
        print(
            done,
            point.name,
            orbit.label,
            predicted.label,
            f"n {n}, q {near.linear_coefficient:.2e}, stable",
            orbit.stable,
            end=" ",
        )
        print(f"fold {predicted.fold - point.value:.4e}, off by {share:.1e} of it", branch.reasons, flush=True)
    print(f"{done} jumps: folds off by {max(worst):.2g} q of themselves at most")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, number, *rest = sys.argv[1:]
    {"places": places, "returns": returns, "runs": runs, "chaos": chaos, "jumps": jumps}[what](
        int(number), *map(int, rest or [0])
    )
