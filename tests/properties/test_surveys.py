"""Properties of maps, basin fractions and smallest shocks that hold for every kind of scene."""

from collections import Counter
from contextlib import suppress

import numpy as np
import xarray as xr

import jaxvibro as jv
from tests.kinds import wall_ends
from tests.tiers import generator, of_numbers

from .test_attractors import STARTS, attractors_of, plane

CELLS = np.array([0.8, 0.9, 1.0, 1.05, 1.1, 1.2, 1.3, 1.4])  # times the amplitude
MANY = 96  # random starts
SHORT = {"settle": 300, "patience": 3000}


def label_of(periods, left, right):
    """Return the label of an orbit."""
    numbers = [str(number) for number in (periods, left, right)]
    return "P" + ("-" if max(map(len, numbers)) > 1 else "").join(numbers)


def names(data):
    """Return the labels of a map as texts."""
    codes, texts = data["label"].attrs["flag_values"], data["label"].attrs["flag_meanings"].split()
    return np.vectorize(dict(zip(codes, texts, strict=True)).get, otypes=[object])(data["label"].values)


def cells_of(scene):
    return {"amplitude": np.sort(CELLS * scene.amplitude) if scene.amplitude else np.arange(8.0)}


@of_numbers
def test_map(kind, number):
    """A cell of a map has the label and the exponent that a single run finds; chunks give the bits of the whole."""
    scene, start = kind.draw_single(number)
    grid = cells_of(scene)
    data = jv.map_parameters(scene, grid, start, ("exponent", "state"), **SHORT)
    xr.testing.assert_identical(jv.map_parameters(scene, grid, start, ("exponent", "state"), **SHORT, chunk=4), data)
    single = jv.spectrum(scene, "amplitude", grid["amplitude"], start, error=0.05, most=2**14)
    compared = 0
    for cell, name in enumerate(names(data)):
        n, (rate, _) = int(single["periods"][cell]), single["exponent"].values[cell]
        error = float(data["exponent_error"][cell]) + float(single["error"][cell, 0])
        if name == "undecided" or (not n and rate < 0.01 + 5.0 * error):
            continue
        compared += 1
        rests = n and (float(single["rests"][cell]) > 0 or np.isneginf(rate))
        hits = np.rint(n * single["impacts_on"].values[cell]).astype(int)
        assert name.startswith(f"P{n}") if rests else name == (label_of(n, *hits) if n else "chaotic")
        apart = 0.0 if rests else abs(float(data["exponent"][cell]) - rate)
        assert apart < (1e-7 if kind.exact else 1e-5) if n else apart < 5.0 * error
        if n:
            end = jv.State(*(float(data[key][cell]) for key in ("x", "v")), start.phase, float(data["contact"][cell]))
            here = scene.replace(amplitude=float(grid["amplitude"][cell]))
            again, _ = jv.strobe(here, end, n, 0)
            assert abs(plane(again) - plane(end)).max() < 1e-6 * (1.0 + abs(plane(end)).max())
    assert compared >= 1


@of_numbers
def test_carried_map(kind, number):
    """A map whose motion is carried along a parameter is a sweep up and a sweep down."""
    scene, start = kind.draw_single(number)
    values = cells_of(scene)["amplitude"]
    data = jv.map_parameters(scene, {"amplitude": values}, start, ("period", "state"), "amplitude", **SHORT)
    both = np.stack([values, values[::-1]], -1)
    swept = jv.sweep(scene, "amplitude", both, jv.State(np.full(2, start.x), start.v, start.phase), 1000, 1)
    for lane, way in enumerate((1, -1)):
        carried = data.sel(way=way)
        for key in ("x", "v"):
            apart = abs(carried[key].values - swept[key].values[::way, lane, 0])
            assert apart[carried["period"].values == 1].max(initial=0.0) < 1e-6


@of_numbers
def test_random_starts(kind, number):
    """A cell with random starts has the attractors and shares that `find_attractors` finds from these starts."""
    scene, attractors = attractors_of(kind, number)
    grid = {"amplitude": [scene.amplitude]}
    data = jv.map_parameters(scene, grid, STARTS, ("label", "attractors"), seed=number)
    known = [one for one in attractors if one.share > 0 and one.kind != "unresolved"]
    shares = data["share"].values[0]
    own = Counter(zip(names(data)[0][shares > 0].tolist(), shares[shares > 0].tolist(), strict=True))
    assert own == Counter((one.label, one.share) for one in known)
    assert abs(shares.sum() + float(data["unresolved"][0]) - 1.0) < 1e-12
    assert int(data["attractors"][0]) == len(known)


