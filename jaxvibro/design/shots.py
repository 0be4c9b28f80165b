"""A motion in short shots, each from a node to the next: where they pass at given times, and how that changes.

A node is a state (x, v) at one of the times. A shot is flown as in `sample`, with all the impacts, stays and rests on
its way; so is its derivative. As it is short, it is far from chaotic, however long the motion.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.persistent_jit import SOON, persistent_jit

from ..maps.sample import sample
from ..scene.state import State
from .few_programs import filled, with_ways
from .first_return import course, wall_of

LEAST_TIMES = 8  # of a shot: more are filled up to a power of two
FEWEST, SPAN = 4, 0.8  # times that a shot passes, within a period, or how long it is, whichever is more


class Shots(NamedTuple):
    """times: of the record; node: the place in it of each shot's start; length: how many times a shot passes, the next
    node's with them."""

    times: Float[np.ndarray, " record"]
    node: Int[np.ndarray, " shots"]
    length: Int[np.ndarray, " shots"]

    def first(self, count: int) -> "Shots":
        """Those of the first nodes."""
        return self._replace(node=self.node[:count], length=self.length[:count])

    def at(self, count: int) -> "Shots":
        """One of them."""
        return self._replace(node=self.node[count : count + 1], length=self.length[count : count + 1])

    @property
    def passed(self) -> Int[np.ndarray, "shots times"]:
        """The places in the record that shots pass, each filled up with its last."""
        after = np.arange(1, 1 + max(1, int(np.max(self.length))))
        return self.node[:, None] + np.minimum(after, self.length[:, None])


class Flown(NamedTuple):
    """values: (x, v) at the times passed; by: its derivatives by the node's x and v, by the free numbers and by the
    phase, last."""

    values: Float[np.ndarray, "shots times 2"]
    by: Float[np.ndarray, "shots times 2 columns"]


def laid(scene, phase, times, x) -> Shots:
    """The `Shots` of a record: each of as few times, or as short, as may be, and begun where the mass is farther from
    the walls than at the times about."""
    clear, last, period = clearances(scene, phase, times, x), len(times) - 1, 2.0 * np.pi / float(scene.frequency)
    node = [0]
    while node[-1] < last:
        begin = node[-1]
        short, within = np.searchsorted(times, times[begin] + np.array([SPAN, period]), "right") - 1
        end = max(begin + 1, int(short), min(begin + FEWEST, int(within)))
        able = np.arange(begin + (end - begin + 1) // 2, min(end, last) + 1)
        node.append(int(able[np.argmax(clear[able])]) if len(able) else last)
    return Shots(np.asarray(times), np.array(node), np.diff(np.append(node, last)))


def clearances(scene, phase, times, x):
    """How far from the nearest rigid wall a mass is, inf where there is none."""
    least = np.full(np.shape(x), np.inf)
    for side, wall in scene.walls.items():
        if not wall.soft:
            one = wall_of(scene, side, phase)
            least = np.minimum(least, one.sign * (course(one, times)[0] - x))
    return least


def flown(scene, names, shots, states, numbers, phase) -> Flown:
    """The `Flown` of shots from states (shots, 2), in a scene whose numbers of these names are others."""
    there, ways = with_ways(scene, names, numbers)
    begin, since = _since(shots.times[shots.node], shots.times[shots.passed])
    values, by = (np.asarray(one) for one in _flown(there, ways, filled(states), begin, since, float(phase)))
    by = np.concatenate([by[:, : 2 + len(names)], by[:, -1:]], 1)
    rows, count = shots.passed.shape
    return Flown(values[:rows, :count], np.moveaxis(by[:rows, :, :count], 1, -1))


def passed(scenes, phases, states, begin, times) -> Float[np.ndarray, "lanes times 2"]:
    """(x, v) of motions in scenes (lanes,) with the drive's phases at time 0, from states (lanes, 2) at their
    beginnings (lanes,), at times (lanes, times) from there on."""
    lanes = len(states)
    there = jax.tree.map(lambda leaf: filled(np.broadcast_to(leaf, lanes)), scenes)
    begin, since = _since(begin, times)
    found = _passed(there, filled(states), begin, since, filled(np.broadcast_to(phases, lanes)))
    return np.asarray(found)[:lanes, : times.shape[1]]


def _since(begin, times):
    """(beginnings, times since them), filled up."""
    return filled(begin), filled(filled(times - begin[:, None], LEAST_TIMES, -1))


def _shot(scene, first, begin, since, phase):
    state, _ = sample(scene, State(first[0], first[1], phase + scene.frequency * begin), since)
    return jnp.stack([state.x, state.v], -1)


@persistent_jit(compiler_options=SOON)
def _flown(scene, ways, states, begin, since, phase):
    """(values, derivatives by the node's unknowns, along the ways of the scene and by the phase) of all shots."""
    count = len(jax.tree.leaves(ways)[0])
    eye = jnp.eye(2 + count + 1)
    by_scene = jax.tree.map(lambda leaf: jnp.pad(leaf, (2, 1)), ways)

    def one(first, begin, since):
        def end(scene, first, phase):
            return _shot(scene, first, begin, since, phase)

        def along(by_first, by_scene, by_phase):
            return jax.jvp(end, (scene, first, phase), (by_scene, by_first, by_phase))

        return jax.vmap(along, out_axes=(None, 0))(eye[:, :2], by_scene, eye[:, -1])

    return jax.vmap(one)(states, begin, since)


@persistent_jit(compiler_options=SOON)
def _passed(scenes, states, begin, since, phases):
    return jax.vmap(_shot)(scenes, states, begin, since, phases)
