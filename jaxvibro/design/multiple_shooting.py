"""Compute a motion in short shots from node to node: states at the times of the samples, and their derivatives.

A node is a state (x, v) at the time of a sample. A shot and its derivative are computed as in `sample`, with all
impacts, contact phases and sticking phases. A shot is short. Chaos therefore does not amplify errors, whatever the
length of the motion.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..maps.sample import sample
from ..scene.scene import rigid_wall_positions
from ..scene.state import State
from .shape_padding import pad_to_power_of_two, scene_with_tangents

MIN_TIMES = 8  # smallest number of samples of a shot; more are padded to a power of two times this number
# A shot has this number of samples, if they are within a period, or this duration, whichever is longer.
MIN_SHOT_SAMPLES, MIN_SHOT_TIME = 4, 0.8


class Shots(NamedTuple):
    """Division of a record into shots.

    Attributes
    ----------
    times : numpy.ndarray
        Times of the samples of the record. Array of shape (record,).
    start_indices : numpy.ndarray
        Index of the sample at which each shot starts. Array of shape (shots,).
    n_samples : numpy.ndarray
        Number of samples of each shot after its start, up to the start of the next shot. Array of shape (shots,).
    """

    times: Float[np.ndarray, " record"]
    start_indices: Int[np.ndarray, " shots"]
    n_samples: Int[np.ndarray, " shots"]

    def first_shots(self, n_shots: int) -> "Shots":
        """Return the first `n_shots` shots."""
        return self._replace(start_indices=self.start_indices[:n_shots], n_samples=self.n_samples[:n_shots])

    def single_shot(self, shot_index: int) -> "Shots":
        """Return the `Shots` that consist of a single shot."""
        return self._replace(
            start_indices=self.start_indices[shot_index : shot_index + 1],
            n_samples=self.n_samples[shot_index : shot_index + 1],
        )

    @property
    def sample_indices(self) -> Int[np.ndarray, "shots times"]:
        """Indices in the record of the samples of each shot, padded with the last index of the shot."""
        sample_offsets = np.arange(1, 1 + max(1, int(np.max(self.n_samples))))
        return self.start_indices[:, None] + np.minimum(sample_offsets, self.n_samples[:, None])


def divide_into_shots(scene, start_phase, times, x) -> Shots:
    """Divide a record into `Shots`.

    A shot has at most `MIN_SHOT_SAMPLES` samples within a drive period, or the duration `MIN_SHOT_TIME` if this
    duration is longer. The shot ends in the second half of these samples, where the mass is farthest from the
    rigid walls.
    """
    clearances, record_end_index, period = (
        rigid_wall_clearances(scene, start_phase, times, x),
        len(times) - 1,
        2.0 * np.pi / float(scene.frequency),
    )
    start_indices = [0]
    while start_indices[-1] < record_end_index:
        start_index = start_indices[-1]
        min_time_end_index, period_end_index = (
            np.searchsorted(times, times[start_index] + np.array([MIN_SHOT_TIME, period]), "right") - 1
        )
        end_index = max(
            start_index + 1, int(min_time_end_index), min(start_index + MIN_SHOT_SAMPLES, int(period_end_index))
        )
        start_candidates = np.arange(
            start_index + (end_index - start_index + 1) // 2, min(end_index, record_end_index) + 1
        )
        start_indices.append(
            int(start_candidates[np.argmax(clearances[start_candidates])])
            if len(start_candidates)
            else record_end_index
        )
    return Shots(np.asarray(times), np.array(start_indices), np.diff(np.append(start_indices, record_end_index)))


def rigid_wall_clearances(scene, start_phase, times, x):
    """Return the distance of the mass from the nearest rigid wall at each time, inf if there is no rigid wall."""
    left_wall, right_wall = rigid_wall_positions(scene, start_phase + float(scene.frequency) * times)
    return np.minimum(x - left_wall, right_wall - x)


def simulate_shots(free_spec, shots, node_states, parameters):
    """Compute shots from states of shape (shots, 2), for values of the free parameters.

    Returns
    -------
    values : numpy.ndarray
        States (x, v) at the samples. Array of shape (shots, times, 2).
    derivatives : numpy.ndarray
        Derivatives of the states with respect to the state of the node and the free parameters in units of their
        scales. Array of shape (shots, times, 2, 2 + free).
    """
    parameter_names, start_phase = free_spec.separate_start_phase(parameters)
    changed_scene, scene_tangents = scene_with_tangents(
        free_spec.scene, parameter_names, parameters[: len(parameter_names)]
    )
    start_times, elapsed_times = _pad_start_times(shots.times[shots.start_indices], shots.times[shots.sample_indices])
    values, derivatives = (
        np.asarray(padded_result)
        for padded_result in _differentiate_shots(
            changed_scene,
            scene_tangents,
            pad_to_power_of_two(node_states),
            start_times,
            elapsed_times,
            float(start_phase),
        )
    )
    # The rows of the tangents that pad those of the parameters lie before the row of the phase.
    derivatives = np.concatenate([derivatives[:, : 2 + len(parameter_names)], derivatives[:, -1:]], 1)
    n_shots, n_times = shots.sample_indices.shape
    derivatives = np.moveaxis(derivatives[:n_shots, : 2 + len(parameters), :n_times], 1, -1)
    return values[:n_shots, :n_times], derivatives * np.append([1.0, 1.0], free_spec.scales)


def sample_motions(scenes, start_phases, start_states, start_times, times) -> Float[np.ndarray, "lanes times 2"]:
    """Return (x, v) of motions in scenes (lanes,) at times (lanes, times).

    `start_phases` are the phases of the drive at time 0. The motions start from `start_states`, (lanes, 2), at
    `start_times`, (lanes,)."""
    n_lanes = len(start_states)
    padded_scenes = jax.tree.map(lambda leaf: pad_to_power_of_two(np.broadcast_to(leaf, n_lanes)), scenes)
    start_times, elapsed_times = _pad_start_times(start_times, times)
    samples = _sample_motion_lanes(
        padded_scenes,
        pad_to_power_of_two(start_states),
        start_times,
        elapsed_times,
        pad_to_power_of_two(np.broadcast_to(start_phases, n_lanes)),
    )
    return np.asarray(samples)[:n_lanes, : times.shape[1]]


def _pad_start_times(start_times, times):
    """Return the start times and the times elapsed since the start, both padded."""
    return pad_to_power_of_two(start_times), pad_to_power_of_two(
        pad_to_power_of_two(times - start_times[:, None], MIN_TIMES, -1)
    )


def _sample_shot(scene, start_state, start_time, elapsed_times, phase_at_time_zero):
    state, _ = sample(
        scene, State(start_state[0], start_state[1], phase_at_time_zero + scene.frequency * start_time), elapsed_times
    )
    return jnp.stack([state.x, state.v], -1)


@persistent_jit(compiler_options=FAST_COMPILE)
def _differentiate_shots(scene, scene_tangents, node_states, start_times, elapsed_times, start_phase):
    """Return the states of all shots and their derivatives by the node, along the scene tangents, and by the phase."""
    n_tangents = len(jax.tree.leaves(scene_tangents)[0])
    tangent_basis = jnp.eye(2 + n_tangents + 1)
    tangents_with_zero_rows = jax.tree.map(lambda leaf: jnp.pad(leaf, (2, 1)), scene_tangents)

    def differentiate_shot(start_state, start_time, elapsed_times):
        def sample_states(scene, start_state, start_phase):
            return _sample_shot(scene, start_state, start_time, elapsed_times, start_phase)

        def states_and_derivative(state_tangent, scene_tangent, phase_tangent):
            return jax.jvp(
                sample_states, (scene, start_state, start_phase), (scene_tangent, state_tangent, phase_tangent)
            )

        return jax.vmap(states_and_derivative, out_axes=(None, 0))(
            tangent_basis[:, :2], tangents_with_zero_rows, tangent_basis[:, -1]
        )

    return jax.vmap(differentiate_shot)(node_states, start_times, elapsed_times)


@persistent_jit(compiler_options=FAST_COMPILE)
def _sample_motion_lanes(scenes, start_states, start_times, elapsed_times, start_phases):
    return jax.vmap(_sample_shot)(scenes, start_states, start_times, elapsed_times, start_phases)