@of_numbers
def test_fractions(kind, number):
    """Shares sum to 1, lie in their bounds and are those of MANY other starts; no value depends on the others."""
    scene, _ = kind.draw_single(number)
    attractors = jv.find_attractors(scene, MANY, 1000 + number)
    values = [scene.amplitude, scene.amplitude + 0.05]
    data = jv.fractions(scene, "amplitude", values, STARTS, number)
    exists = data["label"].values != ""
    total = data["share"].sum("attractor") + data["unresolved"]
    assert abs(total - 1.0).max() < 1e-12 and (np.isfinite(data["share"].values) == exists).all()
    low, share, high = (np.nan_to_num(data[key].values) for key in ("share_low", "share", "share_high"))
    assert ((low <= share) & (share <= high))[exists].all()
    alone = jv.fractions(scene, "amplitude", values[:1], STARTS, number)
    own, others = np.nan_to_num(alone["share"].values[0]), share[0]
    assert sorted(own[own > 0.0]) == sorted(others[others > 0.0])
    for attractor in attractors:
        if attractor.kind != "periodic":
            continue
        apart = [
            abs(attractor.points - [data["state_x"].values[0, k], data["state_v"].values[0, k]]).max(-1).min()
            if exists[0, k] and data["periods"].values[0, k] == attractor.periods
            else np.inf
            for k in range(data.sizes["attractor"])
        ]
        index = int(np.argmin(apart))
        same = share[0, index] if apart[index] < 1e-5 else 0.0
        if apart[index] < 1e-5 and attractor.orbit is not None:
            assert_same_track(attractor.orbit, data.isel(attractor=index))
        mean = 0.5 * (same + attractor.share)
        assert abs(same - attractor.share) < 4.5 * np.sqrt(mean * (1.0 - mean) * (1.0 / STARTS + 1.0 / MANY)) + 1e-12


def assert_same_track(orbit, track):
    """Check that a name that is kept at the second value is on the branch of the orbit, followed in small steps."""
    low, high = track["amplitude"].values
    with suppress(jv.OrbitError):  # the branch ends, or doubles its period
        for value in np.linspace(low, high, 9)[1:]:
            scene = orbit.scene.replace(amplitude=float(value))
            orbit = jv.find_orbit(scene, orbit.state, orbit.periods, settle=0)
        if orbit.stable and track["label"].values[1] == orbit.label:
            state = np.array([track["state_x"].values[1], track["state_v"].values[1]])
            section = jv.sections(orbit.scene, orbit.state, 0.0, orbit.periods)
            assert np.hypot(section["x"] - state[0], section["v"] - state[1]).min() < 1e-5 * (1.0 + abs(state).max())


@of_numbers
def test_least_shock(kind, number):
    """The smallest shock leads to another attractor; no start of a grid that is nearer does."""
    rng = generator(kind, number)
    phase, direction, place = rng.choice([1.0, 2.5]), ("v", "xv")[number % 2], 64 * number
    while True:  # a scene with two attractors
        scene, attractors = attractors_of(kind, place)
        attractors = [one for one in attractors if one.kind == "periodic"]
        if len(attractors) > 1 and not attractors[0].rests:
            break
        place += 1
        assert place < 64 * number + 64
    shock = jv.least_shock(scene, attractors, 0, phase, direction, shocks=1 << 13)
    assert shock.safe <= shock.bracket[0] < shock.size <= shock.until
    before = plane(shock.state)
    if np.isfinite(shock.size):
        assert abs(np.hypot(shock.dx, shock.dv) / shock.size - 1.0) < 1e-12 and (direction == "xv" or not shock.dx)
        shares = np.array([1.0, 1.0 - 1e-6])  # the shock itself, and one that leaves the motion on its attractor
        end, _ = jv.strobe(
            scene, jv.State(before[0] + shares * shock.dx, before[1] + shares * shock.dv, phase), 1000, 0
        )
        for index, state in zip((shock.to, 0), plane(end), strict=True):
            section = jv.sections(scene, attractors[index].state, phase, attractors[index].periods)
            points = np.stack([section["x"].values, section["v"].values], -1)
            assert abs(points - state).max(-1).min() < 1e-6 * (1.0 + abs(points).max())
    size = min(shock.size, shock.reach)
    shares = np.linspace(-1.0, 1.0, 15)
    x = before[0] + (size * shares if direction == "xv" else 1e-9 * np.arange(2))
    data = jv.basins(scene, x, before[1] + size * shares, phase, attractors)
    apart = np.hypot(data["x"] - before[0], data["v"] - before[1]).transpose("v", "x").values
    nearer = data["label"].values[apart < 0.99 * size]
    assert nearer.size > 8 and not ((nearer >= 0) & (nearer != 0)).any()
    left, right = wall_ends(scene, phase)
    assert left <= before[0] <= right
