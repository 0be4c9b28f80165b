"""Loci that leave points of codimension two of random scenes: `python -m tests.codim2_proof WHAT N [seed]`.

tangent: at N resonant grazings of one wall the SN and the PD beside the GR, against closed forms. switched, folded: at
N RG, at N GPD and DSB the loci that leave, a point of each against a special point of a branch. third: at N
nonhyperbolic grazings the curves that leave, their exponent, and every point in 40 digits.
"""

import sys
import time
from functools import partial

import jax
import mpmath
import numpy as np

import jaxvibro as jv
from tests.branch_proof import branches
from tests.locus_proof import error, plain, theirs
from tests.reference import closed
from tests.reference import special as reference
from tests.reference.codim import codim

PAIR = ("amplitude", "frequency")
GAPS, NARROW = (1e-3, 1e-4), (1e-4, 1e-3, 1e-2)
FIRST = 1e-3  # a shorter step from where curves cross is rounding
SHORT = (1e-4, 1e-5)  # gaps where curves leave with a speed
SLOW = 1e-9  # an impact as slow has no speed
SEEN = 1e-9  # a distance of curves, to three digits or so
NEAR = 1e-6  # of the parameter: special points as near are one
MOST = 4  # impacts of an orbit


def resonance(gamma, restitution, wall, m, n=1):
    """(frequency, coefficient of SN, of PD) of the resonant grazing of P(n)01: A - A_GR is a coefficient times the
    square of the way from there in frequency.

    With E the free flow over n periods, an impact of speed u is met again for A = sqrt(D) (s - a u + b^2 u^2 / (2 s
    omega^2)), with a and b of `closed.coefficients`; a is zero where sin(r T) is. At SN dA/du = 0, at PD det(M + I).
    """
    gamma, r, s = mpmath.mpf(gamma), mpmath.mpf(restitution), mpmath.mpf(wall)
    omega = 2 * n * mpmath.sqrt(1 - gamma**2) / m
    turn = (-1) ** m * mpmath.exp(-gamma * 2 * mpmath.pi * n / omega)
    push = 2 * mpmath.pi * n * (1 + r) * turn / omega
    root = mpmath.sqrt(closed.denominator(gamma, omega))
    fold = -s * root / 2 * (push / ((1 - turn) * (1 + r * turn))) ** 2
    lean = 1 / (1 - r * turn) ** 2
    doubling = s * root * (push / (1 - turn)) ** 2 * (lean + (1 + r * turn) ** 2 * lean**2 / 2)
    return omega, fold, doubling


def gaps(point, name, sizes=GAPS):
    """{kind: [(gap, the first parameter, the second)]} of the loci that leave a point, where a parameter is a gap from
    the point's."""
    found, axis = {}, list(point.values).index(name)
    for gap in sizes:
        low, high = (point.values[name] + way * gap for way in (-1.0, 1.0))
        for locus in jv.switch(point, point.bounds | {name: (low, high)}, first_step=max(FIRST, 0.1 * gap)):
            if locus.values[-1, axis] in (low, high):
                found.setdefault(locus.kind, []).append((gap, *locus.values[-1].tolist()))
    return found


def exponent(away):
    """Of two curves' distances by the gap from where they meet: between the first two gaps."""
    (gap, far), (nearer, near) = away[:2]
    return np.log(far / near) / np.log(gap / nearer)


