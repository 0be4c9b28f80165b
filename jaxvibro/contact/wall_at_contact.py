"""Motion of the walls and contact forces at impacts, for the equations of the impacts."""

from ..flight.wall_motion import select_lists_by_side, wall_jet_on_side


def wall_derivatives(coeffs, sides, cosine, sine, order=2):
    """Compute position, velocity and further derivatives of the walls at impacts.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sides : Array
        Sides of the impacts.
    cosine, sine : Array
        Cosine and sine of the drive's phase.
    order : int, optional
        Order of the highest derivative.

    Returns
    -------
    list of Array
        Derivatives of order 0, 1, ..., of the shape of `sides`.
    """
    derivatives = wall_jet_on_side(coeffs, sides, cosine, sine, order)
    return [0.0 * sides if derivative is None else derivative + 0.0 * sides for derivative in derivatives]


def contact_force_derivatives(coeffs, sides, phasor, order=1):
    """Return the force along x on a sticking mass in the frame of the wall, with time derivatives up to an order."""
    force_derivs_by_wall = [
        coeffs.flow.contact_force(coeffs, wall, *phasor, order)[: order + 1] for wall in coeffs.walls
    ]
    return select_lists_by_side(sides, coeffs.walls, force_derivs_by_wall)
