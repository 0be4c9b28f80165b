"""Continuation's failures over random scenes whose branches are known in closed form: ends that are not reached, points
on another branch, special points that are missed or that are none."""

import time
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

import jaxvibro as jv
from benchmarks import page
from reliability import branch_truth, jaxcont_branch, scipy_branch

SCENES, SECONDS = 200, 120  # of ours; the rival follows as many of them as fit
KINDS = [(True, 1), (False, 1), (False, 2)]  # P111, P101, P201, in turn
NEAR = 1e-3  # a point's state, over 1 + its size, further than this from every orbit of the branch is on another
LABEL = 1e-2  # of A: a special point further away than this from a true one is none
END = 0.05  # of the branch's impact speeds: an end further away than this is not reached
STEP = 0.02  # of the same: the first step of a rival, which takes steps of four times that at most
NAMED = {"jaxvibro": ("SN", "SB", "PD", "GR"), "SciPy arclength": ("SN", "SB", "PD"), "jaxcont on our map": ("SN",)}
HEAD = ("method", "branches", "lost", "jumped", "with a special point missed", "with one that is none", "seconds each")
NOTES = (
    "Random scenes, in turn symmetric P111 between two walls, P101 and P201 at one, along A from the middle; "
    "a closed form tells A and the state of every orbit, SN, SB, PD and where it ends: at a grazing or at the bound.",
    "Lost: an end that is not reached. Jumped: a point whose state is no orbit of the branch at that A: mostly past a "
    "grazing, where a follower of the map's fixed points goes on along the motion without impacts and says nothing.",
    "Special points count where they are within 1 % of A. SciPy and jaxcont follow fixed points of the map at phase 0, "
    "by differences and by exact derivatives; it is not smooth where an impact passes phase 0. Of jaxcont folds alone "
    "are asked, of SciPy SN, SB and PD, of ours grazings too.",
    "AUTO-07p does not build here: there is no Fortran compiler.",
)


class Path(NamedTuple):
    """What a method gives: states (points, 3), x, v and A at phase 0 along the branch; special points [(kind, A)]."""

    places: np.ndarray
    special: list[tuple[str, float]]


class Judged(NamedTuple):
    """lost: ends of two that were not reached; jumped: points on another branch; missed, wrong: [(kind, A)]; error: the
    largest of A of the special points that are right, relative."""

    lost: int
    jumped: int
    missed: list[tuple[str, float]]
    wrong: list[tuple[str, float]]
    error: float


class Count(NamedTuple):
    """A method's branches: how many, and of how many each failure; error: of A of special points; seconds each."""

    method: str
    branches: int
    lost: int
    jumped: int
    missed: int
    wrong: int
    error: float
    seconds: float


def measure(size):
    """[`Count`]: ours on all scenes, each rival's on the first of them, as many as fit. size: a `Size`."""
    truths, seconds = drawn(size.states(SCENES)), SECONDS / (1 + 11 * size.quick)
    return [counted(method, follow, truths, seconds) for method, follow in METHODS.items()]


def drawn(count, seed=12):
    """So many `Truth`s, the kinds in turn."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        truth = branch_truth.draw(rng, *KINDS[len(found) % len(KINDS)])
        if truth is not None:
            found.append(truth)
    return found


def ours(truth):
    """The `Path` by `find_orbit` and `follow`, up to grazings, where another branch goes on."""
    family, (state, amplitude) = truth.family, begun(truth)
    left = -1.0 if family.symmetric else None
    scene = jv.make_scene(amplitude, family.omega, family.gamma, family.restitution, (left, 1.0))
    orbit = jv.find_orbit(scene, jv.State(*state), family.periods, settle=0)
    branch = jv.follow(orbit, "amplitude", truth.bounds, stop="GR")
    x, v = (np.reshape(branch.data[name].values, (len(branch), -1))[:, 0] for name in ("x", "v"))
    return Path(np.stack([x, v, branch.values], -1), [(one.kind, one.value) for one in branch.special])


def by(module):
    """The function that gives the `Path` by a rival's `followed`."""

    def path(truth):
        state, amplitude = begun(truth)
        step = STEP * (truth.high - truth.low)
        return Path(*module.followed(truth.family, truth.bounds, np.array([*state, amplitude]), step))

    return path


METHODS = {"jaxvibro": ours, "SciPy arclength": by(scipy_branch), "jaxcont on our map": by(jaxcont_branch)}


def begun(truth):
    """((x, v), A) at phase 0 of the orbit that a branch is followed from."""
    x, v = truth.family.sections(truth.start)[0]
    return (float(x), float(v)), float(truth.family.amplitude(truth.start))


def judge(truth, path, named):
    """`Judged`: a path against the closed form; named: the kinds of special points that the method tells."""
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
    """How far A of a special point is from the nearest of its kind, relative; inf: there is none."""
    return min((abs(value / special[1] - 1) for kind, value in others if kind == special[0]), default=np.inf)


def matched(special, others):
    """Whether there is one of its kind close by."""
    return off(special, others) < LABEL


def nearest(family, places):
    """(impact speed of the nearest orbit of the branch at the same A, how far its state is, over 1 + the size)."""
    state, amplitude = places[:, :2], places[:, 2]
    fold = max(family.turning(1.0), 0.0)
    roots = np.nan_to_num(family.speeds(amplitude), nan=fold)  # beyond the fold by rounding: the fold itself
    best = np.full(len(places), np.inf), np.zeros(len(places))
    for speed in roots:
        for section in family.sections(speed):
            apart = abs(np.stack(section, -1) - state).max(-1) / (1.0 + abs(state).max(-1))
            apart = np.where(speed >= -NEAR, apart, np.inf)  # 0 at a grazing, to rounding
            best = np.minimum(apart, best[0]), np.where(apart < best[0], speed, best[1])
    return best[1], best[0]


def counted(method, follow, truths, seconds):
    """The `Count` of a method on as many branches as fit into the seconds that follow the first of each kind, which may
    have to be compiled. A method that gives up at the start has lost the branch."""
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
    """The counts in Markdown, shares with Clopper-Pearson's bounds at 95 %."""
    lines = [
        (one.method, one.branches, *(share(each, one.branches) for each in one[2:6]), page.short(one.seconds))
        for one in counts
    ]
    return page.table(HEAD, lines)


def share(failed, count):
    """A share in per cent, with its bounds."""
    low, high = binomtest(failed, count).proportion_ci(method="exact")
    return f"{failed}: {100 * failed / count:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