def tangent(count, seed):
    """Exponents and coefficients at resonant grazings of one wall, then exponents of random scenes."""
    rng, worst, power = np.random.default_rng(seed), 0.0, 0.0
    for k in range(count):
        gamma, restitution, wall = rng.uniform((0.01, 0.3, 0.3), (0.4, 0.95, 2.0))
        m = int(rng.integers(1, 4))
        with mpmath.workdps(40):
            omega, *true = resonance(gamma, restitution, wall, m)
        span = {"amplitude": (0.0, 30.0), "frequency": (0.9 * float(omega), 1.1 * float(omega))}
        scene = jv.make_scene(1e-3, 0.95 * float(omega), gamma, restitution, (None, wall))
        branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 30.0), stop="GR")
        (point,) = jv.locus(branch.points("GR")[0], PAIR, span).points("RG")
        off = abs(point.values["frequency"] - float(omega))
        told = [f"{k} gamma {gamma:.3f} R {restitution:.3f} m {m}: place off by {off:.1e};"]
        beside = gaps(point, "frequency", SHORT)
        for kind, coefficient in zip(("SN", "PD"), true, strict=True):
            with mpmath.workdps(30):
                away = [(gap, float(value - closed.grazing(gamma, edge, wall))) for gap, value, edge in beside[kind]]
                shares = [far / gap**2 / float(coefficient) for gap, far in away]
            slope = exponent(away)
            limit = (10.0 * shares[1] - shares[0]) / 9.0
            worst, power = max(worst, abs(limit - 1.0), off), max(power, abs(slope - 2.0))
            told.append(f"{kind} exponent {slope:.4f}, coefficient over the closed form {limit:.7f};")
        print(*told, flush=True)
    print(f"{count} RG of one wall: exponents within {power:.4f} of 2, coefficients within {worst:.1e}")


def points(rng, kinds):
    """`Codim2`s of these kinds on loci of random scenes, the orbits of few impacts."""
    for branch, _ in branches(rng, 10_000):
        if branch.name != "amplitude":
            continue
        others = [one for point in branch.points("SB") for one in jv.switch(point)[:1]]
        begun = [one for each in (branch, *others) for one in each.special if one.kind in ("GR", "PD", "SB", "SN")]
        for special in begun:
            if len(special.spot.times) > MOST:
                continue
            second = "frequency" if rng.random() < 0.6 else str(rng.choice(["damping", "restitution"]))
            value = float(special.scene.parameter(second))
            own = {
                "frequency": (0.5 * value, 1.6 * value),
                "damping": (0.0, 2.0 * value + 0.2),
                "restitution": (0.05, 1.0),
            }
            bounds = {"amplitude": (0.0, 4.0 * float(special.value) + 1.0), second: own[second]}
            try:
                locus = jv.locus(special, ("amplitude", second), bounds)
            except jv.ArgumentError as why:
                print("  refused:", str(why)[:90])
                continue
            for point in locus.special:
                if (point.kind, point.on) in kinds and min(point.spot.speeds, default=1.0) >= -1e-9:
                    yield point


RESONANT = {("RG", "GR")}
SINGULAR = {(kind, "GR") for kind in ("SN", "PD", "SB")} | {("GR", kind) for kind in ("SN", "PD", "SB")}


def switched(count, seed, draw=None):
    """Of each locus that leaves such a point a point halfway, against the special point of a branch in one
    parameter: of one that starts lead to, or else of one from an orbit beside the point."""
    rng, done, compared, far, met, worst = np.random.default_rng(seed), 0, 0, 0, {}, 0.0
    for point in draw(rng) if draw else points(rng, RESONANT):
        began = time.perf_counter()
        try:
            loci = jv.switch(point)
        except jv.ArgumentError as why:
            print(point, "refused:", why, flush=True)
            continue
        done += 1
        for locus in loci:
            told = f"{done} {point.kind} of {point.label} {point.values} -> {locus} {locus.reasons[1]}:"
            if len(locus) < 4:
                print(told, "short", flush=True)
                continue
            place = len(locus) // 2
            found = [value for value in by_branches(locus, place) if abs(value - locus.values[place, 0]) < NEAR]
            way, found = ("far", found) if found else ("beside", by_branch_beside(locus, place))
            off = min((abs(value - locus.values[place, 0]) for value in found), default=np.inf)
            compared, far = compared + bool(found), far + (way == "far")
            met[point.kind, locus.kind] = met.get((point.kind, locus.kind), 0) + 1
            worst = max(worst, off if found else 0.0)
            print(told, f"{way}, off by {off:.1e}, ({time.perf_counter() - began:.1f} s)", flush=True)
        if done >= count:
            break
    print(f"{done} points: {compared} loci compared, {far} with branches that starts lead to; worst {worst:.1e}", met)


