"""Derivatives of the strobe through rests against 50 digits: `python -m tests.rest_slopes_proof first N [seed]`.

first: of the end by x, v, phase and every number of the scene, of the impacts' times and speeds, and the rank by x and
v, in N cases that rest or stick, half of them with moving walls; reverse: the end's by reverse mode; second: the end's
second derivatives along a direction.
"""

import sys
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxvibro.maps.reference_strobe import REPLAY_SLOTS
from tests.proof import scene_of
from tests.reference import rest_slopes, slopes
from tests.reference.draws import Draw
from tests.reference.scene import Motion, Scene, Wall
from tests.slopes_proof import ends

STRUCTURES = ((None, 0), (None, 1), (2, None), (0, 0), (0, 1), (1, 1))  # harmonics of the walls, 0: it stands still
SLOW = 1e-2  # impacts since the last release that are slower are told apart: rounding is not small beside their speed
ROWS = 8  # impacts of a case and of a stretch that are compared
RECORDED = 64
KINDS = ("rests at the end", "released", "released, slow impacts", "R = 0 leaves at once")


class Case(NamedTuple):
    """A start in a scene, what happens, its place in `KINDS`."""

    draw: Draw
    story: rest_slopes.Story
    kind: int


def drawn(rng, structure):
    """A random `Draw` with walls of a structure."""
    gamma = rng.uniform(0.0, 0.4) if rng.random() < 0.7 else rng.uniform(0.4, 1.6)
    omega, amplitude = rng.uniform(0.15, 1.5), rng.uniform(0.3, 4.0)
    low, gap = rng.uniform(-1.2, 0.6), rng.uniform(0.3, 2.0)
    walls = []
    for place, harmonic in zip((low, low + gap), structure, strict=True):
        own = 0.0 if rng.random() < 0.25 else rng.uniform(0.1, 0.95)
        motion = Motion(rng.uniform(0.02, 0.3) * min(gap, 1.0), rng.uniform(0, 6.28), harmonic) if harmonic else None
        walls.append(None if harmonic is None else Wall(place, own, motion))
    scene, phase = Scene(gamma, omega, amplitude, *walls), rng.uniform(-3.0, 3.0)
    space = low + 0.35 * gap, low + 0.65 * gap
    return Draw(scene, rng.uniform(*space), rng.uniform(-2.0, 2.0), phase)


def cases(rng, structure, count):
    """So many `Case`s, and how many draws rounding decides."""
    found, unfair = [], 0
    while len(found) < count:
        draw = drawn(rng, structure)
        try:
            story = rest_slopes.story(*draw)
        except rest_slopes.UnfairError:
            unfair += 1
            continue
        last = story.stretches[-1]
        if story.held:
            kind = 0
        elif last.since is None and not story.plastic:
            continue
        elif len(last.hits) > REPLAY_SLOTS or story.slowest < 1e-3:
            unfair += 1
            continue
        else:
            kind = 3 if story.plastic else 1 + (story.slowest < SLOW)
        found.append(Case(draw, story, kind))
    return found, unfair


def told(members, way):
    """(x, v, times, speeds of the impacts, their derivatives) of cases of one structure."""
    form = scene_of([case.draw.scene for case in members])
    run = ends(form, 1, RECORDED)
    points = jnp.array([slopes.numbers(case.draw) for case in members])
    derivative = jax.jacrev(lambda numbers: run(numbers)[:2]) if way == "reverse" else jax.jacfwd(run)
    both = jax.jit(jax.vmap(lambda numbers: (run(numbers), derivative(numbers))))
    return [np.asarray(each) for each in both(points)]


