"""Count failures of continuation over random scenes with branches in closed form.

Failures are ends that are not reached, points on another branch, and missing or spurious special points.
"""

import time
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

import jaxvibro as jv
from benchmarks import page
from reliability import branch_truth, jaxcont_branch, scipy_branch

SCENES, SECONDS = 200, 120  # scenes of this package; a rival follows as many of them as fit into the time
KINDS = [(True, 1), (False, 1), (False, 2)]  # (symmetric, periods): P111, P101, P201 in turn
NEAR = 1e-3  # a point whose relative distance from every orbit of the branch is larger lies on another branch
LABEL = 1e-2  # relative distance in A beyond which a special point matches no true one
END = 0.05  # distance, relative to the range of impact speeds, beyond which an end is not reached
STEP = 0.02  # first step of a rival, relative to this range; its largest step is four times that
NAMED = {"jaxvibro": ("SN", "SB", "PD", "GR"), "SciPy arclength": ("SN", "SB", "PD"), "jaxcont on our map": ("SN",)}
HEAD = (
    "method",
    "branches",
    "lost",
    "jumped",
    "with a missed special point",
    "with a spurious one",
    "seconds per branch",
)
NOTES = (
    "In random scenes the branches of symmetric P111 between two walls, and of P101 and P201 at one wall, are followed "
    "in A from the middle of their range of impact speeds.",
    "Closed forms give A and the state of every orbit, of the SN, SB and PD, and of the end, a grazing or a bound.",
    "Lost: an end of the branch is not reached. Jumped: the state of a point is not on the orbit of the branch at "
    "its A. Most jumps occur beyond a grazing, where a method for fixed points of the map silently continues along "
    "the motion without impacts.",
    "SciPy and jaxcont follow fixed points of the map at phase 0, SciPy with differences and jaxcont with exact "
    "derivatives. The map is not smooth where an impact passes phase 0.",
    "A special point counts as located if its A is correct to 1 %. jaxcont is evaluated on folds only, SciPy on SN, "
    "SB and PD, jaxvibro on grazings too.",
    "AUTO-07p is not included, because the machine has no Fortran compiler.",
)


class Path(NamedTuple):
    """Result of a method: points (points, 3), x, v and A at phase 0 along the branch; special points [(kind, A)]."""

    places: np.ndarray
    special: list[tuple[str, float]]


class Judged(NamedTuple):
    """Failures on a branch.

    `lost` is the number of ends (of two) that were not reached, `jumped` the number of points on another branch,
    `missed` and `wrong` are [(kind, A)], `error` is the largest relative error of A of the correct special points.
    """

    lost: int
    jumped: int
    missed: list[tuple[str, float]]
    wrong: list[tuple[str, float]]
    error: float


class Count(NamedTuple):
    """Failures of a method: branches, failures of each kind, error of A of special points, seconds per branch."""

    method: str
    branches: int
    lost: int
    jumped: int
    missed: int
    wrong: int
    error: float
    seconds: float


def measure(size):
    """Return the list of `Count` of this package on all scenes and of each rival on as many of the first as fit."""
    truths, seconds = drawn(size.states(SCENES)), SECONDS / (1 + 11 * size.quick)
    return [counted(method, follow, truths, seconds) for method, follow in METHODS.items()]


def drawn(count, seed=12):
    """Draw `Truth` objects, the kinds in turn."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        truth = branch_truth.draw(rng, *KINDS[len(found) % len(KINDS)])
        if truth is not None:
            found.append(truth)
    return found


def ours(truth):
    """Return the `Path` by `find_orbit` and `follow`, up to grazings, where another branch continues."""
    family, (state, amplitude) = truth.family, begun(truth)
    left = -1.0 if family.symmetric else None
    scene = jv.make_scene(amplitude, family.omega, family.gamma, family.restitution, (left, 1.0))
    orbit = jv.find_orbit(scene, jv.State(*state), family.periods, settle=0)
    branch = jv.follow(orbit, "amplitude", truth.bounds, stop="GR")
    x, v = (np.reshape(branch.data[name].values, (len(branch), -1))[:, 0] for name in ("x", "v"))
    return Path(np.stack([x, v, branch.values], -1), [(one.kind, one.value) for one in branch.special])


def by(module):
    """Make the function that returns the `Path` by a rival's `followed`."""

    def path(truth):
        state, amplitude = begun(truth)
        step = STEP * (truth.high - truth.low)
        return Path(*module.followed(truth.family, truth.bounds, np.array([*state, amplitude]), step))

    return path