def degenerate(rng):
    """GPDs on loci of PD that leave resonant grazings of random scenes with one wall, and DSBs of scenes with two."""
    while True:
        gamma, restitution, wall, m = *rng.uniform((0.02, 0.5, 0.3), (0.12, 0.85, 2.0)), int(rng.integers(2, 4))
        omega = 2.0 * np.sqrt(1.0 - gamma**2) / m
        scene = jv.make_scene(1e-3, 0.97 * omega, gamma, restitution, (None, wall))
        span = {"amplitude": (0.0, 5.0 * wall), "frequency": (0.6 * omega, 1.6 * omega)}
        branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", span["amplitude"], stop="GR")
        for one in jv.locus(branch.points("GR")[0], PAIR, span).points("RG"):
            yield from (point for locus in jv.switch(one) for point in locus.points("GPD"))
        scene = jv.make_scene(1e-3, rng.uniform(0.65, 0.85), gamma, restitution, (-wall, wall))
        branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 3.0 * wall))
        span = {"amplitude": (0.0, 20.0), "frequency": (0.5, 4.0)}
        for one in branch.points("SB")[:1]:
            yield from jv.locus(one, PAIR, span).points("DSB")


def by_branches(locus, place):
    """Values of special points of a locus' kind and label on the branches that starts lead to, at its second
    parameter's value at a point."""
    scene, value = locus.located(place)[0], locus.values[place, 0]
    for start in (0.7 * value, 1.05 * value):
        try:
            orbit = jv.find_orbit(scene.replace(**{locus.names[0]: start}), jv.State(0.0, 0.0))
            if orbit.periods > 2 or orbit.impacts.count > 8:
                continue
            first = jv.follow(orbit, locus.names[0], (0.3 * value, 1.7 * value))
            more = [one for each in first.special if each.kind in ("SB", "PD") for one in jv.switch(each)]
        except (jv.OrbitError, jv.ArgumentError):
            continue
        yield from (
            one.value
            for each in (first, *more)
            for one in each.special
            if (one.kind, one.label) == (locus.kind, locus.label)
        )


def by_branch_beside(locus, place):
    """The same on the branch of an orbit whose impacts are near those at the point."""
    name, (scene, spot) = locus.names[0], locus.located(place)
    value = locus.values[place, 0]
    for way in (1e-3, -1e-3, 1e-2, -1e-2):
        there = value * (1.0 + way)
        try:
            one = jv.find_orbit(
                scene.replace(**{name: there}), locus.orbit(place).state, spot.periods, locus.special[0].itinerary, 0
            )
            branch = jv.follow(one, name, tuple(sorted((value * (1.0 - 2 * way), value * (1.0 + 2 * way)))))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        found = [each.value for each in branch.points(locus.kind) if abs(each.value - value) < NEAR]
        if found:
            return found
    return []


def third(count, seed):
    """Of each nonhyperbolic grazing how the distance of the curve that leaves tangentially from the locus of the
    point's kind grows with the way from there, and every point of that curve against the reference. At an SN the curve
    is the GR itself, and the locus of the SN is looked at."""
    rng, done, worst, power, looked, far, kinds = np.random.default_rng(seed), 0, 0.0, 0.0, 0, 0.0, {}
    for point in points(rng, SINGULAR):
        if point.on != "GR":
            point = on_grazing(point)
            if point is None:
                continue
        began = time.perf_counter()
        try:
            locus, *more = jv.switch(point)
        except jv.ArgumentError as why:
            print(point, "refused:", why, flush=True)
            continue
        curve, done = (more or [locus])[0], done + 1
        kinds[point.kind] = kinds.get(point.kind, 0) + 1
        offs = list(offsets(curve))
        slope, off = exponent(apart(point, locus)), misplaced(point)
        far = max(far, off)
        worst, power, looked = max([worst, *offs]), max(power, abs(slope - 2.0)), looked + len(offs)
        told = f"place off by {off:.1e}, exponent {slope:.4f}, {len(offs)} points off by {max(offs, default=0.0):.1e}"
        spent = time.perf_counter() - began
        print(f"{done} {point.kind} of {point.label} {point.values}: {curve}, {told} ({spent:.1f} s)", flush=True)
        if done >= count:
            break
    print(
        f"{done} points off by {far:.1e}: exponents within {power:.4f} of 2;",
        f"{looked} points of curves, the worst off by {worst:.1e}",
        kinds,
    )


