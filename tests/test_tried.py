"""What is known without a start: stable free responses however few starts settle on them, mirror images; and how well
shares are known."""

from math import comb

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.attractors import derived_attractors
from jaxvibro.attractors.basin_fraction_bounds import compute_share_bounds, format_share
from jaxvibro.maps import itinerary
from jaxvibro.scene.scene import replace_unchecked

KINDS = ("both", "left", "moving", "right", "one moving", "soft")
ANGLES = np.linspace(0.0, 2.0 * np.pi, 20_001)


def response(scene):
    """x of the free response at ANGLES, in closed form (paper, (8))."""
    a, w, c = (float(getattr(scene, name)) for name in ("amplitude", "frequency", "damping"))
    return (a / (1.0 - w * w + 2j * c * w) * np.exp(1j * ANGLES)).real


def clearance(scene, sign, wall):
    """How far the free response keeps off a wall, at the least."""
    swing = 0.0
    if wall.motion is not None:
        swing = float(wall.motion.amplitude) * np.cos(wall.motion.harmonic * ANGLES + float(wall.motion.phase))
    return float((sign * (float(wall.position) + swing - response(scene))).min())


def drawn(kind, seed):
    """A random scene whose free response comes near to a wall, or goes a little beyond, and whether it keeps off."""
    rng = np.random.default_rng((KINDS.index(kind), seed))
    frequency, damping, amplitude = rng.uniform(0.3, 4.0), 10 ** rng.uniform(-2.0, 0.2), rng.uniform(0.2, 5.0)
    size = amplitude / np.hypot(1.0 - frequency**2, 2.0 * damping * frequency)

    def wall(sign, moves):
        more = {"stiffness": 50.0, "damping": 1.0} if kind == "soft" else {"restitution": rng.uniform(0.0, 0.95)}
        swing = jv.Motion(rng.uniform(0.0, 0.6) * size, rng.uniform(-np.pi, np.pi), 2) if moves else None
        return jv.Wall(sign * size * rng.uniform(1.0, 2.0), motion=swing, **more)

    left = None if kind in ("right", "one moving") else wall(-1, kind == "moving")
    right = None if kind == "left" else wall(1, kind in ("moving", "one moving"))
    scene = jv.make_scene(amplitude, frequency, damping, 0.5, (left, right))

    signs = {"left": -1, "right": 1}
    gaps = {side: clearance(scene, signs[side], wall) for side, wall in scene.walls.items()}
    nearest, keeps = min(gaps, key=gaps.get), bool(rng.random() < 0.6)
    near = size * 10 ** rng.uniform(-5.0, -2.0) * (1 if keeps else -1)
    wanted = {side: near if side == nearest else max(gap, 0.1 * size) for side, gap in gaps.items()}
    places = {f"{side}.position": signs[side] * (wanted[side] - gap) for side, gap in gaps.items()}
    return replace_unchecked(scene, {key: float(scene.parameter(key)) + shift for key, shift in places.items()}), keeps


@pytest.mark.parametrize("kind", [*KINDS[:2], *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS[2:])])
def test_a_free_response_that_keeps_off_the_walls_is_known(kind):
    for seed in range(8):
        scene, keeps = drawn(kind, seed)
        found = derived_attractors.derive_free_response(scene, [])
        assert len(found) == keeps
        for one in found:
            numbers, (w, c) = one.attractor_fields, (float(scene.frequency), float(scene.damping))
            slope = np.gradient(response(scene), ANGLES) * w
            assert abs(numbers["state"].x - response(scene)[0]) < 1e-12 * (1 + abs(response(scene)).max())
            assert abs(numbers["state"].v - slope[0]) < 1e-3 * (1 + abs(slope).max())
            slowest = c - np.sqrt(max(0.0, c * c - 1.0))
            assert abs(numbers["exponent"] + slowest * 2 * np.pi / w) < 1e-6
            assert derived_attractors.derive_free_response(scene, found) == []


@pytest.mark.parametrize("frequency", [2.1, 1.0, 0.5])
def test_without_damping_it_does_not_attract(frequency):
    scene = jv.make_scene(1.0, frequency, 0.0, 0.7, (-1e4, 1e4))
    assert derived_attractors.derive_free_response(scene, []) == []


def test_stable_p100_is_listed_whatever_the_starts_say():
    """Of 4,000 starts 0.8 % settle on it."""
    scene = jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    found = jv.find_attractors(scene, starts=64)
    one = next(one for one in found if one.label == "P100")
    assert one.share == 0.0 and one.share_bounds == compute_share_bounds(0, 64) and one.mirror_of == found.index(one)
    assert one.orbit.stable and "no start settled on it" in one.note
    assert abs(sum(each.share for each in found) - 1.0) < 1e-12
    end, _ = jv.strobe(scene, one.state)
    assert abs(end.x - one.state.x) < 1e-14


@pytest.mark.parametrize("amplitude", [4.65, 5.0, 5.6])
def test_mirror_images_are_there_from_one_start(amplitude):
    scene = jv.make_scene(amplitude, 2.1, 0.05, 0.7, (-1.0, 1.0))
    for seed in range(3):
        found = jv.find_attractors(scene, starts=1, seed=seed)
        first, twin = found[0], found[found[0].mirror_of]
        assert len(found) == 1 + (first is not twin) and [one.share for one in found] == [1.0, 0.0][: len(found)]
        assert twin.mirror_of == 0 and len(twin.label) == len(first.label) and twin.kind == first.kind
        assert itinerary.is_same_itinerary(twin.itinerary, itinerary.mirror_itinerary(first.itinerary))
        back, _ = jv.strobe(scene, jv.State(-twin.state.x, -twin.state.v, np.pi), periods=max(1, twin.periods))
        if twin.periods:
            assert abs(back.x + twin.state.x) < 1e-11 and abs(back.v + twin.state.v) < 1e-11


@pytest.mark.parametrize("count, starts", [(1, 200), (7, 200), (100, 200), (199, 200), (3, 4)])
def test_bounds_are_where_the_binomial_tails_are_small(count, starts):
    def at_least(k, p):
        return sum(comb(starts, i) * p**i * (1 - p) ** (starts - i) for i in range(k, starts + 1))

    low, high = compute_share_bounds(count, starts)
    assert abs(at_least(count, low) - 0.025) < 1e-12 and abs(1 - at_least(count + 1, high) - 0.025) < 1e-12


def test_bounds_of_none_and_of_all():
    assert compute_share_bounds(0, 200) == (0.0, pytest.approx(1 - 0.05 ** (1 / 200), abs=1e-15))
    assert compute_share_bounds(200, 200) == (pytest.approx(0.05 ** (1 / 200), abs=1e-15), 1.0)
    assert compute_share_bounds(0, 1) == (0.0, pytest.approx(0.95, abs=1e-15))


def test_shares_are_told_with_their_bounds():
    class One:
        starts = 200

    told = []
    for count in (0, 92, 200):
        One.share, One.share_bounds = count / 200, compute_share_bounds(count, 200)
        told.append(format_share(One))
    both = "46.0 % of starts (38.9 to 53.2 %)"
    assert told == ["0 of 200 starts: below 1.5 %", both, "200 of 200 starts: above 98.5 %"]
