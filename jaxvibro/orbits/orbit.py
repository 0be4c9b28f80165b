"""A periodic orbit and what is known of it; and why there is none."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex

from ..maps import itinerary as words
from ..maps.sticking_phases import NO_STICKING
from ..output.table_text import align_columns, column_header, multipliers_text
from ..output.units import LENGTH, SPEED, TIME, unit_in_system
from ..scene.scene import SIDES, Scene
from ..scene.state import Impacts, State

AREA_TOLERANCE = 1e-9  # of 1 + the trace, squared: nearer to 1 a determinant is 1
STABILITY_MARGIN = 1e-9  # a multiplier as near to size 1 is a special point's, whose stability rounding would decide


class OrbitError(ValueError):
    """There is no orbit to return. status: in a few words; residual: how far what was found is from an orbit, in the
    scene's lengths, nan where nothing was; advice: what may help."""

    def __init__(self, status: str, residual: float, advice: str) -> None:
        super().__init__(status, residual, advice)
        self.status, self.residual, self.advice = status, residual, advice

    def __str__(self) -> str:
        residual_text = "" if np.isnan(self.residual) else f" (residual {self.residual:.1e})"
        return f"no orbit: {self.status}{residual_text}; {self.advice}"


@dataclass(frozen=True, eq=False)
class Orbit:
    """A periodic orbit of a scene.

    label: P n p q, inf for p or q on a wall with complete chatter: P1-0-inf. periods: n, the least number of drive
    periods. state: on it, at the section's phase: the phase asked for, unless an impact is within a thousandth of a
    period of it; then the middle of the longest flight. impacts: in n periods from there, without empty slots.
    itinerary: the walls hit, a word a period. multipliers: Floquet's, the larger first, complex, shape (2,). stable:
    both are smaller than 1, by more than rounding. residual: the largest error left in the equations that were solved
    (lengths, lengths per t). least_speed, least_clearance: of the impacts, and of turning points towards a wall; inf
    where there are none. unknowns: "impacts" where their times and speeds were solved for, "state" where the state was.
    scene: whose orbit it is. mirror_of: in a tuple of `find_orbits` the place of its mirror image, its own where it is
    symmetric; else None. rests: whether the mass rests on a wall for a while; hops of complete chatter are recorded up
    to where they are certain to end.
    """

    label: str
    periods: int
    state: State
    impacts: Impacts
    itinerary: tuple[str, ...]
    multipliers: Complex[np.ndarray, "2"]
    stable: bool
    residual: float
    least_speed: float
    least_clearance: float
    unknowns: str
    scene: Scene = field(repr=False)
    mirror_of: int | None = None
    rests: bool = False

    def table(self, units: str = "scene") -> str:
        """What the orbit is, its state, and a line for each impact: when, on which wall, the speed before it. units:
        "scene", or "physical" (s, mm, m/s) of a scene that has scales.

        Raises ArgumentError for other units, and where the scene has no scales.
        """
        (length_unit, length_scale), (speed_unit, speed_scale), (time_unit, time_scale) = (
            unit_in_system(self.scene, quantity, units) for quantity in (LENGTH, SPEED, TIME)
        )
        rows = [(column_header("time", time_unit, units), "wall", column_header("speed", speed_unit, units))]
        impacts = zip(self.impacts.time, self.impacts.side, self.impacts.speed, strict=True)
        rows += [
            (f"{time_scale * time:.9g}", SIDES[int(side > 0)], f"{speed_scale * speed:.9g}")
            for time, side, speed in impacts
        ]
        heading = (
            f"{self.label}, {'stable' if self.stable else 'unstable'}, multipliers {multipliers_text(self.multipliers)}"
        )
        x_text, v_text = f"{length_scale * self.state.x:.12g}", f"{speed_scale * self.state.v:.12g}"
        state_text = (
            f"{column_header('x', length_unit, units)} {x_text}, {column_header('v', speed_unit, units)}"
            f" {v_text} at phase {self.state.phase:.9g}"
        )
        return "\n".join([heading, state_text, align_columns(rows)])


def eigenvalue_pair(trace, determinant):
    """The eigenvalues of a matrix with this trace and determinant: complex, shape (2,), see `eigenvalue_pairs`."""
    return eigenvalue_pairs(np.reshape(trace, 1), np.reshape(determinant, 1))[0]


def eigenvalue_pairs(trace, determinant):
    """The eigenvalues of matrices with these traces and determinants, (points,): (points, 2), the larger first.

    The larger is found without cancellation, the smaller from the determinant. Both are infinite where a number is not
    finite: at an impact without speed.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        half_trace = 0.5 * trace
        discriminant = half_trace * half_trace - determinant
        larger = half_trace + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), half_trace)
        real_pairs = np.stack([larger, np.where(larger != 0, determinant / larger, 0.0)], 1)
        complex_pairs = half_trace[:, None] + 1j * np.sqrt(np.maximum(-discriminant, 0.0))[:, None] * np.array(
            [1.0, -1.0]
        )
        eigenvalues = np.where((discriminant < 0)[:, None], complex_pairs, real_pairs)
    return np.where(np.isfinite(eigenvalues).all(axis=1)[:, None], eigenvalues, np.inf)


def make_orbit(scene, state, impacts, itinerary, multipliers, residual, unknowns, sticking=NO_STICKING):
    """The `Orbit` of these, its label and its stability read from them."""
    return Orbit(
        label=words.label(itinerary, sticking.chatter_walls),
        periods=len(itinerary),
        state=state,
        impacts=impacts,
        itinerary=itinerary,
        multipliers=multipliers,
        stable=bool(np.all(abs(multipliers) < 1.0 - STABILITY_MARGIN)),
        residual=residual,
        least_speed=impacts.least_speed,
        least_clearance=impacts.least_clearance,
        unknowns=unknowns,
        scene=scene,
        rests=sticking.has_sticking,
    )


def is_area_preserving(trace, determinant):
    """Whether the product of the multipliers is 1, of each orbit that there is."""
    return bool(np.all(abs(determinant - 1.0) <= AREA_TOLERANCE * (1.0 + abs(trace)) ** 2))
