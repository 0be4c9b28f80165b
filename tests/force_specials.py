"""Orbits and special points of scenes with a force of their own against Newton's method in 40 digits, and those of a
ball that bounces on a table against closed forms."""

import jax
import mpmath
import numpy as np

import jaxvibro as jv

from .reference import own_force_points as reference

KINDS = ("SN", "SB", "PD", "GR")
ALONG = {"amplitude": (0.0, 6.0), "force.cubic": (-0.3, 6.0)}
POINTS = 12  # of a branch, whose orbits are solved anew
MOST = 1, 2  # periods, impacts: others are compiled each by themselves
BALL = {"g": (0.5, 3.0), "restitution": (0.2, 0.95), "frequency": (0.6, 4.0)}


def duffing(walls=(-1.0, 1.0), amplitude=2.0, cubic=0.5, damping=0.05, frequency=2.1, restitution=0.7):
    """A Duffing oscillator between walls."""
    force = jv.Force("duffing", {"cubic": cubic, "damping": damping})
    return jv.make_scene(amplitude, frequency, restitution=restitution, walls=walls, force=force)


def case_of(scene, name, kind, periods):
    """The reference's form of a special point, or with "" of an orbit; each wall has a restitution of its own there."""
    numbers = {each: float(scene.parameter(each)) for each in scene.names if each != "restitution"}
    for side, wall in scene.walls.items():
        own = scene.restitution if wall.restitution is None else wall.restitution
        numbers[f"{side}.restitution"] = float(own)
    return reference.Case(kind, scene.force.function.__name__, numbers, name, periods)


def solved(point):
    """(`Case`, [x, v, value] in many digits) of a special point."""
    case = case_of(point.scene, point.name, point.kind, point.spot.periods)
    state = point.orbit.state
    given = float(state.x), float(state.v), point.value
    if float(state.phase):
        raise ArithmeticError("its state is not at phase 0")
    if point.kind == "GR":
        case = reference.touching(case, *given)
    return case, case.solved(*given)


def branch():
    """Print how far points of Duffing's oscillator between two walls are from the reference's: special points, and
    orbits of the branches."""
    worst, kinds = 0.0, {}
    with mpmath.workdps(reference.DIGITS):
        for found in duffing_branches():
            places = set(np.linspace(1, len(found) - 2, POINTS).astype(int)) - {one.place for one in found.special}
            apart = [orbit_error(found, place) for place in places]  # at folds there is no one orbit to solve for
            print(f"{found}: orbits apart by {max(apart):.1e}", flush=True)
            worst = max(worst, *apart)
            for point in found.special:
                if point.kind in KINDS:
                    error = abs(float(solved(point)[1][2] - point.value))
                    print(f"  {point.kind} {point.label} {point.name} {point.value:.12g}: {error:.1e}", flush=True)
                    kinds[point.kind], worst = kinds.get(point.kind, 0) + 1, max(worst, error)
    print(f"special points {kinds}, largest error {worst:.2g}")


def duffing_branches():
    """P111 along the amplitude and along the cubic term, and what leaves these; a scene that is not symmetric."""
    for name, bounds in ALONG.items():
        orbit = jv.find_orbit(duffing(amplitude=2.0 if name == "amplitude" else 4.0), jv.State(0.9, -1.1))
        first = jv.follow(orbit, name, bounds)
        yield first
        for kind in ("SB", "PD"):
            for point in first.points(kind)[:1]:
                yield jv.switch(point)[0]
    orbit = jv.find_orbit(duffing((-0.9, 1.1), amplitude=3.0), jv.State(0.9, -1.1))
    for name, bounds in ALONG.items():
        yield jv.follow(orbit, name, bounds)


def orbit_error(found, place):
    """How far the state of an orbit of a branch is from the reference's."""
    orbit, value = found.orbit(place), float(found.values[place])
    case = case_of(orbit.scene, found.name, "", orbit.periods)
    state = [float(orbit.state.x), float(orbit.state.v)]
    return max(abs(float(a - b)) for a, b in zip(case.solved(*state, value), state, strict=False))


def located(count, seed=0):
    """Print the errors of gradients of special points by all numbers of so many random scenes."""
    worst, kinds = 0.0, {}
    for point in points(np.random.default_rng(seed), count):
        with mpmath.workdps(reference.DIGITS):
            try:
                errors = gradient_errors(point)
            except (jv.ArgumentError, ArithmeticError) as problem:
                print("  skipped:", point.kind, str(problem)[:120], flush=True)
                continue
        kinds[point.kind], worst = kinds.get(point.kind, 0) + 1, max(worst, *errors.values())
        print(point.kind, point.name, point.label, {name: f"{error:.1e}" for name, error in errors.items()}, flush=True)
    print(f"gradients: {kinds}, largest error {worst:.3g}")


