"""Normal forms of random special points against the branches themselves: `python -m tests.normal_forms_proof WHAT N`.

forks: N PD and SB of random branches: whether the branches that leave them are on the side that is told, stable where
it says supercritical, and how the parameter bends along them, by points on them and in 40 digits. folds: the same of
SN. grazings: N GR, the root by certified flights that meet the wall a little, the depth's slope by the clearance of
orbits before it.
"""

import sys
from dataclasses import replace
from itertools import pairwise

import jax
import numpy as np

import jaxvibro as jv
from continuation import event_search
from continuation.arclength import StepControl
from continuation.branch_point_tangents import branch_tangents
from continuation.intermediate_points import make_start_point
from jaxvibro.branches.switch import branch_starts
from jaxvibro.problem.grazing_contact import arclength_weights, find_grazing_contacts
from jaxvibro.problem.grazing_jumps import GrazingJump
from jaxvibro.problem.orbit_equations import continuation_problem
from jaxvibro.problem.orbit_point import set_up_equations
from jaxvibro.scene.typical_scales import typical_length
from tests.branch_proof import branches, called, plain
from tests.reference.bends import bend

MOST = 8  # impacts
NEAR = 0.02  # of the speeds and flights at a point: the farthest of the points on the branches that leave it
SURE = 1e-9  # of the parameter: a branch's points so far from where it begins are on a side of it
LEAST = 1e-6  # a step: as short is lost in the rounding of what Newton's method is to reach
DEPTH = 0.02  # of the scene's length: the root of the deepest contact


def exact(point):
    """b in many digits."""
    spot = point.spot
    rows = [part.tolist() for part in (spot.times, spot.speeds)]
    sides = [int(side) for side in spot.sides]
    length = typical_length(point.scene)
    return float(bend(plain(point.scene), called(point), point.kind, point.value, *rows, sides, spot.periods, length))


def aside(along, begun, length, far):
    """(z, s) of the orbit so far along a branch that leaves a point."""
    numbers = (np.float64(each) for each in (0.0, 1.0, 1e-11, -np.inf, np.inf))
    scale = arclength_weights(along, length)
    z = event_search.take_step(continuation_problem(along), begun, far, StepControl(scale, *numbers), along).z
    return z, float(np.sum((scale**2 * begun.tangent * (z - begun.z))[:-1]))


def measured(point):
    """b by points on a branch through or from the point, extrapolated: of both ways the mean is even in s."""
    length = typical_length(point.scene)
    if point.kind == "SN":
        along, z = set_up_equations(point.scene, point.name, point.spot)
        begun = make_start_point(
            z, event_search.unit_tangent(continuation_problem(along), z, arclength_weights(along, length), along)
        )
    else:
        along, begun = branch_starts(symmetric(point))[0]
    means = []
    for share in (1.0, 0.5, 0.25):
        both = [aside(along, begun, length, way * share * far(point)) for way in (1.0, -1.0)]
        means.append(np.mean([(z[-1] - begun.z[-1]) / s**2 for z, s in both]))
    near = [(4.0 * b - a) / 3.0 for a, b in pairwise(means)]
    return (16.0 * near[1] - near[0]) / 15.0


def far(point):
    """How far from a point its branches are looked at."""
    return NEAR * min(1.0, point.spot.speeds.min() / typical_length(point.scene), flights(point).min())


def flights(point):
    """How long each flight is."""
    times, span = point.spot.times, point.spot.periods * 2.0 * np.pi / float(point.scene.frequency)
    return np.diff(np.append(times, times[0] + span))


def is_right(point, form):
    """Whether the branches that leave a PD or SB are on the side that is told, and stable there if it is soft: at the
    first point that is told from it by more than rounding. None where an impact is so slow that they go no step."""
    point = symmetric(point)
    step, size = far(point), 1.0 + abs(point.value)
    room = np.clip(abs(form.coefficient) * (20.0 * step) ** 2, 10.0 * SURE * size, 1e-3 * size)
    low, high = max(point.value - room, point.bounds[0]), min(point.value + room, point.bounds[1])
    for branch in jv.switch(point, (low, high), step, 4.0 * step):
        if len(branch) == 1 and step < LEAST:
            return None
        gaps = branch.values - point.value
        first = int(np.argmax(abs(gaps) > SURE * (1.0 + abs(point.value)))) or len(gaps) - 1
        if np.sign(gaps[first]) != form.side or branch.stable[first] != (form.criticality == "supercritical"):
            return False
    return True


