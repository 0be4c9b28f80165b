"""Special points as functions of their scenes, against differences in 40 digits: `python -m tests.located_proof W N`.

gradients, hessians: of a random special point of each of N random branches, by every number of its scene, or in a
random direction of these. statuses: of lanes along the loci of SN and PD of N branches, where these end on a grazing, a
tenth of the lanes beyond it.
"""

import sys

import jax
import numpy as np
from mpmath import mpf, workdps

import jaxvibro as jv
from jaxvibro.branches.follow import set_up_equations
from jaxvibro.problem.grazing_contact import find_grazing_contacts
from jaxvibro.scene.codes import SolutionStatus
from jaxvibro.scene.scene import SIDES
from jaxvibro.scene.typical_scales import typical_length
from tests.branch_proof import branches, plain
from tests.locus_proof import theirs
from tests.reference import special as reference

KINDS = ("SN", "PD", "SB", "GR")
DIGITS, APART = 50, mpf(10) ** -12  # so far apart a central difference is right to 24 digits, a second one to 12
MOST = 8  # impacts
SLOW = 1e-9  # a speed of none


def exact(point, moved=(), wall=None):
    """The exact value of a special point in a scene whose numbers, by the references' names, are moved by so much;
    wall: of the touch, where there are several."""
    spot, scene = point.spot, plain(point.scene)
    with workdps(DIGITS):
        for name, change in moved:
            scene = reference.with_value(scene, name, mpf(number(scene, name)) + change)
    impacts = list(zip(*(part.tolist() for part in (spot.times, spot.speeds, spot.sides)), strict=True))
    touched = None
    if point.kind == "GR":  # the touch alone, of others none is an impact
        every = [(time, side) for time, speed, side in impacts if speed < SLOW]
        impacts = [one for one in impacts if one[1] >= SLOW]
        time, side = next(one for one in every or touches_of(point) if wall in (None, SIDES[one[1] > 0]))
        before = [k for k, one in enumerate(impacts) if one[0] < time]
        touched = before[-1] if before else max(0, len(impacts) - 1), time, side
    rows = zip(*impacts, strict=True) if impacts else ([], [], [])
    times, speeds, sides = (list(each) for each in rows)
    name = theirs(point.scene, point.name)
    given = times, speeds, [int(side) for side in sides], spot.periods, touched
    return reference.special(scene, name, point.kind, point.value, *given, DIGITS)


def number(scene, name):
    """A number of a reference's scene; of several that have one name, the first."""
    if name == "restitution":
        return next(wall.restitution for _, wall in scene.walls())
    for part in name.split("."):
        scene = getattr(scene, reference.FIELDS.get(part, part))
    return scene


def touches_of(point):
    """(time, side) of each touch of a GR."""
    times = point.spot.times
    found = find_grazing_contacts(*set_up_equations(point.scene, point.name, point.spot), typical_length(point.scene))
    return [((times[one.row] if len(times) else 0.0) + one.time_since_impact, one.side) for one in found]


def ways(point):
    """The ways in which a point's scene can change: {name of ours: [names of the references']}; at an SB the walls
    change together, with a sign each: [(name, sign)]."""
    scene, found = point.scene, {}
    for name in scene.names:
        side, _, own = name.partition(".")
        if name == point.name or (own == "restitution" and side in shared(scene)):
            continue
        if name == "restitution" and not shared(scene):
            continue
        if point.kind != "SB":
            found[name] = [(theirs(scene, name), 1)]
        elif name.startswith("right."):
            other = name.replace("right", "left")
            found[name] = [(name, 1), (other, -1 if name == "right.position" else 1)]
        elif "." not in name:
            found[name] = [(name, 1)]
    return found


def shared(scene):
    """The sides of the walls that have the scene's restitution."""
    return [side for side, wall in scene.walls.items() if wall.restitution is None]


def owned(name, moves):
    """Moves by our names: to us the scene's restitution is that of the walls without their own."""
    return [("restitution", 1)] if name == "restitution" else moves


def gradient_errors(point, wall=None):
    """{name: error of the derivative over 1 + its size}."""
    value = jv.located(point, wall=wall)
    gradient, found = jax.grad(value)(point.scene), {}
    for name, moves in ways(point).items():
        ends = [exact(point, [(each, way * sign * APART) for each, sign in moves], wall) for way in (1, -1)]
        true = float((ends[0] - ends[1]) / (2 * APART))
        mine = sum(sign * float(gradient.parameter(each)) for each, sign in owned(name, moves))
        found[name] = abs(mine - true) / (1.0 + abs(true))
    return found