def offsets(curve):
    """How far each point of a locus but its ends is off, over 1 + its value."""
    for place in range(1, len(curve) - 1):
        try:
            yield error(curve, place) / (1.0 + abs(curve.values[place, 0]))
        except ArithmeticError as why:
            print(f"  no reference of {curve} at {curve.values[place]}, {place}: {why}", flush=True)


def misplaced(point):
    """How far both parameters of a nonhyperbolic grazing on a GR are from the reference's."""
    spot, closing = point.spot, "SN" if point.kind == "SN" else "PD"
    touch = int(np.flatnonzero(spot.speeds < SLOW)[0])
    kept = np.flatnonzero(spot.speeds >= SLOW)
    before = int(np.sum(kept < touch)) - 1  # -1: it comes after the last of them
    late = float(spot.times[touch] + (before < 0) * spot.periods * 2.0 * np.pi / float(point.scene.frequency))
    times, speeds, sides = (each[kept].tolist() for each in (spot.times, spot.speeds, spot.sides))
    names, values = [theirs(point.scene, name) for name in point.values], list(point.values.values())
    given = values, times, speeds, [int(side) for side in sides], spot.periods, point.kind == "SB"
    true = codim(plain(point.scene), names, "GR", *given, (before % len(kept), late, int(spot.sides[touch]), closing))
    return max(abs(float(a - b)) for a, b in zip(true, values, strict=True))


def on_grazing(point):
    """The point of a GR where a locus of SN, PD or SB ends, None where that is a resonant grazing."""
    through = jv.switch(point)[0]
    near = [
        one for one in through.points(point.on) if np.allclose(*(list(each.values.values()) for each in (one, point)))
    ]
    return near[0] if near else None


def apart(point, locus):
    """[(gap, distance)] of the locus of a nonhyperbolic grazing's kind from the GR that is tangent to it: one of the
    parameters, the other, which changes faster, being gaps from the point's."""
    ways = abs(locus.values[1] - locus.values[0]) / (1.0 + abs(locus.values[0]))
    axis = int(ways[1] > ways[0])
    name, other = locus.names[axis], locus.names[1 - axis]
    if point.kind != "SN":
        for gap in NARROW:
            found = gaps(point, name, (2.0 * gap, gap))
            away = [
                (one[0], two[2 - axis] - one[2 - axis]) for one, two in zip(found[point.kind], found["GR"], strict=True)
            ]
            if abs(away[1][1]) > SEEN:
                break
        return away
    found = gaps(point, name)["SN"]
    return [(gap, one[1 - axis] - grazing(point, name, one[axis], other)) for gap, *one in found]


def grazing(point, name, value, other):
    """One parameter of the GR where another has a value, by the reference."""
    spot, scene = point.spot, plain(point.scene.replace(**{name: value}))
    rows = [each.tolist() for each in (spot.times, spot.speeds)]
    sides = [int(side) for side in spot.sides]
    given = scene, theirs(point.scene, other), "GR", point.values[other], *rows, sides, spot.periods
    return float(reference.special(*given, digits=30))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, number, *rest = sys.argv[1:]
    folded = partial(switched, draw=degenerate)
    {"tangent": tangent, "switched": switched, "folded": folded, "third": third}[what](
        int(number), int(rest[0]) if rest else 0
    )
