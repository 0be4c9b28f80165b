"""The library with soft walls held against the references over random scenes.

`python -m tests.soft_proof strobe 2000 FOLDER 2` prints the strobe's errors, `... monodromy 500 FOLDER` those of its
derivatives, `... reference 2000 FOLDER 2` only keeps the references in the folder, which all of them read. The folder
may be left out; the last number is of the processes that compute what is not kept there.
"""

import sys
from collections import Counter, defaultdict
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from tests.proof import SLOTS, batch
from tests.reference import stored
from tests.reference.scene import Soft

WORST = 6  # draws named
TINY = 1e-20  # a derivative that dies out is not asked for to eleven digits
LATE = 1e-6  # an entry's time may be off by so much of the scale over its speed, whatever the bound says


class Row(NamedTuple):
    """One draw's errors, those of lengths and speeds over the bound; inf where the itinerary is wrong.

    The bound is 1e-12 scale (1 + norm), for sharp with the sharp norm (`soft.Record`). times: in t.
    """

    seed: int
    right: bool
    state: float
    sharp: float
    times: float
    speeds: float
    clearance: float
    status: int
    count: int


def structure(scene):
    """What of a scene is static: of each wall its kind and its harmonic, 0 where it stands still."""
    return tuple(
        None if wall is None else (isinstance(wall, Soft), wall.motion.harmonic if wall.motion else 0)
        for wall in (scene.left, scene.right)
    )


def groups(count, folder=None, workers=1, kinds=None):
    """(the first Kept references, a list a structure, and why draws were refused); kinds: of these structures only."""
    found, refused = stored.fair(count, folder, workers)
    members = defaultdict(list)
    for each in found:
        if kinds is None or structure(each.draw.scene) in kinds:
            members[structure(each.draw.scene)].append(each)
    return list(members.values()), refused


def strobe_rows(members):
    """A Row for each reference of one structure."""
    end, impacts = jv.strobe(*batch([each.draw for each in members]), slots=SLOTS, clearance=True)
    x, v, side, time, speed = map(np.asarray, (end.x, end.v, impacts.side, impacts.time, impacts.speed))
    least, status = np.asarray(impacts.least_clearance), np.asarray(impacts.status)
    rows = []
    for k, true in enumerate(members):
        bound, fine = (1e-12 * true.scale * (1 + norm) for norm in (true.norm, true.sharp))
        late = np.array([stored.less(t, time[k, i]) for i, t in enumerate(true.times)])
        fast = np.array([stored.less(s, speed[k, i]) for i, s in enumerate(true.speeds)])
        sides = [int(s) for s in side[k] if s]
        right = status[k] == 0 and sides == true.sides and bool(np.all(np.isfinite(late)))
        size = abs(late) * [float(s) for s in true.speeds]
        right = bool(right and np.all(size <= max(LATE * true.scale, bound)))
        error = max(abs(stored.less(true.x, x[k])), abs(stored.less(true.v, v[k]))) if np.isfinite(x[k]) else np.inf
        far = [abs(each).max(initial=0.0) if right else np.inf for each in (late, fast)]
        close = 0.0 if least[k] == true.least_minimum else abs(least[k] - true.least_minimum)
        errors = error / bound, error / fine, far[0], far[1] / bound, close / bound
        rows.append(Row(true.seed, right, *errors, int(status[k]), true.count))
    return rows


def slope_errors(members):
    """{way: (seed, error, fine error) of each reference's d(x, v)/d(x, v)} of one structure.

    error: over the product of the factors' norms; fine: over the compact one, x counted as there
    (`soft.Record`)."""
    scene, start = batch([each.draw for each in members])
    lanes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(members),)), scene)

    def forward(scene, start):
        slopes, _ = jax.jacfwd(jv.strobe, argnums=1, has_aux=True)(scene, start)
        return jnp.array([[slopes.x.x, slopes.x.v], [slopes.v.x, slopes.v.v]])

    free = jv.State(start.x, start.v, start.phase, jnp.zeros_like(start.x))
    return {
        "monodromy": _slopes(members, np.asarray(jv.monodromy(scene, start, slots=SLOTS))),
        "jacfwd": _slopes(members, np.asarray(jax.jit(jax.vmap(forward))(lanes, free))),
    }


def _slopes(members, found):
    """(seed, error, fine error) of each."""
    rows = []
    for true, matrix in zip(members, found, strict=True):
        far = np.full((2, 2), np.inf)
        if np.all(np.isfinite(matrix)):
            far = np.array([[abs(stored.less(true.jacobian[i][j], matrix[i, j])) for j in (0, 1)] for i in (0, 1)])
        begin, finish = true.counts
        fine = far * [[finish / begin, finish], [1 / begin, 1]]
        rows.append((true.seed, far.max() / max(true.product, TINY), fine.max() / max(true.compact, TINY)))
    return rows


def print_strobe(parts):
    """The strobe's numbers."""
    rows = [row for members in parts for row in strobe_rows(members)]
    right, wrong = ([row for row in rows if row.right is which] for which in (True, False))
    statuses = dict(Counter(row.status for row in wrong))
    print(f"strobe: {len(rows)} draws, entries and impacts a draw {np.mean([row.count for row in rows]):.2f}")
    print(f"itineraries wrong: {len(wrong)}, their statuses {statuses}, seeds {[row.seed for row in wrong[:20]]}")
    for name in ("state", "sharp", "speeds", "times", "clearance"):
        worst = sorted(right, key=lambda row: -getattr(row, name))[:WORST]
        over = "" if name == "times" else f", {sum(getattr(row, name) > 1 for row in right)} over the bound"
        named = ", ".join(f"{getattr(row, name):.3g} (seed {row.seed})" for row in worst)
        print(f"{name}{over}; worst {named}")


def print_slopes(parts):
    """The derivatives' numbers."""
    found = [slope_errors(members) for members in parts]
    for way in found[0] if found else ():
        rows = [row for each in found for row in each[way]]
        for k, name in ((1, "product"), (2, "compact product")):
            worst = sorted(rows, key=lambda row: -row[k])[:WORST]
            named = ", ".join(f"{row[k]:.3g} (seed {row[0]})" for row in worst)
            print(f"{way}: {len(rows)} draws, {sum(row[k] > 1e-11 for row in rows)} over 1e-11 of the {name}; {named}")


def main(what, count, folder=None, workers=1):
    """Print one row of the table."""
    jax.config.update("jax_enable_x64", True)
    parts, refused = groups(count, folder, workers)
    print(f"{count} references; refused {dict(refused)}", flush=True)
    if what == "strobe":
        print_strobe(parts)
    if what == "monodromy":
        print_slopes(parts)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), *sys.argv[3:4], *map(int, sys.argv[4:5]))