def points(count, seed, wanted=KINDS):
    """A special point each of so many random branches."""
    rng, found = np.random.default_rng(seed), 0
    for branch, _ in branches(rng, 100 * count):
        some = [one for one in branch.special if one.kind in wanted and len(one.spot.times) <= MOST]
        if some:
            kinds = sorted({one.kind for one in some})
            kind = kinds[rng.integers(len(kinds))]
            some = [one for one in some if one.kind == kind]
            yield some[rng.integers(len(some))]
            found += 1
        if found == count:
            return


def hessian_error(point, rng):
    """The error of the second derivative in a random direction of its scene's numbers, over 1 + its size."""
    value, known = jv.located(point), ways(point)
    weights = dict(zip(known, rng.normal(size=len(known)), strict=True))

    def moved(step):
        moves = [(each, step * weights[name] * sign) for name in known for each, sign in known[name]]
        return exact(point, moves)

    with workdps(DIGITS):
        true = float((moved(APART) - 2 * moved(mpf(0)) + moved(-APART)) / APART**2)

    def along(step):
        change = {}
        for name, moves in known.items():
            for each, sign in owned(name, moves):
                change[each] = change.get(each, 0.0) + weights[name] * sign
        return value(point.scene.replace(**{key: point.scene.parameter(key) + step * by for key, by in change.items()}))

    mine = float(jax.grad(jax.grad(along))(0.0))
    return abs(mine - true) / (1.0 + abs(true))


def status_errors(point, rng, lanes=200):
    """(lanes, wrong statuses) of scenes along a locus and a tenth of them beyond the grazing at which it ends; None
    where it ends at none, or does not go one way towards it."""
    other = "frequency" if point.name != "frequency" else "damping"
    value, here = float(point.scene.parameter(other)), point.value
    bounds = {point.name: (0.3 * here, 2.0 * here), other: (0.5 * value, 1.7 * value)}
    locus = jv.locus(point, (point.name, other), bounds)
    for end in (each for each in locus.special if each.kind == "GR"):
        values, start = locus.values[:, 1], int(np.argmin(abs(locus.values - [here, value]).sum(axis=1)))
        path = values[min(start, end.place) : max(start, end.place) + 1]
        steps = np.diff(path)
        if len(path) < 3 or not (np.all(steps > 0) or np.all(steps < 0)):
            continue
        edge, way = float(end.values[other]), np.sign(end.values[other] - value)
        beyond = np.arange(lanes) < lanes // 10
        far = abs(edge - value) * rng.uniform(1e-6, 0.02, lanes)
        near = value + (edge - value) * rng.uniform(0.0, 1.0 - 1e-6, lanes)
        drawn = np.where(beyond, edge + way * far, near)
        found = np.asarray(jv.located(point).solve(point.scene.replace(**{other: drawn})).status)
        wrong = np.where(beyond, found != SolutionStatus.VIRTUAL, found != SolutionStatus.OK)
        return (
            lanes,
            int(wrong.sum()),
            np.bincount(found[beyond], minlength=4),
            np.bincount(found[~beyond], minlength=4),
        )
    return None


def main(what, count, seed=0):
    """Print the errors, the worst last."""
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(seed)
    if what == "statuses":
        told = [one for one in (seen(point, rng) for point in points(count, seed, ("SN", "PD"))) if one]
        print(
            f"statuses: {sum(one[0] for one in told)} lanes at {len(told)} points, {sum(one[1] for one in told)} wrong"
        )
        return
    worst, kinds = 0.0, {}
    for point in points(count, seed):
        try:
            errors = gradient_errors(point) if what == "gradients" else {"along": hessian_error(point, rng)}
        except (jv.ArgumentError, ArithmeticError) as error:
            print("  skipped:", point.kind, str(error)[:120], flush=True)
            continue
        kinds[point.kind] = kinds.get(point.kind, 0) + 1
        worst = max(worst, *errors.values())
        print(point.kind, point.name, point.label, {name: f"{error:.1e}" for name, error in errors.items()}, flush=True)
    print(f"{what}: {kinds}, largest error {worst:.3g}")


def seen(point, rng):
    """`status_errors`, printed; None where there are none."""
    try:
        found = status_errors(point, rng)
    except (jv.ArgumentError, ArithmeticError) as error:
        print("  skipped:", point.kind, str(error)[:120], flush=True)
        return None
    if found:
        print(point.kind, point.name, point.label, *found, flush=True)
    return found


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
