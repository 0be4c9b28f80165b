"""Special points of the kinds of scene, and what the reference implementation says of them in many digits."""

from functools import cache

import mpmath
import numpy as np
from mpmath import mpf

import jaxvibro as jv
from tests import truths
from tests.kinds import KINDS, Kind
from tests.reference import closed
from tests.reference.codim import codim
from tests.special_points import SLOW, exact_value, find_touch, impacts_of, rows_of
from tests.tiers import generator

BIFURCATIONS = ("SN", "PD", "SB", "GR")
TRIES = 8  # scenes of a draw
MOST = 3  # impacts of an orbit
MOST_POINTS = 60  # of a branch
WEAK = 0.1  # of the amplitude of a scene, where its branch begins


def symmetric(n):
    """Two walls that are mirror images, with the restitution of the scene."""
    walls = -0.5 * n["gap"], 0.5 * n["gap"]
    return jv.make_scene(n["amplitude"], n["frequency"], n["damping"], n["left_restitution"], walls)


OWN_KINDS = KINDS | {"symmetric": Kind("symmetric", symmetric, truths.closed_form)}


@cache
def find_points(kind_name, number):
    """Return the branch in amplitude that begins at a weak drive, and its first special point of each kind.

    The first of some scenes of a draw whose branch has more than grazings, or else the first that has these.
    """
    kind, best = OWN_KINDS[kind_name], None
    for attempt in range(TRIES):
        scene, state = kind.draw_single(TRIES * number + attempt)
        strong = float(scene.amplitude)
        try:
            orbit = jv.find_orbit(scene.replace(amplitude=WEAK * strong), state)
            if orbit.periods > 2 or orbit.impacts.count > MOST:
                continue
            bounds = 0.0, 4.0 * strong
            branch = jv.follow(orbit, "amplitude", bounds, "forward", largest_step=0.3, max_points=MOST_POINTS)
        except (jv.OrbitError, jv.ArgumentError):
            continue
        found = {}
        for point in branch.special:
            rows = rows_of(point.spot)
            if point.kind in BIFURCATIONS and len(rows[0]) <= MOST and abs(np.array(rows[2])).max(initial=1) == 1:
                found.setdefault(point.kind, point)
        best = best or (found and (branch, found))
        if found.keys() - {"GR"}:
            return branch, found
    if best:
        return best
    raise AssertionError(f"no special point in {TRIES} scenes of {kind_name}, draw {number}")


@cache
def find_loci(kind_name, number):
    """Return a locus from each of these points, in amplitude and another parameter, frequency in every other draw."""
    _, points = find_points(kind_name, number)
    rng, loci = generator(OWN_KINDS[kind_name], number), {}
    for name, point in points.items():
        others = free_names(point)
        other = "frequency" if number % 2 == 0 else str(rng.choice(others))
        names = ("amplitude", other)
        loci[name] = jv.locus(point, names, bounds_around(point.scene, names), largest_step=0.3)
    return loci


def free_names(point):
    """Return the numbers by which a special point may move, without phases."""
    names = jv.sensitivity(point, wall=wall_of(point))["number"].values.tolist()
    return [name for name in names if "phase" not in name]


@cache
def wall_of(point):
    """Return the right wall for a grazing orbit that touches both, as its derivatives must have one; else None."""
    try:
        jv.sensitivity(point)
    except jv.ArgumentError as error:
        assert error.key == "wall"
        return "right"
    return None


def bounds_around(scene, names, share=0.3):
    """Return bounds of parameters on both sides of their values."""
    bounds = {}
    for name in names:
        value = float(scene.parameter(name))
        low, high = value - share * (0.1 + abs(value)), value + share * (0.1 + abs(value))
        bounds[name] = (low if "position" in name else max(low, 0.0), min(high, 1.0) if "restitution" in name else high)
    return bounds


def locus_error(locus, place, digits=40):
    """Return the error of the first parameter at a point of a locus, the second one being as it is."""
    scene, spot = locus.located(place)
    value = float(locus.values[place, 0])
    return abs(float(exact_value(scene, locus.kind, locus.names[0], value, spot, digits=digits) - value))


def codim2_error(point, on_half=False):
    """Return the error of both parameters at a point of codimension two, where a locus of SN, PD or SB meets another.

    on_half: the orbit is symmetric, of which the reference takes one half.
    """
    kind, closing, spot, touch = point.kind, point.on, point.spot, None
    if closing == "GR" and kind != "RG":
        kind, closing = "GR", kind
    half = on_half or closing == "SB" or kind == "DSB"
    rows = rows_of(spot)
    if kind == "GR" and (point.on == "GR" or min(rows[1]) > SLOW):
        rows = impacts_of(spot)
        touch = find_touch(truths.plain(point.scene), spot)
        row, time, side = touch
        if rows[0] and time < rows[0][0]:
            time += 2.0 * np.pi * spot.periods / float(point.scene.frequency)
        touch = row, time, side, "SN" if closing == "SN" else "PD"
    values = list(point.values.values())
    given = truths.plain(point.scene), list(point.values), kind, values, *rows, spot.periods, half, touch
    return max(abs(float(a - b)) for a, b in zip(codim(*given), values, strict=True))


def resonance(gamma, restitution, wall, m, n=1):
    """Return the frequency of the resonant grazing of P(n)01, and the coefficients of SN and PD.

    A - A_GR is a coefficient times the square of the distance in frequency. With E the free flow over n periods, an
    impact of speed u is met again for A = sqrt(D) (s - a u + b^2 u^2 / (2 s omega^2)), with a and b of
    `closed.coefficients`; a is zero where sin(r T) is. At SN dA/du = 0, at PD det(M + I).
    """
    gamma, r, s = mpf(gamma), mpf(restitution), mpf(wall)
    omega = 2 * n * mpmath.sqrt(1 - gamma**2) / m
    turn = (-1) ** m * mpmath.exp(-gamma * 2 * mpmath.pi * n / omega)
    push = 2 * mpmath.pi * n * (1 + r) * turn / omega
    root = mpmath.sqrt(closed.denominator(gamma, omega))
    fold = -s * root / 2 * (push / ((1 - turn) * (1 + r * turn))) ** 2
    lean = 1 / (1 - r * turn) ** 2
    doubling = s * root * (push / (1 - turn)) ** 2 * (lean + (1 + r * turn) ** 2 * lean**2 / 2)
    return omega, fold, doubling
