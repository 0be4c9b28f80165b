"""Interfaces of a flow and of a contact, which the modules of each kind implement.

A flow moves the mass between the walls. A contact acts at a wall and, inside a soft wall, on the motion. Each kind is a
module with the functions of `Flow` or `Contact`, without `self`. `contact.kinds` is the registry of all kinds. The
coefficients of a scene contain the choice as static data, so that no choice is made when a program runs.

Arguments with one meaning in all functions:

- `coeffs`: coefficients of the scene (`flight_coefficients.FlowCoefficients`), in a step those of each lane;
- `path`: the `flight_state.Path` of the lanes; `motion`: its `flight_state.SlowMotion`;
- `cosine`, `sine`: phasor of the drive; `side`: sign of the wall of each lane;
- `frame_force`: force in addition to the drive, and its derivatives, for lanes whose x is relative to a moving wall;
- `expansion_point`, `current_state`: a `taylor_polynomials.ExpansionPoint`; `delay`: a time that is 0 and has
  derivatives up to `order`;
- `wall`: the `wall_motion.WallCoefficients` of a wall.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax


@runtime_checkable
class Flow(Protocol):
    """Motion of the mass between the walls."""

    def make_coefficients(self, scene: Any, kinds: "Kinds") -> Any:
        """Return the `FlowCoefficients` of a scene, see `flight_coefficients.common_fields`."""

    def steady_amplitude(self, scene: Any, amplitude: Any, frequency: Any) -> Any:
        """Return the amplitude of the steady motion without walls under one term of the drive."""

    def rates(self, scene: Any) -> list[float]:
        """Return the rates of oscillation and decay of the motion between the walls of a single scene."""

    def loses_energy(self, scene: Any) -> bool:
        """Return True if a flight of a single scene, or a contact phase, loses energy."""

    def areas_may_grow(self) -> bool:
        """Return True if areas of states may grow between the walls, also if every damping is positive."""

    def has_unique_free_response(self) -> bool:
        """Return True if one orbit without impacts exists, which the first step of Newton's method finds."""

    def require_reversible(self, scene: Any) -> None:
        """Raise an error if the flow of a scene cannot be reversed in time."""

    def reverse_time(self, coeffs: Any) -> Any:
        """Return the coefficients of the flow with time reversed."""

    # a certified step
    def prepare_lookahead(self, coeffs: Any, path: Any) -> tuple[Any, Any]:
        """Return (coefficients with the longest step of each lane, lookahead: an object of the flow)."""

    def motion_derivatives(self, coeffs: Any, path: Any, lookahead: Any, frame_force: Any) -> list[Any]:
        """Return x and its derivatives up to order `event_certificates.N_TERMS`."""

    def forces_and_remainder(self, lookahead: Any) -> Any:
        """Return the part of the lookahead that the polynomial of an event needs."""

    def contact_forces_ahead(self, coeffs: Any, path: Any, forces_and_remainder: Any) -> list[tuple[Any, Any]]:
        """Return [(force on a sticking mass and its derivatives, bound on the remainder)] for each wall."""

    def remainder_bound(
        self,
        coeffs: Any,
        derivatives: Any,
        forces_and_remainder: Any,
        is_sticking: Any,
        contact_remainder_bound: Any,
        wall_remainder_bound: Any,
        taylor_weights: Any,
    ) -> Any:
        """Return the bound on the remainder of an event's polynomial, for free and for sticking lanes."""

    def advance_motion(self, coeffs: Any, motion: Any, time: Any, lookahead: Any) -> Any:
        """Return the motion after a step."""

    def propagate_motion(self, coeffs: Any, motion: Any, time: Any) -> Any:
        """Return the motion after a time of at most one step, without a lookahead."""

    # a point of a motion
    def acceleration_and_jerk(
        self, coeffs: Any, x: Any, v: Any, cosine: Any, sine: Any, frame_force: Any = (None, None)
    ) -> Any:
        """Return acceleration and jerk of a mass that does not stick to a wall."""

    def jet(self, coeffs: Any, x: Any, v: Any, cosine: Any, sine: Any, order: int, frame_force: Any = ()) -> list[Any]:
        """Return x and its derivatives, at least up to an order."""

    def contact_force(self, coeffs: Any, wall: Any, cosine: Any, sine: Any, order: int) -> list[Any]:
        """Return the force along x on a sticking mass relative to the wall, and its derivatives."""

    def chatter_bounds(
        self, coeffs: Any, side: Any, acceleration: Any, approach_speed: Any, cosine: Any, sine: Any
    ) -> tuple[Any, Any, Any]:
        """Return bounds on the rate of the contact force, on the damping and on the force gradient of chatter."""

    def jet_at_point(self, coeffs: Any, expansion_point: Any, order: int, frame_force: Any = ()) -> list[Any]:
        """Return x and its derivatives up to order + 1 at a point of a replay."""

    def state_before_delay(
        self, coeffs: Any, expansion_point: Any, x: Any, v: Any, delay: Any, order: int, frame_force: Any = ()
    ) -> tuple[Any, Any]:
        """Return (x, v) at a point of a flight that reaches x, v after a delay."""

    # flights of any duration
    def fly(self, coeffs: Any, x: Any, v: Any, cosine: Any, sine: Any, time: Any) -> tuple[Any, Any, Any, Any]:
        """Return (x, v, cosine, sine) after any time >= 0."""

    def fly_with_matrix(self, coeffs: Any, x: Any, v: Any, cosine: Any, sine: Any, time: Any) -> tuple[Any, Any]:
        """Return ((x, v) after a time, matrix of the flight as in `flow_matrix.apply_matrix`)."""

    def matrix_state(self, x: Any, v: Any) -> tuple[Any, ...]:
        """Return the state on which the matrix of a flight depends: (x, v), or () for a linear flow."""

    def propagate_with_matrix(self, coeffs: Any, state: Any, cosine: Any, sine: Any, time: Any) -> Any:
        """Return (`matrix_state`, cosine, sine, matrix of the flow by rows) after a time."""

    def flight_map(self, coeffs: Any, duration: Any) -> Any:
        """Return the map of (x, v, cosine, sine) over a fixed duration."""

    def sampling_time_scale(self, coeffs: Any, flights: Any) -> Any:
        """Return a time, a scalar, in which a flight turns at most once."""


