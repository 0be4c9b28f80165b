"""How grazings come nearer to complete chatter: `python -m tests.cascade_proof [scenes a R [R ...]]`.

Towards a CH a branch has ever more hops, each born in a grazing. What is left to the CH shrinks by mu a hop, which R
alone decides; printed is how far the ratio of the grazings of random scenes is from it, extrapolated, and how far the
CH itself is from hops of 80 digits. Next to the point ratios differ from mu by powers of the time left (lam a hop) and
of the parameter (1 / mu a hop), where the orbit rests elsewhere and so comes there the same way each time. These are
taken out one by one, by what they shrink by (Richardson).
"""

import sys
from itertools import product

import jax
import numpy as np

import jaxvibro as jv
from tests.rest_proof import halved, resting

FEWEST = 7  # grazings
TERMS = 4  # of what ratios differ by, that are taken out
NEAR = 0.3  # of mu: from the first ratio on that is as near


def scaling(restitution):
    """(lam, mu) of hops next to a CH."""
    roots = np.roots(np.polyadd(np.polymul([1.0, 1.0], [9.0, -6.0, 1.0]), [-8.0 * restitution, 0.0]))
    (q,) = [root.real for root in roots if abs(root.imag) < 1e-12 and 1.0 / 3.0 < root.real < 1.0]
    return (3.0 * q - 1.0) / 2.0, (1.0 + q) ** 2 / (2.0 * q**2 * (3.0 * q - 1.0))


def extrapolated(ratios, lam, mu):
    """The limit of ratios whose differences from it are powers of lam and of 1 / mu a hop."""
    powers = sorted({lam**i / mu**k for i, k in product(range(TERMS), range(TERMS)) if i + k}, reverse=True)
    for power in powers[: min(TERMS, len(ratios) - 3)]:
        ratios = (ratios[1:] - power * ratios[:-1]) / (1.0 - power)
    return ratios[-1]


def cascades(restitution, seed):
    """(a CH of a branch, the ratios of its grazings) of random scenes, orbits that rest elsewhere too."""
    for scene, _ in resting(np.random.default_rng(seed)):
        own = [f"{side}.restitution" for side, wall in scene.walls.items() if wall and wall.restitution is not None]
        scene = scene.replace(restitution=restitution, **dict.fromkeys(own, restitution))
        value = float(scene.amplitude)
        try:
            orbit = jv.find_orbit(scene, jv.State(float(scene.right.position) - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if not orbit.rests or orbit.periods > 2:
            continue
        branch = jv.follow(orbit, "amplitude", (0.3 * value, 1.6 * value))
        for place, point in enumerate(branch.special):
            for side in (branch.special[:place][::-1], branch.special[place + 1 :]) if point.kind == "CH" else ():
                ratios = next_to(point, side, scaling(restitution)[1])
                if len(ratios) >= FEWEST - 1:
                    yield point, ratios


def next_to(point, side, mu):
    """The ratios of the grazings between a CH and the next one, of the special points from it on to one side."""
    ended = next((k for k, one in enumerate(side) if one.kind == "CH"), len(side))
    left = np.array([one.value - point.value for one in side[:ended] if one.kind == "GR" and not one.multipliers.any()])
    ratios = left[1:] / left[:-1]  # from the CH on
    far = np.flatnonzero(abs(ratios / mu - 1.0) > NEAR)
    return ratios[: far[0] if len(far) else None][::-1]


def main(count=2, *percents):
    """Prints a line for each of so many scenes with each R, given in hundredths."""
    for restitution in percents or (30, 50, 40, 60, 70):
        lam, mu = scaling(restitution / 100.0)
        for k, (point, ratios) in enumerate(cascades(restitution / 100.0, 6), 1):
            off = extrapolated(ratios, lam, mu) / mu - 1.0
            print(
                f"R {restitution / 100.0}: mu {mu:.7f}, {len(ratios) + 1} grazings, last ratio off by "
                f"{ratios[-1] / mu - 1.0:.1e}, extrapolated by {off:.1e}; {point.label} at {point.value:.12g}, "
                f"off by {abs(point.value - halved(point)):.1e}",
                flush=True,
            )
            if k == count:
                break


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(*(int(each) for each in sys.argv[1:]))
