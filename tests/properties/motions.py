"""Batches of motions for the properties: one call of one shape, and scenes made from a scene."""

from dataclasses import replace

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.scene.state import Contact as Contact
from jaxvibro.scene.state import Status as Status
from tests.kinds import LANES, wall_ends

SLOTS = 8  # impacts that are recorded
SLOW = 1e-2  # slower impacts are chatter, whose derivatives are large
NEAR = 1e-6  # of a wall: rounding decides


def take(tree, lanes):
    """Return some lanes of a batch, or one lane of floats."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes] if np.ndim(leaf) else leaf, tree)


def lane_of(scene, state, lane):
    """Return the arguments of a reference: a scene of floats, x, v and phase of a lane."""
    return take(scene, lane), *(float(values[lane]) for values in (state.x, state.v, state.phase))


def direction_in(rng, scene, state):
    """Return scene and state with all numbers as lanes, and a random direction in these numbers (not in the contact).

    The components are small multiples of 1/4, so that steps along the direction are exact, and 0 where a damping or
    a restitution is at the end of its domain.
    """
    scene, state = jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf, float), LANES), (scene, state))

    def component(path, value):
        chosen = rng.choice([-0.5, -0.25, 0.25, 0.5], LANES)
        has_domain = getattr(path[-1], "name", "") in ("damping", "restitution", "stiffness")
        return np.where(has_domain & ((value < 1e-3) | (value == 1.0)), 0.0, chosen)

    direction = jax.tree_util.tree_map_with_path(component, (scene, state))
    return scene, state, (direction[0], replace(direction[1], contact=np.zeros(LANES)))


def moved(scene, state, direction, step):
    """Return scene and state a step along a direction."""
    return jax.tree.map(lambda value, by: value + step * by, (scene, state), direction)


def slope_bound(kind, truth):
    """Return the error that a derivative may have: a solver controls that of the motion alone."""
    return kind.tolerance * truth.allowed if kind.exact else 1e-8 * truth.allowed


def smooth(kind, scene, state):
    """Return the lanes that are decided and far from what makes derivatives large, or one-sided: graze and rest."""
    end, impacts = strobe(scene, state)
    keep, _ = decided(kind, scene, state, end, impacts)
    keep &= (impacts.least_speed > 0.05) & (impacts.least_clearance > 1e-3)
    for wall in scene.walls.values():
        if not wall.soft:
            keep &= np.asarray(wall.restitution) > 0.02
    return keep


def wall_speed(scene, wall, phase):
    """Return the velocity of a wall at a drive phase."""
    if wall.motion is None:
        return 0.0 * phase
    motion = wall.motion
    rate = motion.harmonic * scene.frequency
    return -rate * motion.amplitude * np.sin(motion.harmonic * phase + motion.phase)


def is_reversible(wall):
    """Return whether an impact on a wall can be undone: it leaves some speed."""
    if wall.law is not None:
        return np.ones(LANES, bool)
    if wall.soft:
        return np.asarray(wall.damping) < 0.9 * np.sqrt(1.0 + wall.stiffness)
    return np.asarray(wall.restitution) > 0.02


def between(scene, state):
    """Return the lanes whose mass is not beyond a still rigid wall, and not on one by rounding."""
    low, high = wall_ends(rebuild(scene, lambda wall: replace(wall, motion=None)), state.phase)
    return (state.x >= low) & (state.x <= high)


def energy(scene, state):
    """Return the energy of a mass between still walls."""
    x, total = state.x, 0.5 * state.v**2
    numbers = {"c1": 1.0}
    if scene.force:
        numbers = {"c1": 1.0 if "cubic" in scene.force.numbers else 0.0, **scene.force.numbers}
    total = total + numbers["c1"] * x**2 / 2.0 + numbers.get("c0", 0.0) * x + numbers.get("cubic", 0.0) * x**4 / 4.0
    for side, wall in zip((-1, 1), (scene.left, scene.right), strict=True):
        if wall is not None and wall.soft:
            total = total + 0.5 * wall.stiffness * np.maximum(0.0, side * (x - wall.position)) ** 2
    return total


def strobe(scene, state):
    """Return the state and the impacts after a period of the drive, as NumPy arrays."""
    return jax.device_get(jv.strobe(scene, state, 1, SLOTS, True))


def assert_same(*pairs):
    """Check that arrays have the same bits."""
    for computed, expected in pairs:
        np.testing.assert_array_equal(computed, expected)


def decided(kind, scene, start, end, impacts):
    """Return the lanes whose motion no rounding changes, and how far roundings may grow in each.

    Such a motion has at most SLOTS impacts, none of them slow or near the begin or the end, turns back near no wall,
    and starts and ends off the walls. The numbers of the one motion decide, never whether another one agrees.
    """
    period = 2.0 * np.pi / scene.frequency
    times = np.where(np.isfinite(impacts.time), impacts.time, 0.5 * period[:, None])
    keep = (impacts.status < Status.CAP) & (impacts.count <= SLOTS) & (impacts.least_speed > SLOW)
    keep &= (impacts.least_clearance > NEAR) & (times.min(-1) > 1e-3) & (times.max(-1) < period - 1e-3)
    for state in (start, end):
        for position in wall_ends(scene, state.phase):
            keep &= abs(state.x - position) > NEAR
    matrix = np.asarray(jv.monodromy(scene, start, slots=SLOTS))
    keep &= np.isfinite(matrix).all((1, 2))
    norm = np.linalg.norm(np.where(keep[:, None, None], matrix, 0.0), axis=(1, 2))
    keep &= norm < 1e6
    size = 5.0 + sum(abs(number) for number in (start.x, start.v, end.x, end.v, scene.amplitude))
    return keep, 1e3 * kind.tolerance * np.where(keep, size * (1.0 + norm), 0.0)


def assert_close(keep, bound, *pairs):
    """Check that arrays agree to the bound on the lanes that are kept."""
    for computed, expected in pairs:
        error = abs(np.asarray(computed) - np.asarray(expected))[keep]
        assert np.all(error <= bound[keep]), f"error {error.max()}, of a bound {bound[keep][error.argmax()]}"


def assert_alike(kind, scene, start, one, other, sign=1):
    """Check that two motions from a start agree; sign: of the other one's sides, -1 for a mirror image."""
    (end, impacts), (image, others) = one, other
    keep, bound = decided(kind, scene, start, end, impacts)
    assert_same((others.side[keep], sign * impacts.side[keep]), (others.count[keep], impacts.count[keep]))
    assert_close(keep, bound, (sign * image.x, end.x), (sign * image.v, end.v))
    late = np.nan_to_num(others.time, posinf=0.0) - np.nan_to_num(impacts.time, posinf=0.0)
    assert_close(keep, bound, (late.min(-1), 0.0 * bound), (late.max(-1), 0.0 * bound))


