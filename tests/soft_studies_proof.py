"""Soft walls in every study, held against other methods: `python -m tests.soft_studies_proof exponents` and others.

exponents, basins: random scenes at k2 = 10 against tests/reference/soft_lanes.py (NumPy, closed forms, both tangents
measured), and random scenes between rigid walls against the same with k2 = 1e8 and the restitution held (`soften`).
"""

import sys
import time

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.flight.wall_positions import wall_states
from jaxvibro.maps.initial_conditions import draw_initial_states, initial_box
from tests.reference.soft_lanes import Lanes, Wall
from tests.reference.soft_lanes import exponents as measured

STIFF, SOFT = 1e8, 10.0
STARTS = 256


KINDS = [(None, "soft"), ("soft", None), ("soft", "soft"), ("soft", "moving"), ("soft", "rigid")]


def drawn(rng, soft):
    """(scene, the reference's walls): walls of one of KINDS, k2 = 10 with up to 0.3 of critical damping, or, where not
    soft, rigid ones at rest, a restitution each."""
    kinds = KINDS[rng.integers(len(KINDS) if soft else 3)]
    low, gap = -rng.uniform(0.1, 1.0), rng.uniform(0.4, 1.6)
    ours, other = [None, None], []
    for k, kind in enumerate(kinds):
        side, place = 2 * k - 1, low + k * gap if None not in kinds else rng.uniform(0.0, 0.8) * (2 * k - 1)
        bounce, angle = float(rng.uniform(0.4, 0.95)), float(rng.uniform(0, 6))
        damping = float(rng.uniform(0.0, 0.3) * (1 + SOFT) ** 0.5)
        if kind is None:
            continue
        if kind == "rigid" or not soft:
            ours[k] = jv.Wall(place, bounce)
            other.append(Wall(side, place, bounce))
            continue
        swing = 0.15 * gap
        motion = jv.Motion(swing, angle, 2) if kind == "moving" else None
        ours[k] = jv.Wall(place, stiffness=SOFT, damping=damping, motion=motion)
        other.append(Wall(side, place, None, SOFT, damping, *((swing, 2, angle) if motion else ())))
    amplitude, frequency = float(rng.uniform(0.5, 3.0)), float(rng.uniform(1.2, 4.0))
    gamma = float(rng.uniform(0.005, 0.06))
    return jv.make_scene(amplitude, frequency, gamma, 0.7, tuple(ours)), other


def chaotic(scene):
    """Whether a short look says that the motion from the middle does not recur."""
    short = jv.spectrum(scene, "amplitude", [float(scene.amplitude)], middle(scene), error=0.05, most=1)
    return bool(short.periods[0] == 0 and short.exponent[0, 0] > 0.03)


def middle(scene):
    """A start between the walls."""
    (low, _), (high, _) = wall_states(scene, 0.0)
    low, high = max(float(low), -1.0), min(float(high), 1.0)
    return jv.State(0.5 * (low + high), 0.2)