METHODS = {"jaxvibro": ours, "SciPy arclength": by(scipy_branch), "jaxcont on our map": by(jaxcont_branch)}


def begun(truth):
    """Return ((x, v), A) at phase 0 of the starting orbit of a branch."""
    x, v = truth.family.sections(truth.start)[0]
    return (float(x), float(v)), float(truth.family.amplitude(truth.start))


def judge(truth, path, named):
    """Judge a path by the closed form; `named` are the kinds of special points that the method reports."""
    speeds, apart = nearest(truth.family, path.places)
    on = apart < NEAR
    wide = END * (truth.high - truth.low)
    due = [one for one in truth.special if one[0] in named]
    told = [one for one in path.special if one[0] in named]
    reached = [
        (abs(speeds[on] - end) < wide).any() or matched(("GR", truth.family.amplitude(end)), told)
        for end in (truth.low, truth.high)
    ]
    missed = [one for one in due if not matched(one, told)]
    wrong = [one for one in told if not matched(one, due)]
    errors = [off(one, due) for one in told if matched(one, due)]
    return Judged(2 - sum(reached), int((~on).sum()), missed, wrong, max(errors, default=0.0))


def off(special, others):
    """Return the relative distance of A of a special point from the nearest of its kind; inf if there is none."""
    return min((abs(value / special[1] - 1) for kind, value in others if kind == special[0]), default=np.inf)


def matched(special, others):
    """Return True if a special point of its kind is close."""
    return off(special, others) < LABEL


def nearest(family, places):
    """Return the impact speed of the nearest orbit at the same A and the relative distance of its state."""
    state, amplitude = places[:, :2], places[:, 2]
    fold = max(family.turning(1.0), 0.0)
    roots = np.nan_to_num(family.speeds(amplitude), nan=fold)  # beyond the fold by a rounding error: the fold itself
    best = np.full(len(places), np.inf), np.zeros(len(places))
    for speed in roots:
        for section in family.sections(speed):
            apart = abs(np.stack(section, -1) - state).max(-1) / (1.0 + abs(state).max(-1))
            apart = np.where(speed >= -NEAR, apart, np.inf)  # the speed is 0 at a grazing, up to rounding
            best = np.minimum(apart, best[0]), np.where(apart < best[0], speed, best[1])
    return best[1], best[0]


def counted(method, follow, truths, seconds):
    """Return the `Count` of a method on as many branches as fit into the time after the first of each kind.

    The first of each kind may have to be compiled. A method that fails at the start has lost the branch.
    """
    begin, found = time.perf_counter(), []
    for truth in truths:
        try:
            path = follow(truth)
        except (jv.OrbitError, ArithmeticError, np.linalg.LinAlgError):
            path = Path(np.zeros((0, 3)), [])
        found.append(judge(truth, path, NAMED[method]))
        if len(found) <= len(KINDS):
            begin = time.perf_counter()
        if time.perf_counter() - begin > seconds:
            break
    spent = (time.perf_counter() - begin) / max(1, len(found) - len(KINDS))
    sums = (sum(map(bool, each)) for each in list(zip(*found, strict=True))[:4])
    return Count(method, len(found), *sums, max(each.error for each in found), spent)


def table(counts):
    """Format the counts as Markdown, rates with Clopper-Pearson bounds at 95 %."""
    lines = [
        (one.method, one.branches, *(share(each, one.branches) for each in one[2:6]), page.short(one.seconds))
        for one in counts
    ]
    return page.table(HEAD, lines)


def share(failed, count):
    """Format a rate in per cent, with its bounds."""
    low, high = binomtest(failed, count).proportion_ci(method="exact")
    return f"{failed}: {100 * failed / count:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