def symmetric(point):
    """An SB as a point of its symmetric branch, which the lopsided ones leave, be it found on one of these or not."""
    if point.kind != "SB":
        return point
    along, z = set_up_equations(point.scene, point.name, point.spot)
    both = branch_tangents(continuation_problem(along), z, arclength_weights(along, typical_length(point.scene)), along)
    tangent, rows, count = both[np.argmax(abs(both[:, -1]))], len(along.sequence.sides), len(point.spot.times)
    return replace(point, slopes=np.concatenate([tangent[:count], tangent[rows : rows + count], tangent[-1:]]))


def root_by_flights(point, depth, touch):
    """The jump of the velocity over the root of the depth, extrapolated from flights that meet the wall so deep."""
    return extrapolated([jump(point, depth, touch, DEPTH * 0.5**k) for k in range(6)])


def extrapolated(values):
    """The limit of values at h, h / 2, h / 4, ... of a series in h."""
    for order in range(1, len(values)):
        values = [(2.0**order * b - a) / (2.0**order - 1.0) for a, b in pairwise(values)]
    return values[0]


def jump(point, depth, touch, h):
    """(v after - v without) over the root of a depth of h^2 lengths, at the moment at which the flight would be so deep
    behind the wall, as told by the certified flight into it: this begins before that moment, by the free flow."""
    scene, side = point.scene, depth.side

    frequency, (phase, wall, pace) = float(scene.frequency), touch
    length = typical_length(scene)
    back = 3.0 * h * np.sqrt(2.0 * length / depth.acceleration)
    x, v = wall + side * length * h * h, pace
    start = flown(scene, x, v, phase, -back)
    state = jv.State(*start, phase - frequency * back)
    _, met = jv.strobe(scene, state)
    late, hit = float(np.asarray(met.time)[0]), int(np.asarray(met.side)[0])
    assert hit == side and late < back
    theta = phase - frequency * (back - late)
    before = flown(scene, *start, phase - frequency * back, late)
    where, moving = placed(scene, side, theta)
    own = scene.left if side < 0 else scene.right
    r = float(scene.restitution if own.restitution is None else own.restitution)
    after = flown(scene, where, moving - r * (before[1] - moving), theta, back - late)
    return abs(after[1] - v) / (h * np.sqrt(length))


def flown(scene, x, v, phase, time):
    """(x, v) of the driven oscillator a time later or earlier, without walls: by its closed form."""
    omega, gamma, force = (float(each) for each in (scene.frequency, scene.damping, scene.amplitude))
    z = force / (1.0 - omega**2 + 2j * gamma * omega)
    p, q = (z * np.exp(1j * phase)).real, (1j * omega * z * np.exp(1j * phase)).real
    roots = np.roots([1.0, 2.0 * gamma, 1.0]).astype(complex)
    a = np.linalg.solve(np.array([[1.0, 1.0], roots]), [x - p, v - q])
    turned = phase + omega * time
    e = a * np.exp(roots * time)
    return (
        e.sum().real + (z * np.exp(1j * turned)).real,
        (roots * e).sum().real + (1j * omega * z * np.exp(1j * turned)).real,
    )


def placed(scene, side, phase):
    """Where a wall is at a phase of the drive, and how fast it moves."""
    wall = scene.left if side < 0 else scene.right
    place, pace = float(wall.position), 0.0
    if wall.motion is not None:
        n, angle = wall.motion.harmonic, wall.motion.harmonic * phase + float(wall.motion.phase)
        place += float(wall.motion.amplitude) * np.cos(angle)
        pace -= float(wall.motion.amplitude) * n * float(scene.frequency) * np.sin(angle)
    return place, pace


def touched(point):
    """(phase, wall, its velocity) at each touch, and its `GrazingJump`, in the same order."""
    along, z = set_up_equations(point.scene, point.name, point.spot)
    omega = float(point.scene.frequency)
    met = find_grazing_contacts(along, z, typical_length(point.scene))
    found = {}
    for one in met:
        begin = z[one.row] if len(along.sequence.sides) else 0.0
        phase = omega * (begin + (0.0 if one.is_impact else one.time_since_impact))
        found.setdefault(one.side, (phase, *placed(point.scene, one.side, phase)))
    return found


