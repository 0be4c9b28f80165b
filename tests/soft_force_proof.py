"""Soft walls beside forces of one's own, proved at length: `python -m tests.soft_force_proof 500` prints numbers.

Scenes of each law beside Duffing's spring, against series by hand in 34 digits; a name after the number takes one law.
"""

import sys

import jax
import mpmath
import numpy as np

import jaxvibro as jv

from .reference import soft_force

jax.config.update("jax_enable_x64", True)

TOLERANCES = 1e-12, 1e-9, 1e-6
DEPTH = 100.0  # tolerances, times scale and growth: so near a wall a flight is left out


def drawn(count, law, seed=0):
    """(the force's numbers, the law's, (left, right, amplitude, frequency), states) of scenes with two soft walls."""
    rng = np.random.default_rng(seed)
    force = {"cubic": rng.uniform(-0.3, 3.0, count), "damping": rng.uniform(0.0, 1.0, count)}
    stiffness = 10.0 ** rng.uniform(0.0, 4.0, count)
    numbers = {"stiffness": stiffness}
    if law == "linear":
        numbers["damping"] = rng.uniform(0.0, 0.8, count) * np.sqrt(stiffness)
    if law == "hunt_crossley":
        numbers["dissipation"] = rng.uniform(0.0, 1.0, count)
    left = rng.uniform(-1.5, -0.3, count)
    right = left + rng.uniform(0.6, 2.5, count)
    plain = left, right, rng.uniform(0.0, 4.0, count), rng.uniform(0.6, 4.0, count)
    return force, numbers, plain, jv.State(rng.uniform(left + 0.02, right - 0.02), rng.normal(size=count))


def scene(force, law, numbers, plain, tolerance):
    """The scenes of these numbers."""
    own = numbers if law == "linear" else {"law": jv.Push(law, numbers)}
    walls = tuple(jv.Wall(place, **own) for place in plain[:2])
    return jv.make_scene(*plain[2:], restitution=0.5, walls=walls, force=jv.Force("duffing", force, tolerance))


def compared(law, count, tolerances=TOLERANCES, digits=34, seed=0):
    """For each tolerance: (scenes seen, wrong itineraries, the largest error over what is allowed)."""
    force, numbers, plain, state = drawn(count, law, seed)
    scenes = [scene(force, law, numbers, plain, each) for each in tolerances]
    found = [jax.tree.map(np.asarray, jv.strobe(each, state, slots=64)) for each in scenes]
    norm = abs(np.asarray(jv.monodromy(scenes[0], state, slots=64))).max(axis=(1, 2))
    seen, wrong, worst = ([0] * len(tolerances) for _ in range(3))
    with mpmath.workdps(digits):
        for k in range(count):
            own, law_own = ({name: each[k] for name, each in given.items()} for given in (force, numbers))
            given = plain[2][k], plain[3][k], (plain[0][k], plain[1][k]), state.x[k], state.v[k]
            laws = soft_force.duffing, own, soft_force.LAWS[law], law_own
            (x, v), met, slowest, nearest = soft_force.flown(*laws, *given)
            size = max(abs(float(x)), abs(float(v)), abs(float(state.v[k])), 2.5 + plain[2][k])
            for place, (tolerance, (end, hits)) in enumerate(zip(tolerances, found, strict=True)):
                unit = tolerance * size * (1.0 + norm[k])
                if not min(nearest, slowest**2 / (2 * size)) > DEPTH * unit:
                    continue
                seen[place] += 1
                if [side for _, side, _ in met] != hits.side[k][hits.side[k] != 0].tolist() or hits.status[k]:
                    wrong[place] += 1
                    continue
                error = max(abs(float(end.x[k]) - x), abs(float(end.v[k]) - v)) / (20 * unit)
                worst[place] = max(worst[place], float(error))
    return list(zip(seen, wrong, worst, strict=True))


def main(count, *laws):
    """Print what is compared of so many scenes of each law."""
    for law in laws or soft_force.LAWS:
        for tolerance, (seen, wrong, worst) in zip(TOLERANCES, compared(law, count), strict=True):
            told = f"{seen} of {count} scenes seen, {wrong} wrong itineraries, largest error {worst:.2g} of the allowed"
            print(f"{law}, tolerance {tolerance:g}: {told}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
