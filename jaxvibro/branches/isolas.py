"""`find_isolas`: closed branches that no other leads to and no start need settle on.

At values all over the parameter's range the equations of the impacts are solved for each order of walls, by Newton's
method from guesses at random, each led away from what it has met (`orbits/deflated.py`). What lies on no branch known
so far is followed; those branches that come back to where they began are isolas.
"""

from collections.abc import Callable
from itertools import product

import jax
import numpy as np

from continuation.limits import EXPIRED, Results, limits_of

from ..maps.initial_conditions import box
from ..orbits.deflated import deflated
from ..orbits.impact_equations import Cycle
from ..orbits.orbit_comparison import times_round
from ..problem.diagnostics import diagnose
from ..problem.end import End
from ..problem.orbit_on_branch import OrbitPoint, impacts, place_orbit
from ..scene import check
from ..scene.parameters import domain
from ..scene.symmetry import stays_symmetric
from .branch import Branch
from .branch_tree import MOST, Tree
from .diagram import Diagram
from .follow import check_settings, through
from .on_branch import is_on, settled_at
from .seed_orbits import Probe
from .switch import FIRST

VALUES, GUESSES = 256, 2  # of the parameter; at each
SAME = 1e-6  # of the largest speed: two impacts as near are one
LONGEST = 32  # impacts of an orbit


@check.host("use strobe or monodromy")
def find_isolas(
    diagram: Diagram,
    max_period: int = 4,
    max_impacts: int = 4,
    seed: int = 0,
    progress: Callable[[int], object] | None = None,
    *,
    max_seconds: float | None = None,
) -> Results[Branch]:
    """The isolas of a scene along a parameter, closed branches that are on none of a diagram's: a tuple of `Branch`.

    diagram: of `explore`, whose scene, parameter and bounds are taken. max_period, max_impacts: of the orbits that are
    looked for, in drive periods, at most 64, and in impacts, at most 32; seed: of the guesses. progress: called with
    the number of orders of walls looked at so far. max_seconds: wall-clock time, s, after which the isolas so far are
    returned, and the attribute `stopped` of the tuple, else "", says so; None is no limit.

    Each order of walls is solved for at 256 values of the parameter: an isola as wide as a few hundredths of the bounds
    is met, a narrower one by chance. It is told to be closed where its branch comes back to its first orbit, through
    grazings too; in a symmetric scene its mirror image is there as well. What leaves it, `switch` follows.

    Raises ArgumentError for arguments that cannot be.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    if not isinstance(diagram, Diagram):
        raise check.ArgumentError("diagram", "must be a Diagram, as explore gives it", diagram)
    longest, most = check.whole("max_period", max_period, 1), check.whole("max_impacts", max_impacts, 1)
    for key, given, top in (("max_period", longest, check.MOST_PERIODS), ("max_impacts", most, LONGEST)):
        if given > top:
            raise check.ArgumentError(key, f"must be at most {top}", given)
    rng = np.random.default_rng(check.whole("seed", seed, 0))
    scene, name, bounds = diagram.scene, diagram.name, diagram.bounds
    steps = check_settings(FIRST, diagram.settings["largest_step"], 1e-10, (), ()) | {"limits": limits}
    known = list(diagram.branches)
    tree = Tree(bounds, longest, len(known) + MOST, steps, known, [], stays_symmetric(scene, name), None)
    found: list[Branch] = []
    for count, (periods, sides) in enumerate(_orders(scene, longest, most), 1):
        if limits.expired:
            return Results(found, f"{EXPIRED}: {count - 1} orders of walls done")
        for probe in _probes(scene, name, bounds, periods, sides, rng):
            if not tree.is_spent and not any(is_on(probe, branch) for branch in tree.found):
                found += _followed(tree, probe, scene, name, bounds, steps)
        if progress is not None:
            progress(count)
    return Results(found)


def _followed(tree, probe, scene, name, bounds, steps):
    """What a probe's branch and its mirror image are, if they close; they are known from now on."""
    start = settled_at(probe, *place_orbit(scene, name, probe.spot))
    if start is None:
        return []
    branch = through(scene.replace(**{name: probe.spot.value}), name, bounds, start, "both", steps)
    if tree.has(branch):
        return []
    before = len(tree.found)
    tree.add(branch)
    return tree.found[before:] if branch.ends[1] is End.CLOSED else []


def _orders(scene, longest, most):
    """(periods, sides) of each order of walls, from whichever impact it is counted: short ones first."""
    letters = [side for side, wall in ((-1.0, scene.left), (1.0, scene.right)) if wall is not None]
    for periods in range(1, longest + 1):
        for count in range(1, most + 1):
            for sides in product(letters, repeat=count):
                if sides == min(sides[k:] + sides[:k] for k in range(count)):
                    yield periods, np.array(sides)


def _probes(scene, name, bounds, periods, sides, rng):
    """The `Probe`s of orbits with an order of walls at values of the parameter."""
    low, high = np.clip(domain(scene, name), *bounds)
    lanes, count, rows = VALUES * GUESSES, len(sides), max(2, 1 << (len(sides) - 1).bit_length())
    values = np.repeat(low + (high - low) * (np.arange(VALUES) + rng.random(VALUES)) / VALUES, GUESSES)
    scenes = scene.replace(**{name: values})
    length = 2.0 * np.pi / np.broadcast_to(scenes.frequency, lanes)
    fast = np.broadcast_to(box(scenes)[2], lanes)
    times, speeds, walls = np.zeros((3, lanes, rows))
    times[:, :count] = np.sort(rng.random((lanes, count)) * periods, axis=1) * length[:, None]
    speeds[:, :count], walls[:, :count] = rng.random((lanes, count)) * fast[:, None], sides
    scenes = jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf), lanes), scenes)
    cycles = Cycle(times, speeds, walls, np.zeros(lanes), np.full(lanes, float(periods)))
    solved = deflated(scenes, cycles, fast)
    for lane, turn in zip(*np.nonzero(solved.real.T), strict=True):
        plain = solved.times[turn, lane, :count], solved.speeds[turn, lane, :count], sides
        spot = OrbitPoint(float(values[lane]), *plain, periods, np.nan, np.nan, 0.0)
        if times_round(impacts(spot, 2.0 * np.pi / length[lane]), periods, SAME) == 1:
            look = diagnose(*(each[None] if k else each for k, each in enumerate(place_orbit(scene, name, spot))))
            x, v = look.x[0], look.v[0]
            yield Probe(spot._replace(x=float(x[0]), v=float(v[0])), np.stack([x, v], axis=1))
