"""What follows a grazing: `scenario`."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Complex, Float

from ..maps import itinerary as words
from ..orbits.orbit import MARGIN
from ..output.table_text import columns, pair
from ..problem.one_impact import kicks, rounds
from ..problem.orbit_on_branch import place_orbit
from ..problem.soft_exponent import exponent_of
from ..problem.soft_grazing import is_smooth
from ..problem.square_root_map import MOST, SquareRootMap
from ..problem.touch_return import touch_return
from ..scene import check
from ..scene.scale import scene_length
from ..scene.scene import SIDES
from .branch import Special

LONGEST = 6  # returns
ROOT = 0.5  # the exponent at a rigid wall
OVERLAP, ALONE = 0.25, 2.0 / 3.0  # multipliers between which there is chaos between the windows of period adding


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


GRADUAL = (Follows.OVERLAPPING, Follows.ADDING, Follows.CHAOS)


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
        told = [
            f"{self.follows.value}: {self.special.label} touches the {self.wall} wall at {self.special.value:.12g}",
            f"{self._change}, depth {self.rate:+.6g} a unit",
            f"multipliers of a return{' of half the orbit' * self.half}: {pair(self.multipliers)}",
        ]
        if np.isfinite(self.ratio):
            told.append(f"places come nearer by {self.ratio:.6g} each")
        rows: list[tuple[object, ...]] = [("returns", "orbit", "C M^n E", "fold", "doubling", "touch", "stable")]
        for one in self.orbits:
            places = (f"{each:.9g}" if np.isfinite(each) else "-" for each in (one.fold, one.doubling, one.touch))
            rows.append((one.returns, one.label, one.response, *places, "yes" if one.stable else "no"))
        return "\n".join([*told, *([columns(rows)] if self.orbits else [])])

    @property
    def _change(self):
        if self.exponent == ROOT:
            return f"velocity jumps by {self.root:.6g} sqrt(depth)"
        return f"change as depth^{self.exponent:g}"


@check.host("use located for derivatives of a grazing's value")
def scenario(special: Special, longest: int = LONGEST) -> Scenario:
    """What follows a grazing, as signs at the point decide it: a `Scenario`.

    special: a GR of a branch, of an orbit that does not rest; with impacts or none, at any wall, also one that moves,
    along any parameter. longest: the last n whose orbits with one impact in n returns are told.

    At a rigid wall Nordmark's map is taken from the orbit that leaves the touch out (`square_root_map`): a contact that
    would be d deep changes the velocity by root sqrt(d). Places of orbits are to first order in the root of the depth,
    so good near the point: `period_adding` finds them. An orbit that touches both walls at once as its own mirror image
    is seen by halves; other orbits with several touches are OPEN. A soft wall whose force has no jump has C1.

    Raises ArgumentError where special is no such point, and for a longest that is no whole number from 1 to 64.
    """
    longest = checked_longest(longest)
    return scenario_of(special, returned(special), longest)


def checked_longest(longest):
    """The number of returns as an int. Raises ArgumentError."""
    longest = check.whole("longest", longest, 1)
    if longest > MOST:
        raise check.ArgumentError("longest", f"must be at most {MOST}", longest)
    return longest


def returned(special):
    """The `TouchReturn` of a grazing. Raises ArgumentError where a point is none that `scenario` takes."""
    if not isinstance(special, Special) or special.kind != "GR":
        given = special.kind if isinstance(special, Special) else special
        raise check.ArgumentError("special", "must be a grazing, GR, of a branch", given)
    if special.orbit.rests:
        raise check.ArgumentError("special", "must be of an orbit that does not rest", special.label)
    along, z = place_orbit(special.scene, special.name, special.spot)
    found = touch_return(special.scene, special.name, along, z, scene_length(special.scene))
    if found is None:
        raise check.ArgumentError("special", "must touch a wall from outside it", special.label)
    return found


def scenario_of(special, found, longest):
    """The `Scenario` of a grazing, found: its `TouchReturn`."""
    depth = max((one.depth for one in found.touches), key=lambda one: one.root)
    wall, near = special.scene.walls[SIDES[int(depth.side > 0)]], SquareRootMap(depth.root, found.matrix)
    one_touch = not wall.soft and len(found.touches) == 1 + found.half
    if all(is_smooth(special.scene, one.depth.side) for one in found.touches):
        follows, deeper, exponent = Follows.C1, 0, exponent_of(wall)
    else:
        (follows, deeper), exponent = _decided(near, one_touch), ROOT
    mapped = one_touch and follows is not Follows.UNSTABLE
    return Scenario(
        special=special,
        follows=follows,
        wall=SIDES[int(depth.side > 0)],
        root=depth.root,
        exponent=exponent,
        acceleration=depth.acceleration,
        rate=depth.slope,
        side=int(np.sign(depth.slope)),
        half=found.half,
        matrix=found.matrix,
        multipliers=near.multipliers,
        deeper=deeper,
        ratio=float(near.multipliers[0].real ** -2) if follows in GRADUAL else np.nan,
        orbits=_one_impact(special.value, found, near, depth, max(longest, deeper)) if mapped else (),
    )


def _decided(near, one_touch):
    """(`Follows` of a square-root map, the first n with C M^n E > 0 or 0); one_touch: whether it is all there is."""
    first, other = near.multipliers
    if not abs(first) < 1.0 - MARGIN:
        return Follows.UNSTABLE, 0
    deeper = near.first_deeper() if one_touch else None
    if deeper:
        return Follows.JUMP, deeper
    if deeper is None or first.imag or other.real < 0:
        return Follows.OPEN, 0
    if first.real < OVERLAP:
        return Follows.OVERLAPPING, 0
    return (Follows.ADDING if first.real < ALONE else Follows.CHAOS), 0


def _one_impact(value, found, near, depth, longest):
    """The `OneImpact`s of a `TouchReturn`, as its square-root map has them."""
    responses, told = near.responses(longest), []
    for n in range(1, longest + 1):
        one = near.window(n)
        ways = one.fold, one.doubling, one.touch
        places = (value + one.depth(s) / depth.slope if np.isfinite(s) and s > 0 else np.nan for s in ways)
        told.append(
            OneImpact(n, _label(found, n), float(responses[n]), *map(float, places), bool(one.stable < one.touch))
        )
    return tuple(told)


def _label(found, n):
    """P n p q of the orbits with one impact besides in n returns."""
    times = rounds(found, n)
    sides = [*np.asarray(found.bare.cycle.sides)] * times + [found.touches[k].depth.side for _, k in kicks(found, n)]
    flat = "L" * sum(side < 0 for side in sides) + "R" * sum(side > 0 for side in sides)
    return words.label((flat, *[""] * (times * int(found.bare.cycle.periods) - 1)))
