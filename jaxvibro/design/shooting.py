"""Compute a motion in short shots from node to node: states at given times, and their derivatives.

A node is a state (x, v) at one of the times. A shot is computed as in `sample`, with all impacts, contact phases and
sticking phases, and so is its derivative. It is short, so that chaos does not amplify errors, whatever the length of
the motion.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..maps.sample import sample
from ..scene.state import State
from .next_impact import make_wall_motion, wall_state
from .shape_padding import pad_to_power_of_two, scene_with_tangents

MIN_TIMES = 8  # smallest number of samples of a shot; more are padded to a power of two times this number
# A shot has this number of samples, if they are within a period, or this duration, whichever is longer.
MIN_SHOT_SAMPLES, MIN_SHOT_TIME = 4, 0.8


class Shots(NamedTuple):
    """Shots of a record: its `times`, the index of the start of each shot, and the number of samples of each.

    The samples of a shot include that of the next node.
    """

    times: Float[np.ndarray, " record"]
    start_indices: Int[np.ndarray, " shots"]
    n_samples: Int[np.ndarray, " shots"]

    def first_shots(self, n_shots: int) -> "Shots":
        """Return the first shots."""
        return self._replace(start_indices=self.start_indices[:n_shots], n_samples=self.n_samples[:n_shots])

    def single_shot(self, shot_index: int) -> "Shots":
        """Return a single shot."""
        return self._replace(
            start_indices=self.start_indices[shot_index : shot_index + 1],
            n_samples=self.n_samples[shot_index : shot_index + 1],
        )

    @property
    def sample_indices(self) -> Int[np.ndarray, "shots times"]:
        """Indices in the record of the samples of each shot, padded with its last."""
        sample_offsets = np.arange(1, 1 + max(1, int(np.max(self.n_samples))))
        return self.start_indices[:, None] + np.minimum(sample_offsets, self.n_samples[:, None])


class ShotResults(NamedTuple):
    """States (x, v) at the samples, and their derivatives in the node, the free parameters and the phase."""

    values: Float[np.ndarray, "shots times 2"]
    derivatives: Float[np.ndarray, "shots times 2 columns"]


def lay_out_shots(scene, phase, times, x) -> Shots:
    """Lay out the `Shots` of a record.

    Each has as few samples, or is as short, as possible. It starts where the mass is farther from the walls than at the
    neighbouring samples.
    """
    clearance, last_index, period = (
        wall_clearances(scene, phase, times, x),
        len(times) - 1,
        2.0 * np.pi / float(scene.frequency),
    )
    start_indices = [0]
    while start_indices[-1] < last_index:
        start_index = start_indices[-1]
        short_end, period_end = (
            np.searchsorted(times, times[start_index] + np.array([MIN_SHOT_TIME, period]), "right") - 1
        )
        end_index = max(start_index + 1, int(short_end), min(start_index + MIN_SHOT_SAMPLES, int(period_end)))
        candidates = np.arange(start_index + (end_index - start_index + 1) // 2, min(end_index, last_index) + 1)
        start_indices.append(int(candidates[np.argmax(clearance[candidates])]) if len(candidates) else last_index)
    return Shots(np.asarray(times), np.array(start_indices), np.diff(np.append(start_indices, last_index)))


def wall_clearances(scene, phase, times, x):
    """Return the distance of the mass from the nearest rigid wall, inf if there is none."""
    min_clearance = np.full(np.shape(x), np.inf)
    for side, wall in scene.walls.items():
        if not wall.soft:
            wall_motion = make_wall_motion(scene, side, phase)
            min_clearance = np.minimum(min_clearance, wall_motion.sign * (wall_state(wall_motion, times)[0] - x))
    return min_clearance


def fly_shots(scene, names, shots, states, parameters, phase) -> ShotResults:
    """Return the `ShotResults` of shots from states (shots, 2) in a scene with changed parameters."""
    changed_scene, tangents = scene_with_tangents(scene, names, parameters)
    start_times, elapsed_times = _pad_times(shots.times[shots.start_indices], shots.times[shots.sample_indices])
    values, derivatives = (
        np.asarray(array)
        for array in _differentiate_shots(
            changed_scene, tangents, pad_to_power_of_two(states), start_times, elapsed_times, float(phase)
        )
    )
    derivatives = np.concatenate([derivatives[:, : 2 + len(names)], derivatives[:, -1:]], 1)
    n_shots, n_times = shots.sample_indices.shape
    return ShotResults(values[:n_shots, :n_times], np.moveaxis(derivatives[:n_shots, :, :n_times], 1, -1))


def sample_motions(scenes, phases, states, start_times, times) -> Float[np.ndarray, "lanes times 2"]:
    """Return (x, v) of motions in scenes (lanes,) at times (lanes, times).

    `phases` are those of the drive at time 0. The motions start from states (lanes, 2) at `start_times` (lanes,).
    """
    n_lanes = len(states)
    padded_scenes = jax.tree.map(lambda leaf: pad_to_power_of_two(np.broadcast_to(leaf, n_lanes)), scenes)
    start_times, elapsed_times = _pad_times(start_times, times)
    samples = _sample_lanes(
        padded_scenes,
        pad_to_power_of_two(states),
        start_times,
        elapsed_times,
        pad_to_power_of_two(np.broadcast_to(phases, n_lanes)),
    )
    return np.asarray(samples)[:n_lanes, : times.shape[1]]


def _pad_times(start_times, times):
    """Return the start times and the times since them, padded."""
    return pad_to_power_of_two(start_times), pad_to_power_of_two(
        pad_to_power_of_two(times - start_times[:, None], MIN_TIMES, -1)
    )


def _fly_shot(scene, start_state, start_time, elapsed_times, phase):
    state, _ = sample(scene, State(start_state[0], start_state[1], phase + scene.frequency * start_time), elapsed_times)
    return jnp.stack([state.x, state.v], -1)


@persistent_jit(compiler_options=FAST_COMPILE)
def _differentiate_shots(scene, tangents, states, start_times, elapsed_times, phase):
    """Return states and their derivatives in the node, along the scene tangents and in the phase, for all shots."""
    n_tangents = len(jax.tree.leaves(tangents)[0])
    identity = jnp.eye(2 + n_tangents + 1)
    scene_tangents = jax.tree.map(lambda leaf: jnp.pad(leaf, (2, 1)), tangents)

    def differentiate_shot(start_state, start_time, elapsed_times):
        def end_states(scene, start_state, phase):
            return _fly_shot(scene, start_state, start_time, elapsed_times, phase)

        def derivative_along(state_tangent, scene_tangent, phase_tangent):
            return jax.jvp(end_states, (scene, start_state, phase), (scene_tangent, state_tangent, phase_tangent))

        return jax.vmap(derivative_along, out_axes=(None, 0))(identity[:, :2], scene_tangents, identity[:, -1])

    return jax.vmap(differentiate_shot)(states, start_times, elapsed_times)


@persistent_jit(compiler_options=FAST_COMPILE)
def _sample_lanes(scenes, states, start_times, elapsed_times, phases):
    return jax.vmap(_fly_shot)(scenes, states, start_times, elapsed_times, phases)
