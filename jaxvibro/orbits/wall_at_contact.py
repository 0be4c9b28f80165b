"""The walls where the mass meets them, for the equations of the impacts."""

from ..flight.flows import flow_of
from ..flight.wall_motion import select_lists_by_side, wall_jet_on_side


def wall_derivatives(coeffs, sides, cosine, sine, order=2):
    """Position, velocity and further derivatives of the walls on these sides, arrays of their shape."""
    derivatives = wall_jet_on_side(coeffs, sides, cosine, sine, order)
    return [0.0 * sides if derivative is None else derivative + 0.0 * sides for derivative in derivatives]


def contact_force_derivatives(coeffs, sides, phasor, order=1):
    """How hard a mass that rests on the walls on these sides is driven along x relative to them, and its derivatives
    up to an order."""
    wall_forces = [flow_of(coeffs).contact_force(coeffs, wall, *phasor, order)[: order + 1] for wall in coeffs.walls]
    return select_lists_by_side(sides, coeffs.walls, wall_forces)
