"""What follows a grazing: `scenario`."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Complex, Float

from ..maps import itinerary as words
from ..orbits.orbit import STABILITY_MARGIN
from ..output.table_text import align_columns, multipliers_text
from ..problem.contact_exponent import contact_exponent
from ..problem.grazing_return import compute_grazing_return
from ..problem.one_impact_orbits import impact_indices, traversal_count
from ..problem.orbit_point import set_up_problem
from ..problem.soft_grazing import is_smooth_wall
from ..problem.square_root_map import MAX_RETURNS, SquareRootMap
from ..scene import check
from ..scene.scene import SIDES
from ..scene.typical_scales import scene_length
from .branch import Special

DEFAULT_MAX_RETURNS = 6  # returns
ROOT_EXPONENT = 0.5  # the exponent at a rigid wall
OVERLAP_MULTIPLIER, CHAOS_MULTIPLIER = (
    0.25,
    2.0 / 3.0,
)  # multipliers between which there is chaos between the windows of period adding


class Follows(Enum):
    """What a stable motion that comes to a grazing is followed by.

    OVERLAPPING: period adding, each window of parameters overlapping the next; ADDING: period adding, with chaos
    between; CHAOS: chaos alone. In these three what follows leaves gradually. JUMP: nothing stays near. C1: the motion
    goes on, at a soft wall, and its derivative with it. UNSTABLE: none comes. OPEN: the signs do not decide.
    """

    OVERLAPPING = "period adding, overlapping"
    ADDING = "period adding, chaos between"
    CHAOS = "chaos"
    JUMP = "jump"
    C1 = "C1"
    UNSTABLE = "unstable"
    OPEN = "open"


GRADUAL_OUTCOMES = (Follows.OVERLAPPING, Follows.ADDING, Follows.CHAOS)


@dataclass(frozen=True)
class OneImpact:
    """The orbits with one impact besides in n returns, as the square-root map has them.

    returns: n; label; response: C M^n E, above 0 where an impact is followed by a deeper contact n returns later; fold,
    doubling, touch: the parameter's value where they fold, double their period and touch the wall once more, nan where
    they do not; stable: whether some are.
    """

    returns: int
    label: str
    response: float
    fold: float
    doubling: float
    touch: float
    stable: bool


@dataclass(frozen=True, eq=False)
class Scenario:
    """What follows a grazing, made by `scenario`.

    special: the grazing; follows: a `Follows`. wall: "left" or "right", that is touched, of two with the larger root.
    root: by how much the velocity jumps, over the root of the depth that a contact would have; exponent: of the depth
    in how it changes the motion, 0.5 at a rigid wall; acceleration: away from the wall, relative to it; rate: how fast
    the depth grows with the parameter; side: of the parameter, 1 or -1, on which it is above 0. half: whether a return
    is half of the orbit, the other half its mirror image; matrix: M, what a return makes of a change of (x, v) at the
    touch, its impact left out; multipliers: M's, the larger first. deeper: the first n with C M^n E > 0, 0 where there
    is none. ratio: by which the touches of `orbits` come nearer to the grazing from n to n + 1 in the end, one over the
    square of the larger multiplier, where what follows leaves gradually, else nan. orbits: a `OneImpact` for each n
    from 1 on, none where follows is C1, UNSTABLE, or several touches are to be told apart.
    """

    special: Special = field(repr=False)
    follows: Follows
    wall: str
    root: float
    exponent: float
    acceleration: float
    rate: float
    side: int
    half: bool
    matrix: Float[np.ndarray, "2 2"]
    multipliers: Complex[np.ndarray, "2"]
    deeper: int
    ratio: float
    orbits: tuple[OneImpact, ...]

    def table(self) -> str:
        """What follows as a text, and a line for each n."""
        lines = [
            f"{self.follows.value}: {self.special.label} touches the {self.wall} wall at {self.special.value:.12g}",
            f"{self._change_text}, depth {self.rate:+.6g} a unit",
            f"multipliers of a return{' of half the orbit' * self.half}: {multipliers_text(self.multipliers)}",
        ]
        if np.isfinite(self.ratio):
            lines.append(f"places come nearer by {self.ratio:.6g} each")
        rows: list[tuple[object, ...]] = [("returns", "orbit", "C M^n E", "fold", "doubling", "touch", "stable")]
        for one_impact in self.orbits:
            value_texts = (
                f"{value:.9g}" if np.isfinite(value) else "-"
                for value in (one_impact.fold, one_impact.doubling, one_impact.touch)
            )
            rows.append(
                (
                    one_impact.returns,
                    one_impact.label,
                    one_impact.response,
                    *value_texts,
                    "yes" if one_impact.stable else "no",
                )
            )
        return "\n".join([*lines, *([align_columns(rows)] if self.orbits else [])])

    @property
    def _change_text(self):
        if self.exponent == ROOT_EXPONENT:
            return f"velocity jumps by {self.root:.6g} sqrt(depth)"
        return f"change as depth^{self.exponent:g}"


@check.host_only("use located for derivatives of a grazing's value")
def scenario(special: Special, longest: int = DEFAULT_MAX_RETURNS) -> Scenario:
    """What follows a grazing, as signs at the point decide it: a `Scenario`.

    special: a GR of a branch, of an orbit that does not rest; with impacts or none, at any wall, also one that moves,
    along any parameter. longest: the last n whose orbits with one impact in n returns are told.

    At a rigid wall Nordmark's map is taken from the orbit that leaves the touch out (`square_root_map`): a contact that
    would be d deep changes the velocity by root sqrt(d). Places of orbits are to first order in the root of the depth,
    so good near the point: `period_adding` finds them. An orbit that touches both walls at once as its own mirror image
    is seen by halves; other orbits with several touches are OPEN. A soft wall whose force has no jump has C1.

    Raises ArgumentError where special is no such point, and for a longest that is no whole number from 1 to 64.
    """
    longest = check_max_returns(longest)
    return make_scenario(special, grazing_return_of(special), longest)


def check_max_returns(max_returns):
    """The number of returns as an int. Raises ArgumentError."""
    max_returns = check.whole_number("longest", max_returns, 1)
    if max_returns > MAX_RETURNS:
        raise check.ArgumentError("longest", f"must be at most {MAX_RETURNS}", max_returns)
    return max_returns


def grazing_return_of(special):
    """The `TouchReturn` of a grazing. Raises ArgumentError where a point is none that `scenario` takes."""
    if not isinstance(special, Special) or special.kind != "GR":
        actual = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", "must be a grazing, GR, of a branch", actual)
    if special.orbit.rests:
        raise check.ArgumentError("special", "must be of an orbit that does not rest", special.label)
    problem, z = set_up_problem(special.scene, special.name, special.spot)
    grazing_return = compute_grazing_return(special.scene, special.name, problem, z, scene_length(special.scene))
    if grazing_return is None:
        raise check.ArgumentError("special", "must touch a wall from outside it", special.label)
    return grazing_return


def make_scenario(special, grazing_return, max_returns):
    """The `Scenario` of a grazing, grazing_return: its `TouchReturn`."""
    depth = max(
        (contact.depth for contact in grazing_return.omitted_grazings), key=lambda contact_depth: contact_depth.root
    )
    wall, square_root_map = (
        special.scene.walls[SIDES[int(depth.side > 0)]],
        SquareRootMap(depth.root, grazing_return.matrix),
    )
    is_single_contact = not wall.soft and len(grazing_return.omitted_grazings) == 1 + grazing_return.is_half
    if all(is_smooth_wall(special.scene, contact.depth.side) for contact in grazing_return.omitted_grazings):
        follows, deeper, exponent = Follows.C1, 0, contact_exponent(wall)
    else:
        (follows, deeper), exponent = _classify(square_root_map, is_single_contact), ROOT_EXPONENT
    has_map_orbits = is_single_contact and follows is not Follows.UNSTABLE
    return Scenario(
        special=special,
        follows=follows,
        wall=SIDES[int(depth.side > 0)],
        root=depth.root,
        exponent=exponent,
        acceleration=depth.acceleration,
        rate=depth.slope,
        side=int(np.sign(depth.slope)),
        half=grazing_return.is_half,
        matrix=grazing_return.matrix,
        multipliers=square_root_map.multipliers,
        deeper=deeper,
        ratio=float(square_root_map.multipliers[0].real ** -2) if follows in GRADUAL_OUTCOMES else np.nan,
        orbits=_one_impact_orbits(special.value, grazing_return, square_root_map, depth, max(max_returns, deeper))
        if has_map_orbits
        else (),
    )


def _classify(square_root_map, is_single_contact):
    """(`Follows` of a square-root map, the first n with C M^n E > 0 or 0); is_single_contact: whether it is all there
    is."""
    larger_multiplier, smaller_multiplier = square_root_map.multipliers
    if not abs(larger_multiplier) < 1.0 - STABILITY_MARGIN:
        return Follows.UNSTABLE, 0
    deeper = square_root_map.first_positive_response() if is_single_contact else None
    if deeper:
        return Follows.JUMP, deeper
    if deeper is None or larger_multiplier.imag or smaller_multiplier.real < 0:
        return Follows.OPEN, 0
    if larger_multiplier.real < OVERLAP_MULTIPLIER:
        return Follows.OVERLAPPING, 0
    return (Follows.ADDING if larger_multiplier.real < CHAOS_MULTIPLIER else Follows.CHAOS), 0


def _one_impact_orbits(grazing_value, grazing_return, square_root_map, depth, max_returns):
    """The `OneImpact`s of a `TouchReturn`, as its square-root map has them."""
    responses, one_impact_orbits = square_root_map.responses(max_returns), []
    for n in range(1, max_returns + 1):
        window = square_root_map.window(n)
        special_roots = window.fold_root, window.doubling_root, window.grazing_root
        parameter_values = (
            grazing_value + window.depth(root) / depth.slope if np.isfinite(root) and root > 0 else np.nan
            for root in special_roots
        )
        one_impact_orbits.append(
            OneImpact(
                n,
                _label(grazing_return, n),
                float(responses[n]),
                *map(float, parameter_values),
                bool(window.min_stable_root < window.grazing_root),
            )
        )
    return tuple(one_impact_orbits)


def _label(grazing_return, n):
    """P n p q of the orbits with one impact besides in n returns."""
    n_traversals = traversal_count(grazing_return, n)
    sides = [*np.asarray(grazing_return.reduced_problem.sequence.sides)] * n_traversals + [
        grazing_return.omitted_grazings[k].depth.side for _, k in impact_indices(grazing_return, n)
    ]
    wall_letters = "L" * sum(side < 0 for side in sides) + "R" * sum(side > 0 for side in sides)
    return words.label(
        (wall_letters, *[""] * (n_traversals * int(grazing_return.reduced_problem.sequence.periods) - 1))
    )