def slope_by_clearance(point):
    """How the depth grows with the parameter, by the least clearance of orbits where they keep off the wall, told by
    certified flights. None where there is no such orbit so far away."""
    bare = min(point.joins, key=lambda one: len(one.times))
    along, z = set_up_equations(point.scene, point.name, bare)
    control = StepControl(
        arclength_weights(along, 1.0), *(np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
    )
    way, found = np.sign(bare.value - point.value), []
    for k in range(4):
        value = point.value + way * 4e-4 * 0.5**k * (1.0 + abs(point.value))
        at = event_search.solve_with_fixed_entry(continuation_problem(along), z, len(z) - 1, value, control, along)
        if not at.converged:
            return None
        scene = point.scene.replace(**{point.name: value})
        found.append(clearance(scene, along, at.z) / (point.value - value))
    return extrapolated(found)


def clearance(scene, along, z):
    """The least clearance of an orbit, by certified flights."""
    rows = len(along.sequence.sides)
    if rows:
        side, omega = int(along.sequence.sides[0]), float(scene.frequency)
        theta = omega * z[0]
        where, moving = placed(scene, side, theta)
        own = scene.left if side < 0 else scene.right
        r = float(scene.restitution if own.restitution is None else own.restitution)
        state = jv.State(where, moving - side * r * z[rows], theta, float(side))
    else:
        state = jv.State(z[0], z[1])
    _, met = jv.strobe(scene, state, int(along.sequence.periods), clearance=True, slots=16)
    return float(np.asarray(met.least_clearance))


def points(kinds, count, seed, most):
    """Special points of these kinds of random branches, a few of each branch."""
    rng, found = np.random.default_rng(seed), 0
    for branch, _ in branches(rng, 100 * count):
        some = [one for one in branch.special if one.kind in kinds and len(one.spot.times) <= MOST]
        for at in branch.points("SB")[:1] if "PD" in kinds else ():  # most PD are on branches that leave an SB
            some += [one for new in jv.switch(at)[:1] for one in new.special if one.kind in kinds]
        for k in rng.permutation(len(some))[:most]:
            yield some[k]
            found += 1
            if found == count:
                return


def bends(kinds, count, seed):
    """Print what is wrong with coefficients of SN, PD or SB, and the largest errors."""
    seen, wrong, stuck, worst, off = {}, 0, 0, 0.0, []
    for point in points(kinds, count, seed, 2):
        form = point.normal_form
        true, near = exact(point), measured(point)
        error = abs(form.coefficient / true - 1.0)
        seen_there = True if point.kind == "SN" else is_right(point, form)
        stuck += seen_there is None
        right = form.side == np.sign(true) and seen_there is not False
        told = f"{point.kind}{len(point.spot.times)} {form.criticality}"
        seen[told] = seen.get(told, 0) + 1
        wrong += not right
        worst = max(worst, error)
        off.append(abs(near / true - 1.0))
        print(point.kind, point.name, point.label, f"{point.value:.9g}", form, form.consequence, end=" ")
        print(
            f"error {error:.1e}, of points on the branch {off[-1]:.1e}",
            "" if right else "WRONG SIDE",
            "" if seen_there is not None else "by digits alone",
            flush=True,
        )
    print(
        f"{sum(seen.values())} points {seen}: wrong {wrong}, too slow to be followed {stuck}, largest error {worst:.2g}"
    )
    print(f"the branches' own curvature differs by {np.median(off):.2g} in the median, by less than 1e-3 at", end=" ")
    print(f"{np.sum(np.array(off) < 1e-3)}")


def grazings(count, seed):
    """Print the errors of roots and slopes at GR."""
    worst, steep, skipped, number = 0.0, [], 0, 0
    for point in points(("GR",), count, seed, 2):
        form, places = point.normal_form, touched(point)
        number += 1
        for depth in form.depths:
            assert isinstance(depth, GrazingJump)
            found = root_by_flights(point, depth, places[depth.side])
            worst = max(worst, abs(found / depth.root - 1.0))
            if abs(found / depth.root - 1.0) > 1e-6:
                print("OFF", point.name, point.label, depth, found)
        slope = slope_by_clearance(point) if len({abs(one.slope) for one in form.depths}) == 1 else None
        if slope is None:
            skipped += 1
        else:
            steep.append(abs(slope / form.rate - 1.0))
        told = "-" if slope is None else f"{steep[-1]:.1e}"
        print(point.name, point.label, form, form.consequence, " ".join(sorted(one.label for one in point.meets)), told)
    print(
        f"{number} GR: roots differ by {worst:.2g} at most; slopes, {skipped} left out, by {np.median(steep):.2g}",
        end="",
    )
    print(f" in the median, {max(steep):.2g} at most")


def main(what, count, seed=0):
    """One of the checks."""
    jax.config.update("jax_enable_x64", True)
    if what == "grazings":
        grazings(count, seed)
    else:
        bends({"forks": ("PD", "SB"), "folds": ("SN",)}[what], count, seed)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