def rebuild(scene, wall=lambda wall: wall, sides=(0, 1), sign=1.0, drive=lambda term: term, damping=None):
    """Return the scene with each wall and each term of the drive changed by a function, and the drive times sign.

    sides: (1, 0) exchanges the walls. damping: of the flight, None for the scene's own.
    """
    walls = scene.left, scene.right
    changed = tuple(None if walls[k] is None else wall(walls[k]) for k in sides)
    terms = tuple(drive(jv.Motion(sign * term.amplitude, term.phase, term.harmonic)) for term in scene.drive or ())
    damping = None if damping is None else damping + 0.0 * scene.frequency
    own = scene.damping if damping is None else damping
    if scene.force is not None:
        numbers = dict(scene.force.numbers)
        if "c0" in numbers:
            numbers["c0"] = sign * numbers["c0"]
        if damping is not None:
            numbers["damping"] = damping
        own = None
        force = replace(scene.force, numbers=numbers)
        return jv.make_scene(sign * scene.amplitude, scene.frequency, walls=changed, drive=terms, force=force)
    return jv.make_scene(sign * scene.amplitude, scene.frequency, own, 0.7, changed, drive=terms)


def move(wall, position, motion):
    """Return a wall at another position; motion: function of amplitude, phase and harmonic."""
    moved = wall.motion and jv.Motion(*motion(wall.motion.amplitude, wall.motion.phase, wall.motion.harmonic))
    return replace(wall, position=position, motion=moved)


def elastic(scene):
    """Return the scene without losses."""

    def lossless(wall):
        if wall.law is not None:
            numbers = {**wall.law.numbers, "dissipation": 0.0 * wall.law.numbers["dissipation"]}
            return replace(wall, law=replace(wall.law, numbers=numbers))
        if wall.soft:
            return replace(wall, damping=0.0 * wall.damping)
        return replace(wall, restitution=1.0 + 0.0 * wall.restitution)

    return rebuild(scene, lossless, damping=0.0)
