"""Choose the flow and the contacts of a scene: the one registry of both.

A new kind of flow, or of contact, is a module with all functions of `protocols.Flow` or `protocols.Contact`, and one
entry here.
"""

from itertools import product

import jax
import jax.numpy as jnp

from ..flight import force_flow, linear_flow
from ..flight.protocols import Contact, Flow, Kinds
from ..scene import check
from ..scene.force import Force
from ..scene.push import Push
from ..scene.scene import LINEAR_CONTACT, RIGID_CONTACT
from . import force_law, force_spring, linear, rigid

FLOWS: dict[type, Flow] = {type(None): linear_flow, Force: force_flow}  # by the class of the force
# by the kind of a wall without a law, or the class of its law, and by the flow, None for any flow
CONTACTS: dict[tuple[object, Flow | None], Contact] = {
    (RIGID_CONTACT, None): rigid,
    (LINEAR_CONTACT, linear_flow): linear,
    (LINEAR_CONTACT, force_flow): force_spring,
    (Push, force_flow): force_law,
}


def flow_of_scene(scene):
    """Return the `Flow` of a scene."""
    return next(FLOWS[base] for base in type(scene.force).__mro__ if base in FLOWS)


def contact_of_wall(scene, side):
    """Return the `Contact` of the wall on a side of a scene. Raises SceneError if there is none for the flow."""
    wall, flow = getattr(scene, side), flow_of_scene(scene)
    kinds_of_wall = wall.contact_kind, *type(wall.law).__mro__
    for key in product(kinds_of_wall, (flow, None)):
        if key in CONTACTS:
            return CONTACTS[key]
    raise check.SceneError(
        side, f"must be a wall with a contact for {flow.__name__.rpartition('.')[2]}", wall.contact_kind.name
    )


def kinds_of_scene(scene):
    """Return the `Kinds` of a scene.

    Raises
    ------
    SceneError
        If the contact phases at the two walls have different kinds.
    """
    wall_contacts = tuple(contact_of_wall(scene, side) for side in scene.walls)
    soft_contacts = [contact for contact in wall_contacts if contact is not rigid]
    if len({contact.advance_waiting_lanes for contact in soft_contacts}) > 1:
        names = ", ".join(contact.__name__ for contact in soft_contacts)
        raise check.SceneError("walls", "must have contact phases of one kind", names)
    return Kinds(flow_of_scene(scene), next(iter(soft_contacts), rigid), wall_contacts)


def make_flow_coefficients(scene):
    """Compute the coefficients of the flight from a scene.

    Parameters
    ----------
    scene : Scene
        Scene with parameters that are scalars or lanes.

    Returns
    -------
    FlowCoefficients
        Coefficients in the floating-point type of the scene.

    Raises
    ------
    SceneError
        If the law of a soft wall has no Taylor series, or is not a power series in the root of the depth.

    See Also
    --------
    check_validity : Check the rules for a scene inside traced code.
    """
    kinds = kinds_of_scene(scene)
    return kinds.flow.make_coefficients(scene, kinds)


# for code that is traced repeatedly for few lanes: traced once per process and kind of scene
flow_coefficients = jax.jit(make_flow_coefficients)


def fly_with_matrix(scene, x, v, phase, time):
    """Compute the final state of a flight without walls and the matrix of the flight.

    Parameters
    ----------
    scene : Scene
        Scene.
    x : array
        Initial position.
    v : array
        Initial velocity.
    phase : array
        Initial phase of the drive, in rad.
    time : array
        Duration of the flight, at least 0, in units of t.

    Returns
    -------
    state : tuple of array
        Final position and velocity.
    matrix : tuple of array
        Derivative of the final state with respect to the initial state, see `flow_matrix.apply_matrix`.
    """
    coeffs = flow_coefficients(scene)
    return coeffs.flow.fly_with_matrix(coeffs, x, v, jnp.cos(phase), jnp.sin(phase), time)