def points(rng, count):
    """A special point each of branches of so many random scenes with one wall or two, along the amplitude or the cubic
    term."""
    found, seen = 0, {}
    while found < count:
        name, walls = str(rng.choice(list(ALONG))), (-rng.uniform(0.5, 1.3), rng.uniform(0.3, 1.3))
        alike = rng.random() < 0.3
        own = rng.uniform(0.5, 0.9, 2)
        pair = jv.Wall(-walls[1] if alike else walls[0], own[int(alike)]), jv.Wall(walls[1], own[1])
        numbers = {"amplitude": (1.0, 5.0), "cubic": (0.1, 2.0), "damping": (0.02, 0.3), "frequency": (1.2, 3.2)}
        scene = duffing(pair, **{each: rng.uniform(*ends) for each, ends in numbers.items()})
        try:
            orbit = jv.find_orbit(scene, jv.State(0.0, 0.0))
            if orbit.periods > MOST[0] or orbit.impacts.count > MOST[1]:
                continue
            value = float(scene.parameter(name))
            special = jv.follow(orbit, name, (0.3 * value, 2.0 * value)).special
        except (jv.OrbitError, jv.ArgumentError) as problem:
            print("  skipped:", str(problem)[:100], flush=True)
            continue
        some = [one for one in special if one.kind in KINDS and len(one.spot.times) <= MOST[1]]
        if some:
            point = min(some, key=lambda one: seen.get(one.kind, 0))
            seen[point.kind], found = seen.get(point.kind, 0) + 1, found + 1
            yield point


def gradient_errors(point):
    """{name: error of the derivative over 1 + its size}; "value": that of the value."""
    case, unknowns = solved(point)
    slopes = jax.grad(jv.located(point))(point.scene)
    true, found = case.gradient(unknowns, ways(point)), {"value": abs(float(unknowns[2] - point.value))}
    for name, way in ways(point).items():
        mine = sum(sign * float(slopes.parameter(each)) for each, sign in way)
        found[name] = float(abs(mine - true[name]) / (1 + abs(true[name])))
    return found


def ways(point):
    """{name: [(name, weight)]} of the changes of a point's scene; those of a symmetric one change both walls."""
    found = {}
    for name in case_of(point.scene, point.name, point.kind, 1).numbers:
        side, _, own = name.partition(".")
        if name == point.name or (point.kind == "SB" and side == "left"):
            continue
        found[name] = [(name, 1)]
        if point.kind == "SB" and side == "right":
            found[name].append((f"left.{own}", -1 if own == "position" else 1))
    return found


def gravity(t, x, v, p):
    return -p["g"]


def bounced(rng, periods=1, side=-1, place=None):
    """(orbit, {kind: the swing}) of a ball that falls on a table and bounces once in so many of its periods.

    It comes with the speed g T / 2 and leaves with as much, T being the time of a flight: so the table, which moves as
    a cos(psi), goes against it with s = (g T / 2) (1 - R) / (1 + R) at an impact, where -a omega sin(psi) = s. The map
    of the impacts' (time, speed after) has there the determinant R^2 and the trace 1 + R^2 - (1 + R)^2 a omega^2
    cos(psi) / g, as the time between impacts changes by (1 + R) / g times the speed: an SN where cos(psi) = 0, a PD
    where the trace is -1 - R^2. side: that of the table; on the right g is below 0. place: its middle.
    """
    g, bounce, omega = (rng.uniform(*ends) for ends in BALL.values())
    phase, place = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-1.0, 1.0) if place is None else place
    flight = 2.0 * np.pi * periods / omega
    least = 0.5 * g * flight * (1.0 - bounce) / (1.0 + bounce) / omega
    known = {"SN": least, "PD": np.hypot(least, 2.0 * g * (1.0 + bounce**2) / (omega * (1.0 + bounce)) ** 2)}
    swing = 0.5 * sum(known.values())
    psi = -np.arcsin(least / swing)
    late = (phase + (side > 0) * np.pi - psi) % (2.0 * np.pi) / omega  # since the impact, at phase 0
    height = swing * np.cos(psi) + 0.5 * g * late * (flight - late)
    state = jv.State(place - side * height, -side * g * (0.5 * flight - late))
    table = jv.Wall(place, bounce, motion=jv.Motion(swing, phase))
    walls = (table, None) if side < 0 else (None, table)
    force = jv.Force(gravity, {"g": -side * g})
    scene = jv.make_scene(0.0, omega, restitution=0.5, walls=walls, force=force)
    return jv.find_orbit(scene, state, periods, settle=0), known


def ball_errors(orbit, known):
    """{kind: error of the swing over its size} along the branch of `bounced`."""
    name = f"{'left' if orbit.impacts.side[0] < 0 else 'right'}.motion.amplitude"
    found = jv.follow(orbit, name, (0.5 * known["SN"], 1.2 * known["PD"]), stop="PD")
    errors = {}
    for kind, true in known.items():
        values = [one.value for one in found.points(kind) if one.label == orbit.label]
        errors[kind] = min((float(abs(value / true - 1.0)) for value in values), default=np.inf)
    return errors


def ball(count, seed=0):
    """Print how far the SN and the PD of so many bouncing balls are from their closed forms."""
    rng, worst = np.random.default_rng(seed), {"SN": 0.0, "PD": 0.0}
    for _ in range(count):
        orbit, known = bounced(rng, int(rng.integers(1, 4)), int(rng.choice((-1, 1))))
        errors = ball_errors(orbit, known)
        worst = {kind: max(worst[kind], errors[kind]) for kind in worst}
        told = ", ".join(f"{kind} {known[kind]:.6g}: {error:.1e}" for kind, error in errors.items())
        print(f"{orbit.label}, g {orbit.scene.parameter('force.g'):.4g}: {told}", flush=True)
    print(f"{count} balls, largest errors of the swing over its size {worst}")