def first(count, seed, way):
    """Prints the largest errors by kind, the ranks, and what was decided otherwise."""
    rng, rows, unfair, moving = np.random.default_rng(seed), [], 0, 0
    for k, structure in enumerate(STRUCTURES):
        begun, share = time.time(), count // len(STRUCTURES) + (k < count % len(STRUCTURES))
        members, more = cases(rng, structure, share)
        unfair += more
        moving += share * any(structure)
        rows += errors(members, *told(members, way), way)
        print(f"{structure}: {share} cases, {time.time() - begun:.0f} s", flush=True)
    print(f"{len(rows)} cases, {moving} with moving walls; {unfair} draws left out")
    rows = np.array(rows).reshape(-1, 8)
    for k, kind in enumerate(KINDS):
        own = rows[rows[:, 0] == k]
        apart, ranks = own[:, 1] > 0, own[:, 2]
        worst = own[~apart, 3:].max(0, initial=0)
        print(
            f"{kind}: {len(own)}, {apart.sum()} decided otherwise, {int((own[:, 7] > REPLAY_SLOTS).sum())} with"
            " more than"
            f" {REPLAY_SLOTS} impacts; ranks that differ {int(ranks.sum())}; largest errors: end {worst[0]:.2g}, its"
            f" derivatives {worst[1]:.2g} (relative {worst[2]:.2g}), impacts' {worst[3]:.2g}"
        )


def errors(members, values, found, way):
    """Rows (kind, whether decided otherwise, whether the rank differs, errors: end, its derivatives over the largest of
    the column or 1, over the largest of the column, those of impacts over the largest of their row; impacts)."""
    rows = []
    for case, value, slope in zip(members, values, found, strict=True):
        true = rest_slopes.jacobian(case.draw, case.story)
        base = rest_slopes.base_end(case.draw, case.story)
        far, size = abs(slope[:2] - true).max(0), abs(true).max(0)
        times = value[2 : 2 + RECORDED]
        near, worst = times[np.isfinite(times)], 0.0
        if way == "first":
            worst = _of_impacts(case, near, slope)
        off = abs(value[:2] - base).max()
        ranks = _rank(slope[:2, :2]), _rank(true[:, :2])
        hits = sum(len(stretch.hits) for stretch in case.story.stretches)
        relative = (far / np.where(size > 0, size, np.inf)).max() + far[size == 0].max(initial=0)
        error = off, (far / np.maximum(size, 1)).max(), relative, worst
        rows.append((case.kind, not off < 1e-7, ranks[0] != ranks[1], *error, hits))
        if off < 1e-7 and not max(error) < 1e-9:
            print(f"  {KINDS[case.kind]}: {error}, {hits} impacts, slowest {case.story.slowest:.2g}, {case.draw}")
    return rows


def _of_impacts(case, near, slope):
    """The largest error of the derivatives of some impacts that both know, over the largest of their row or 1."""
    worst = 0.0
    for time_, true in rest_slopes.impacts(case.draw, case.story, near, ROWS).items():
        k = int(np.argmin(abs(near - time_)))
        found = slope[[2 + k, 2 + RECORDED + k]]
        worst = max(worst, (abs(found - true).max(1) / np.maximum(abs(true).max(1), 1)).max())
    return worst


def _rank(matrix):
    return np.linalg.matrix_rank(matrix, tol=1e-9 * max(1.0, abs(matrix).max())) if np.isfinite(matrix).all() else -1


def second(count, seed):
    """Prints the largest errors of second derivatives along a direction, over 1 + the largest."""
    rng = np.random.default_rng(seed)
    for structure in ((None, 1), (0, 0)):
        members, _ = cases(rng, structure, count)
        run = ends(scene_of([case.draw.scene for case in members]), 1, 4)
        points = jnp.array([slopes.numbers(case.draw) for case in members])
        ways = jnp.array(rng.normal(size=points.shape))

        def along(point, way, run=run):
            def line(s):
                return run(point + s * way)[:2]

            return jax.jacfwd(jax.jacfwd(line))(0.0)

        found = np.asarray(jax.jit(jax.vmap(along))(points, ways))
        true = np.array([rest_slopes.curvature(*case[:2], way) for case, way in zip(members, ways, strict=True)])
        errors = abs(found - true).max(1) / (1.0 + abs(true).max(1))
        for k, kind in enumerate(KINDS):
            own = errors[[case.kind == k for case in members]]
            print(f"{structure}, {kind}: {len(own)}, second derivatives {np.max(own, initial=0):.2g}", flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, number, *rest = sys.argv[1:]
    if what == "second":
        second(int(number), *map(int, rest or [2]))
    else:
        first(int(number), *map(int, rest or [1]), what)