@runtime_checkable
class Contact(Protocol):
    """Effect of a wall: impacts on a rigid wall, or the contact phases inside a soft wall.

    The functions of a wall belong to one wall. The other functions belong to the scene, of which at most one kind of
    contact has contact phases.
    """

    CODE_AFTER_IMPACT: int

    # a wall
    def wall_fields(self, scene: Any, side: str, as_array: Any) -> dict[str, Any]:
        """Return the fields of `WallCoefficients` that describe the contact: restitution None for a soft wall."""

    def wall_flow(
        self, wall: Any, amplitude: Any, frequency: Any, drive_terms: Any, is_any_soft_wall_moving: bool
    ) -> Any:
        """Return the entry of `FlowCoefficients.soft_flows`, None for a rigid wall."""

    def is_valid_wall(self, wall: Any) -> Any:
        """Return True in lanes where the parameters of the contact are valid."""

    def start_at_wall(self, coeffs: Any, wall: Any, wall_state: Any, path: Any, contact_on_wall: Any) -> Any:
        """Apply the rules for a start at a wall: return (path, mask of the lanes with an admissible start)."""

    def rates(self, scene: Any, side: str) -> list[float]:
        """Return the known rates of oscillation and decay of the motion inside the wall of a single scene."""

    def is_linear(self) -> bool:
        """Return True if the motion inside a soft wall is linear."""

    def require_reversible(self, scene: Any, side: str) -> None:
        """Raise an error if the contact cannot be reversed in time."""

    def reverse_wall(self, wall: Any) -> Any:
        """Return the wall with time reversed, except for its motion."""

    def reverse_wall_flow(self, coeffs: Any, wall: Any, wall_flow: Any) -> Any:
        """Return the entry of `soft_flows` with time reversed, of coefficients and a wall with time reversed."""

    def wall_force(self, scene: Any, side: str, depth: Any, depth_rate: Any, v: Any) -> Any:
        """Return the force of a soft wall against the mass, for NumPy arrays of shape (lanes, points)."""

    def grazing_exponent(self, wall: Any) -> float:
        """Return the exponent of the depth in the change of motion by a contact, for the `Wall` of a single scene."""

    # a certified step
    def inside_mask(self, contact: Any) -> Any:
        """Return the mask of the lanes inside a soft wall, None if the scene has no soft wall."""

    def prepare_step(self, coeffs: Any, path: Any) -> tuple[Any, Any, Any]:
        """Return (coefficients of each lane, path, additional force and its derivatives)."""

    def path_of_stepping_lanes(self, path: Any) -> Any:
        """Return the path, on which lanes that wait have no remaining time."""

    def target_wall(
        self,
        coeffs: Any,
        contact_on_side: Any,
        side: Any,
        wall_derivs: Any,
        is_leaving: Any,
        wall_remainder_bound: Any,
    ) -> Any:
        """Return the description of the wall that a lane moves towards, see `contact.rigid.target_wall`."""

    def frame_force(self, coeffs: Any, path: Any) -> Any:
        """Return the additional force and its time derivative; None stands for zero."""

    def advance_motion(self, coeffs: Any, path: Any, time: Any, lookahead: Any) -> Any:
        """Return the motion of a path after a step."""

    def max_step(self, coeffs: Any) -> Any:
        """Return the longest step, including steps inside walls."""

    def initial_waiting_steps(self, zeros: Any) -> Any:
        """Return the initial number of waiting steps of each lane, None for rigid walls."""

    def advance_waiting_lanes(
        self, coeffs: Any, path: Any, n_waiting_steps: Any, is_any_lane_due: Any, is_loop_idle: Any
    ) -> tuple[Any, Any]:
        """Return (path, number of waiting steps) after the lanes that wait inside a wall have advanced."""

    # replay, matrix and duration of contact phases
    def replay_initial_contact(
        self, coeffs: Any, current_state: Any, start_contact_code: Any, path_end: Any, order: int
    ) -> tuple[Any, Any]:
        """Return (state, pending contact) for an initial state with a contact code."""

    def complete_pending_contact(
        self, coeffs: Any, current_state: Any, pending_contact: Any, path_end: Any, order: int
    ) -> Any:
        """Return the state at the end of a pending contact phase."""

    def replay_wall_entry(
        self, coeffs: Any, current_state: Any, side: Any, entry_delay: Any, path_end: Any, order: int
    ) -> tuple[Any, Any]:
        """Return (state, pending contact) of lanes that hit a wall after a delay; side 0 means none."""

    def state_after_delay(
        self, coeffs: Any, current_state: Any, contact_code: Any, free_flight_state: Any, delay: Any, order: int
    ) -> tuple[Any, Any]:
        """Return (x, v) after a delay; `free_flight_state` is the result for lanes outside soft walls."""

    def initial_phase(
        self, coeffs: Any, current_state: Any, start_contact_code: Any, order: int = 1
    ) -> tuple[Any, ...]:
        """Return (contact code, displacement, velocity) relative to the wall at the start, () for rigid walls."""

    def propagate_contact_phase(
        self, coeffs: Any, relative_state: Any, is_entry_from_outside: Any, path_end: Any, current_state: Any
    ) -> Any:
        """Return the `contact.monodromy_state.MonodromyState` after the contact phase of lanes inside a wall."""

    def contact_duration(
        self,
        coeffs: Any,
        contact_code: Any,
        relative_displacement: Any,
        relative_velocity: Any,
        drive_cosine: Any,
        drive_sine: Any,
        max_duration: Any,
    ) -> Any:
        """Return the time after which lanes inside a wall leave it, without derivatives."""

    # equations and clearances of orbits; `contact_map` is the `orbits.contact_maps.ContactMap` of the impacts
    def complete_contact_map(
        self, coeffs: Any, sides: Any, speed: Any, contact_map: Any, grazing_mask: Any, min_contact_time: Any
    ) -> Any:
        """Return the contact map of impacts including the contact phases."""

    def saltation(
        self, coeffs: Any, sides: Any, contact_map: Any, shear: Any, acceleration_before: Any, acceleration_after: Any
    ) -> tuple[Any, Any]:
        """Return (matrix by rows, determinant) of impacts and contact phases; `shear` belongs to rigid walls."""

    def state_in_contact(
        self, coeffs: Any, contact_map: Any, sides: Any, row_indices: Any, elapsed_time: Any, free_state: Any
    ) -> tuple[Any, Any]:
        """Return (x, v) some time after impacts, or `free_state` outside contact phases."""

    def max_oscillation_rate(self, coeffs: Any, contact_map: Any, sides: Any) -> Any:
        """Return the largest oscillation rate inside soft walls, a scalar."""

    def max_contact_step(self, coeffs: Any, contact_map: Any, sides: Any) -> Any:
        """Return the longest step inside contact phases, a scalar."""


@jax.tree_util.register_static
@dataclass(frozen=True)
class Kinds:
    """Flow and contacts of a scene, static data of its coefficients.

    Attributes
    ----------
    flow : Flow
        Flow between the walls.
    contact : Contact
        Contact of the scene: the kind with contact phases, or `contact.rigid` if all walls are rigid.
    wall_contacts : tuple of Contact
        Contact of each wall, left wall first.
    """

    flow: Flow
    contact: Contact
    wall_contacts: tuple[Contact, ...]
