"""A status is never better than the state, over random scenes: `python -m tests.status_proof lanes 10000000`.

`lanes` draws walls that stand still or move, rigid ones and soft ones, R from 0 to 1, gamma from 0 to 3, omega from
0.05 to 20, A to 1e3, gaps from 1e-6 to 3, and counts the lanes whose state is not finite, or lies beyond a rigid wall,
with a good status, and those with a state and a bad one. `caps 100000` does the same for lanes in short gaps, until so
many have reached the cap.
"""

import sys

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.scene.codes import Status
from tests.degenerate_proof import wall_places
from tests.lanes import at

BLOCK = 1 << 16  # lanes of a scene
ROUNDINGS = 64.0  # of the largest length, by which a state may be beyond a wall
# of each wall: None, or whether it is soft and its harmonic, 0 where it stands still
RIGID = (
    (None, None),
    ((False, 0), None),
    (None, (False, 1)),
    ((False, 0), (False, 0)),
    ((False, 0), (False, 1)),
    ((False, 2), (False, 3)),
)
SOFT = (((True, 0), (False, 1)), ((False, 0), (True, 1)), (None, (True, 0)))
KINDS = RIGID + SOFT


def draw(rng, count, kind, short=False):
    """(scene, start) of random lanes with walls of a kind; short: nearly elastic ones, with little room."""

    def logarithmic(low, high):
        return 10.0 ** rng.uniform(low, high, count)

    def some(values, share, *instead):
        return np.where(rng.random(count) < share, rng.choice(instead, count), values)

    gap, phase = logarithmic(-5.0 if short else -6.0, -1.0 if short else 0.5), rng.uniform(0.0, 2.0 * np.pi, count)
    place, walls, ends = rng.choice([0.0, -1.0, 0.3], count) * rng.random(count), [], []
    for side, given in zip((-1.0, 1.0), kind, strict=True):
        if given is None:
            walls.append(None)
            ends.append(place + 0.5 * side * gap)
            continue
        soft, harmonic = given
        swing = gap * rng.uniform(0.0, 3.0, count) if harmonic else np.zeros(count)
        turn, where = rng.uniform(0.0, 2.0 * np.pi, count), place + side * (0.5 * gap + swing)
        motion = jv.Motion(swing, turn, harmonic) if harmonic else None
        bounce = some(rng.uniform(0.9, 1.0, count) if short else rng.random(count), 0.2, 1.0, 1.0 if short else 0.0)
        own = {"restitution": bounce}
        if soft:
            own = {"stiffness": logarithmic(0.0, 6.0), "damping": rng.random(count)}
        walls.append(jv.Wall(where, motion=motion, **own))
        ends.append(where + swing * np.cos(harmonic * phase + turn))
    amplitude, omega = logarithmic(0.0 if short else -3.0, 3.0), logarithmic(np.log10(0.05), np.log10(20.0))
    scene = jv.make_scene(amplitude, omega, some(rng.uniform(0.0, 3.0, count), 0.2, 0.0, 1.0), 0.5, tuple(walls))
    share = some(rng.random(count), 0.1, 0.0, 1.0)
    x = np.clip(ends[0] + share * (ends[1] - ends[0]), *ends)
    speed = logarithmic(-2.0, 1.0) * some(1.0, 0.02, 0.0, 1e-100, 1e-300)
    start = jv.State(x, speed * rng.choice([-1.0, 1.0], count), phase, np.zeros(count))
    order = np.argsort(gap * omega / (amplitude + abs(x) + speed))  # lanes of a block wait for each other
    return at((scene, start), order)


def beyond(scene, end):
    """How far the states are beyond a rigid wall, in roundings of the largest length; 0 where they are not."""
    worst = np.zeros(scene.shape)
    for sign, where, largest in wall_places(scene, np.asarray(end.phase)):
        size = np.asarray(scene.amplitude) + largest
        far = sign * (np.asarray(end.x) - where) / (np.finfo(scene.dtype).eps * size)
        worst = np.maximum(worst, far)
    return worst


def judged(scene, end, status):
    """Masks of lanes: (beyond a wall with a good status, nan with a good status, a state with a bad one)."""
    x, v, good = np.asarray(end.x), np.asarray(end.v), np.asarray(status) < Status.CAP
    finite = np.isfinite(x) & np.isfinite(v)
    return good & (beyond(scene, end) > ROUNDINGS), good & ~finite, ~good & ~(np.isnan(x) & np.isnan(v))


def main(what, count):
    """Print the counts, a line a kind of scene and one of all."""
    jax.config.update("jax_enable_x64", True)
    rng, kinds, total = np.random.default_rng(17), RIGID[1:] if what == "caps" else KINDS, np.zeros(9, int)
    for k, kind in enumerate(kinds):
        wanted, own = (count + k) // len(kinds), np.zeros(9, int)
        while own[4 if what == "caps" else 0] < wanted:
            scene, start = draw(rng, BLOCK, kind, what == "caps")
            end, impacts = jv.strobe(scene, start, slots=0)
            status = np.asarray(impacts.status)
            wrong = [each.sum() for each in judged(scene, end, status)]
            own += [len(status), *wrong, *np.bincount(status, minlength=5)[[2, 0, 1, 3, 4]]]
        total += own
        print(kind, told(own), flush=True)
    print("all", told(total))


def told(row):
    """A row of counts in words."""
    lanes, far, blank, false, cap, ok, full, invalid, endless = row
    wrong = f"beyond a wall with a good status {far}, nan with a good one {blank}, a state with a bad one {false}"
    return f"{lanes} lanes: {wrong}; ok {ok}, full {full}, cap {cap}, invalid {invalid}, nonfinite {endless}"


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
