"""Define the result of `margin`: the nearest bifurcations of an orbit."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..orbits.orbit import Orbit
from ..output.table_text import align_columns, column_header
from ..output.units import unit_in_system, unit_of
from ..scene.scene import Scene

REACHED, BEHIND = "reached", "behind another"


@dataclass(frozen=True, eq=False)
class NearPoint:
    """Bifurcation near a scene.

    Attributes
    ----------
    kind : {"SN", "PD", "SB", "GR"}
        Kind of the bifurcation.
    distance : float
        Distance from the scene, in units of the free parameters.
    change : dict of str to float
        Change of each free parameter.
    direction : dict of str to float
        Unit vector that points to the bifurcation, in units of the free parameters.
    scene : Scene
        Scene at the bifurcation.
    times : numpy.ndarray
        Times of the impacts of the orbit; at an SB, of the impacts of one half of the orbit. Array of shape (impacts,).
    speeds : numpy.ndarray
        Speeds before these impacts. Array of shape (impacts,).
    sides : tuple of int
        Side of each of these impacts, -1 left, 1 right.
    residual : float
        Largest residual of the equations.
    slope : float
        Largest derivative of the distance perpendicular to the direction, or at an edge the residual of the optimality
        condition; 0 at a minimum.
    status : {"reached", "behind another"}
        ``"reached"`` if the orbit was continued along the straight path to the point without another bifurcation.
        ``"behind another"`` if another bifurcation lies on this path.
    at_bound : tuple of str
        Names of the free parameters that are at a bound.
    edge : {"", "a touch", "an impact without speed", "a cusp"}
        Condition that ends the boundary at the point, or an empty string if the boundary does not end there.

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8).points[0]
    >>> near.kind, round(near.distance, 4), near.status
    ('SB', 5.6116, 'reached')
    """

    kind: str
    distance: float
    change: dict[str, float]
    direction: dict[str, float]
    scene: Scene = field(repr=False)
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: tuple[int, ...]
    residual: float
    slope: float
    status: str
    at_bound: tuple[str, ...]
    edge: str = ""


@dataclass(frozen=True, eq=False)
class Margin:
    """Bifurcations near an orbit.

    Made by `margin`.

    Attributes
    ----------
    orbit : Orbit
        Orbit at the centre.
    free : dict of str to float
        Unit of each free parameter.
    points : tuple of NearPoint
        Nearest bifurcation of each kind with the status ``"reached"``, sorted by distance. If a kind has no such
        bifurcation, the nearest one behind another.
    others : tuple of NearPoint
        Further bifurcations, including those behind another.
    searched : tuple
        Distance in units up to which the orbit was continued, and the number of directions.
    stopped : str
        Reason why the search is incomplete, or an empty string. A nearer bifurcation may then be missing.

    Examples
    --------
    >>> near = jv.margin(orbit, {"amplitude": 0.1, "frequency": 0.1}, directions=8)
    >>> round(near.distance, 4), near.searched
    (5.6116, (16.0, 8))
    """

    orbit: Orbit
    free: dict[str, float]
    points: tuple[NearPoint, ...]
    others: tuple[NearPoint, ...]
    searched: tuple[float, int]
    stopped: str = ""

    @property
    def distance(self) -> float:
        """Distance to the nearest bifurcation, in units of the free parameters; infinite if there is none."""
        return self.points[0].distance if self.points else np.inf

    def table(self, units: str = "scene") -> str:
        """Format the nearest bifurcations as text.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the values. Physical units (Hz, N, mm) require a scene with scales.

        Returns
        -------
        str
            Table with one line per bifurcation, followed by the units and the extent of the search.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or if physical units are requested of a scene without scales.
        """
        column_units = {name: unit_in_system(self.orbit.scene, unit_of(name), units) for name in self.free}

        def format_parameters(scene):
            return (f"{unit_size * float(scene.parameter(name)):.9g}" for name, (_, unit_size) in column_units.items())

        rows = [
            (
                "kind",
                "distance",
                *(column_header(name, unit, units) for name, (unit, _) in column_units.items()),
                "status",
            )
        ]
        for near_point in self.points:
            status = near_point.status + (
                f", at a bound of {', '.join(near_point.at_bound)}" if near_point.at_bound else ""
            )
            status += f", ends there in {near_point.edge}" if near_point.edge else ""
            rows.append((near_point.kind, f"{near_point.distance:.9g}", *format_parameters(near_point.scene), status))
        rows.append((self.orbit.label, "0", *format_parameters(self.orbit.scene), "the orbit itself"))
        units_text = ", ".join(f"{name} {column_units[name][1] * unit_step:g}" for name, unit_step in self.free.items())
        radius, n_directions = self.searched
        search_text = f"followed to a distance of {radius:g} in {n_directions} directions"
        return "\n".join(
            [align_columns(rows), f"units: {units_text}", search_text, *([self.stopped] if self.stopped else [])]
        )