def scenes(seed, soft, count, most=400):
    """So many scenes, half of them chaotic."""
    found = {False: [], True: []}
    for k in range(most):
        scene, other = drawn(np.random.default_rng([seed, k]), soft)
        kind = chaotic(scene)
        if len(found[kind]) < count // 2:
            found[kind].append((scene, other))
        if all(len(each) == count // 2 for each in found.values()):
            break
    return found[False] + found[True]


def longest(scene, other, periods, settle=300, count=STARTS):
    """(exponents, standard errors, impacts, time within) of the reference, at the scene's amplitude."""
    start, rng = middle(scene), np.random.default_rng(1)
    x, v = np.full(count, start.x), start.v + 1e-7 * rng.normal(size=count)
    numbers = float(scene.amplitude), float(scene.frequency), float(scene.damping)
    growth, hits, within = measured(Lanes(*numbers, other, x, v), periods, settle)
    error = np.maximum(growth.std(axis=0, ddof=1) / count**0.5, 1.0 / periods)
    return growth.mean(axis=0), error, hits.mean(axis=1), within.mean(axis=1)


def exponents(count=12, periods=240):
    """Print both tables."""
    print("k2 = 10: A, ours, error, the reference's, error, difference in errors, time within of both")
    worst, off, bars = 0.0, 0.0, 0.0
    for scene, other in scenes(70, True, count):
        own = jv.spectrum(scene, "amplitude", [float(scene.amplitude)], middle(scene))
        rates, errors, _, within = longest(scene, other, periods)
        pulls = (own.exponent[0].values - rates) / np.hypot(own.error[0].values, errors)
        length = 2 * np.pi / float(scene.frequency)
        total = -2 * float(scene.damping) * length
        for k, side in enumerate(("left", "right")):
            wall = getattr(scene, side)
            if wall is not None and wall.soft:
                total -= 2 * float((wall.damping - scene.damping) * own.within[0, k])
            elif wall is not None:
                total += 2 * float(np.log(wall.restitution) * own.impacts_on[0, k])
        off = max(off, abs(float(own.exponent[0].sum()) - total))
        worst, bars = max(worst, abs(pulls).max()), max(bars, float(own.error.max()))
        print(
            f"{float(scene.amplitude):7.4f}",
            *(each.round(5) for each in (own.exponent[0].values, own.error[0].values)),
            rates.round(5),
            errors.round(5),
            pulls.round(2),
            own.within[0].values.round(4),
            within.round(4),
            f"periods {int(own.periods[0])}",
            flush=True,
        )
    print(f"largest difference {worst:.2f} errors, largest error of ours {bars:.5f}, sum rule kept to {off:.1e}")
    print("k2 = 1e8 against rigid: A, rigid, error, soft, error, difference in errors")
    worst, apart = 0.0, 0.0
    for scene, _ in scenes(71, False, count):
        both = [
            jv.spectrum(one, "amplitude", [float(one.amplitude)], middle(one))
            for one in (scene, jv.soften(scene, STIFF))
        ]
        (a, ea), (b, eb) = ((one.exponent[0].values, one.error[0].values) for one in both)
        if int(both[0].periods[0]) == 0:
            pulls = (b - a) / np.hypot(ea, eb)
            worst = max(worst, abs(pulls).max())
        else:
            pulls = b - a
            apart = max(apart, abs(pulls).max())
        print(
            f"{float(scene.amplitude):7.4f}",
            *(each.round(5) for each in (a, ea, b, eb)),
            pulls.round(5),
            f"periods {int(both[0].periods[0])} {int(both[1].periods[0])}",
            flush=True,
        )
    print(f"chaotic: largest difference {worst:.2f} errors; periodic: {apart:.1e}")


def settled(scene):
    """The attractors, where they are several periodic ones with a tenth of the starts each, else None."""
    state, _ = jv.strobe(scene, draw_initial_states(scene, 64, 0), 600)
    later, apart = state, np.full(64, np.inf)
    for _ in range(8):
        later, _ = jv.strobe(scene, later)
        apart = np.minimum(apart, np.hypot(later.x - state.x, later.v - state.v))
    if not (apart < 1e-6).all() or np.ptp(np.asarray(state.x)) < 1e-3:
        return None
    found = jv.find_attractors(scene, starts=60)
    kinds = {one.kind for one in found}
    return found if kinds == {"periodic"} and sum(one.share > 0.1 for one in found) > 1 else None


def bistable(seed, soft, count, most=400):
    """So many (scene, the reference's walls, attractors) of several."""
    found = []
    for k in range(most):
        scene, other = drawn(np.random.default_rng([seed, k]), soft)
        attractors = settled(scene)
        if attractors is not None:
            found.append((scene, other, attractors))
        if len(found) == count:
            break
    return found


def grid(scene, side):
    """(x, v) of a picture's starts, past soft walls too."""
    left, right, fast = map(float, initial_box(scene))
    soft = scene.soft_sides
    more = 0.4 * (right - left)
    low, high = left - more * ("left" in soft), right + more * ("right" in soft)
    return np.linspace(low, high, side + 2)[1:-1], np.linspace(-fast, fast, side)


def nearest(data, x, v):
    """(place of the attractor with the nearest point, distance to it)."""
    points = np.stack([data["point_x"].values, data["point_v"].values], -1)
    apart = abs(np.stack([x, v], -1)[:, None, None] - points).max(axis=-1)
    apart = np.where(np.isnan(apart), np.inf, apart).min(axis=-1)
    return apart.argmin(axis=1), apart.min(axis=1)


def basins(count=6, side=100):
    """Print how many labels are equal, k2 = 10 against the reference, 1e8 against rigid walls."""
    print("k2 = 10: attractors, starts within a wall, unresolved, labels equal to the reference's")
    least = 1.0
    for scene, other, attractors in bistable(72, True, count):
        x, v = grid(scene, side)
        data = jv.basins(scene, x, v, 0.0, attractors)
        label = data["label"].values.ravel()
        across, along = (each.ravel() for each in np.meshgrid(x, v))
        some = label != -2
        numbers = float(scene.amplitude), float(scene.frequency), float(scene.damping)
        lanes = Lanes(*numbers, other, across[some], along[some])
        within = float((lanes.mode != 0).mean())
        for _ in range(300):
            lanes.period()
        place, apart = nearest(data, lanes.x, lanes.v)
        sure = (label[some] >= 0) & (apart < 1e-4)
        equal = float((place == label[some])[sure].mean())
        least = min(least, equal)
        print(
            [one.label for one in attractors],
            f"{within:.3f} {float((label == -1).mean()):.4f} {equal:.5f}",
            f"of {int(sure.sum())} of {sure.size}",
            flush=True,
        )
    print(f"least {least:.5f}")
    print("k2 = 1e8 against rigid: attractors, labels equal")
    least = 1.0
    for scene, _, _ in bistable(73, False, count):
        x, v = grid(scene, side)
        stiff = jv.soften(scene, STIFF)
        data, other = jv.basins(scene, x, v), jv.basins(stiff, x, v)
        if len(other["name"]) != len(data["name"]):
            print("attractors differ:", list(data["name"].values), list(other["name"].values))
        first = other["point_x"].values[:, 0], other["point_v"].values[:, 0]
        same, _ = nearest(data, *first)
        there = other["label"].values
        equal = float((np.where(there >= 0, same[np.maximum(there, 0)], there) == data["label"].values).mean())
        least = min(least, equal)
        print(
            list(data["name"].values),
            list(other["name"].values),
            f"{equal:.5f}",
            f"boundary entropy {data.attrs['basin_entropy']:.3f}",
            flush=True,
        )
    print(f"least {least:.5f}")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    began = time.perf_counter()
    {"exponents": exponents, "basins": basins}[sys.argv[1]](*map(int, sys.argv[2:]))
    print(f"{time.perf_counter() - began:.0f} s")
