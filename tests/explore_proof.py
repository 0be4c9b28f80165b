"""Whether what many starts settle on is on a branch: `python -m tests.explore_proof WHICH [STARTS] [VALUES]`.

WHICH: a name in SCENES, or all. At each of so many values of the amplitude, `find_attractors` from so many starts; each
periodic attractor up to MOST periods must be on a branch of `explore`.
"""

import sys
import time

import jax
import numpy as np

import jaxvibro as jv
from tests.test_explore import is_on

MOST = 8
SCENES = {
    "fig4": ((2.1, 0.05, 0.7, (-1.0, 1.0)), (0.0, 6.0)),
    "fig4 R .5": ((2.1, 0.05, 0.5, (-1.0, 1.0)), (0.0, 6.0)),
    "fig4 R .3": ((2.1, 0.05, 0.3, (-1.0, 1.0)), (0.0, 6.0)),
    "faster": ((2.3, 0.05, 0.7, (-1.0, 1.0)), (0.0, 7.0)),
    "uneven": ((2.1, 0.05, 0.7, (-1.5, 1.0)), (0.0, 7.0)),
    "one": ((2.1, 0.05, 0.7, (None, 1.0)), (0.0, 6.0)),
    "moving": ((2.1, 0.05, 0.7, (-1.0, jv.Wall(1.0, None, motion=jv.Motion(0.1, 0.5)))), (0.0, 6.0)),
    "hard": ((2.1, 0.2, 0.9, (-1.0, 1.0)), (0.0, 6.0)),
}


def proof(which, starts, values):
    numbers, (low, high) = SCENES[which]
    scene = jv.make_scene(2.0, *numbers)
    began = time.perf_counter()
    diagram = jv.explore(scene, "amplitude", (low, high), MOST)
    spent = time.perf_counter() - began
    labels = " ".join(dict.fromkeys(part.label for one in diagram.branches for part in one.segments))
    print(f"{which}: {len(diagram)} branches in {spent:.0f} s, {diagram.reason}: {labels[:300]}", flush=True)
    seen, missed = 0, 0
    for value in np.linspace(low, high, values + 2)[1:-1]:
        for one in jv.find_attractors(scene.replace(amplitude=value), starts, 5):
            if not 0 < one.periods <= MOST:
                continue
            seen += 1
            if one.orbit is None or not is_on(one.orbit, diagram):
                missed += 1
                print(f"  not on a branch: {one.label} at {value:.6g}, share {one.share:.3f}", flush=True)
    print(f"{which}: {seen} periodic attractors at {values} values from {starts} starts, {missed} not on a branch")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    which, *rest = sys.argv[1:]
    for each in SCENES if which == "all" else [which]:
        proof(each, *(int(one) for one in [*rest, 200, 30][:2]))
