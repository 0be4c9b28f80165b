"""Kinds of random scene, each with a reference implementation that shares no code with the package.

A kind turns rows of numbers into a batch of scenes of one structure and their initial states. All numbers lie on a
grid of 2^-20, so that starts on walls, walls at 0, R = 0 and 1, no damping, and resonance are among them. Add a kind to
`KINDS`, and every property in `tests/properties` that `tests/tiers.toml` draws of all kinds holds for it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import diffrax
import jax
import numpy as np

import jaxvibro as jv

from . import truths

LANES = 8  # scenes of a batch: one shape, so that each kind is compiled once
GRID = 2.0**20
# name: (low, high, values that are drawn often)
NUMBERS = {
    "amplitude": (-9.0, 9.0, ()),
    "frequency": (0.3, 8.0, (1.0,)),
    "damping": (0.0, 1.5, (0.0, 1.0)),
    "left": (-4.0, 2.0, (0.0,)),
    "gap": (0.3, 4.0, ()),
    "left_restitution": (0.0, 1.0, (0.0, 1.0)),
    "right_restitution": (0.0, 1.0, (0.0, 1.0)),
    "left_swing": (0.0, 0.45, ()),
    "right_swing": (0.0, 0.45, ()),
    "left_phase": (0.0, 6.0, ()),
    "right_phase": (0.0, 6.0, ()),
    "share": (0.01, 0.99, (0.0,)),  # of the gap, from the left wall to the start
    "v": (-5.0, 5.0, ()),
    "phase": (-6.0, 6.0, (0.0,)),
    "first": (0.0, 1.0, (0.0,)),  # two numbers with a meaning of their own in each kind
    "second": (0.0, 1.0, ()),
}
# ranges in which scenes lose energy and have attractors, for studies of single scenes
TAME = {
    "amplitude": (0.5, 4.0, ()),
    "frequency": (0.8, 4.0, ()),
    "damping": (0.02, 0.3, ()),
    "left": (-1.5, -0.2, ()),
    "gap": (0.8, 2.5, ()),
    "left_restitution": (0.3, 0.9, ()),
    "right_restitution": (0.3, 0.9, ()),
    "left_swing": (0.0, 0.1, ()),
    "right_swing": (0.0, 0.1, ()),
    "share": (0.1, 0.9, ()),
    "v": (-1.0, 1.0, ()),
    "phase": (0.0, 0.0, ()),
    "first": (0.05, 0.5, ()),
    "second": (0.3, 0.7, ()),
}


def draw_rows(seed, lanes=LANES, ranges=NUMBERS):
    """Draw rows by number, reproducible from the seed."""
    rng = np.random.default_rng([19, seed])
    columns = []
    for low, high, often in (NUMBERS | ranges).values():
        column = np.round(rng.uniform(low, high, lanes) * GRID) / GRID
        if often:
            column = np.where(rng.random(lanes) < 0.2, rng.choice(often, lanes), column)
        columns.append(column)
    return np.array(columns).T


@dataclass(frozen=True)
class Kind:
    """A kind of scene.

    scene: from named numbers, each (LANES,), to a batch of scenes. truth: from a scene, a state (floats) and a number
    of periods to a `truths.Truth`; it raises `Discard` for motions whose impacts rounding decides. tolerance: relative
    error of a flight, of the solver's or of rounding. exact: the flow is a closed form.
    """

    name: str
    scene: Callable
    truth: Callable
    tolerance: float = 1e-13
    exact: bool = True

    def batch(self, rows):
        """Return the batch of scenes and the initial states of rows of numbers."""
        numbers = dict(zip(NUMBERS, np.array(rows, float).T, strict=True))
        scene = self.scene(numbers)
        low, high = wall_ends(scene, numbers["phase"])
        low = np.where(np.isfinite(low), low, high - 3.0)
        high = np.where(np.isfinite(high), high, low + 3.0)
        x = low + numbers["share"] * (high - low)
        return scene, jv.State(x, numbers["v"], numbers["phase"], np.zeros(len(x)))

    def draw(self, seed, lanes=LANES):
        """Return a batch by number."""
        return self.batch(draw_rows(seed, lanes))

    def draw_single(self, seed):
        """Return a scene that loses energy, and a state, both without a batch, by number."""
        batch = self.batch(draw_rows(seed, 1, TAME))
        return jax.tree.map(lambda leaf: float(leaf[0]) if np.ndim(leaf) else leaf, batch)


def wall_ends(scene, phase):
    """Return the positions of the left and the right wall at a drive phase; minus or plus infinity without a wall."""
    ends = []
    for side, wall in ((-1.0, scene.left), (1.0, scene.right)):
        if wall is None:
            ends.append(np.full(np.shape(phase), side * np.inf))
            continue
        swing = 0.0
        if wall.motion is not None:
            swing = wall.motion.amplitude * np.cos(wall.motion.harmonic * phase + wall.motion.phase)
        ends.append(np.asarray(wall.position + swing))
    return ends


def _spring(n, left, right, drive=()):
    return jv.make_scene(n["amplitude"], n["frequency"], n["damping"], 0.7, (left, right), drive=drive)


def _motion(n, side, harmonic):
    return jv.Motion(n[f"{side}_swing"] * n["gap"], n[f"{side}_phase"], harmonic)


def _rigid(n, side, harmonic=None):
    position = n["left"] if side == "left" else n["left"] + n["gap"]
    motion = None if harmonic is None else _motion(n, side, harmonic)
    return jv.Wall(position, n[f"{side}_restitution"], motion=motion)


def _soft(n, side, harmonic=None):
    """A soft wall: stiffness 1 to 1e4, the contact's damping up to critical."""
    position = n["left"] if side == "left" else n["left"] + n["gap"]
    motion = None if harmonic is None else _motion(n, side, harmonic)
    stiffness = 10.0 ** (4.0 * n["second"])
    damping = n[f"{side}_restitution"] * np.sqrt(1.0 + stiffness)
    return jv.Wall(position, stiffness=stiffness, damping=damping, motion=motion)


def one_wall(n):
    return _spring(n, _rigid(n, "left"), None)


def two_walls(n):
    return _spring(n, _rigid(n, "left"), _rigid(n, "right"))


def moving_walls(n):
    return _spring(n, _rigid(n, "left", 2), _rigid(n, "right", 1))


def drive_terms(n):
    return _spring(n, _rigid(n, "left"), _rigid(n, "right", 3), ((n["first"], 2, n["second"]), (0.5, 3, n["first"])))


def inelastic(n):
    """One wall with R = 0, at which the mass sticks."""
    return _spring(n, None, _rigid(n | {"right_restitution": 0.0 * n["gap"]}, "right"))


def undriven(n):
    return _spring(n | {"amplitude": 0.0 * n["gap"]}, _rigid(n, "left"), None)


def soft_wall(n):
    return _spring(n, None, _soft(n, "right"))


def soft_and_rigid(n):
    return _spring(n, _soft(n, "left"), _rigid(n, "right", 2))


def soft_moving(n):
    return _spring(n, _soft(n, "left", 1), _soft(n, "right", 2))


def _forced(n, force, left, right):
    return jv.make_scene(0.5 * n["amplitude"], n["frequency"], walls=(left, right), force=force)


def duffing(n):
    numbers = {"cubic": 2.0 * n["second"] - 0.2, "damping": n["damping"]}
    return _forced(n, jv.Force("duffing", numbers, 1e-12), _rigid(n, "left"), _rigid(n, "right", 1))


def gravity(n):
    """A mass without a spring above a floor."""
    force = jv.Force("polynomial", {"c0": 0.5 + n["second"], "damping": 0.5 * n["damping"]}, 1e-12)
    return _forced(n, force, _rigid(n, "left", 1), None)


def solver(n):
    """Duffing's spring by a solver of diffrax."""
    numbers = {"cubic": 2.0 * n["second"] - 0.2, "damping": n["damping"]}
    force = jv.Force("duffing", numbers, 1e-10, diffrax.Dopri8())
    return _forced(n, force, _rigid(n, "left"), _rigid(n, "right"))


def contact_law(n):
    """Two soft walls with a contact law, beside Duffing's spring."""
    law = jv.Push("hunt_crossley", {"stiffness": 10.0 ** (3.0 * n["second"]), "dissipation": n["left_restitution"]})
    force = jv.Force("duffing", {"cubic": n["first"], "damping": n["damping"]}, 1e-12)
    return _forced(n, force, jv.Wall(n["left"], law=law), jv.Wall(n["left"] + n["gap"], law=law))


KINDS = {
    kind.name: kind
    for kind in (
        Kind("one_wall", one_wall, truths.closed_form),
        Kind("two_walls", two_walls, truths.closed_form),
        Kind("moving_walls", moving_walls, truths.closed_form),
        Kind("drive_terms", drive_terms, truths.closed_form),
        Kind("inelastic", inelastic, truths.resting),
        Kind("undriven", undriven, truths.closed_form),
        Kind("soft_wall", soft_wall, truths.closed_form),
        Kind("soft_and_rigid", soft_and_rigid, truths.closed_form),
        Kind("soft_moving", soft_moving, truths.closed_form),
        Kind("duffing", duffing, truths.series, 1e-12, exact=False),
        Kind("gravity", gravity, truths.series, 1e-12, exact=False),
        Kind("solver", solver, truths.series, 1e-10, exact=False),
        Kind("contact_law", contact_law, truths.series, 1e-12, exact=False),
    )
}
