"""What a graphics card gives beside the processor: `python -m tests.cuda_proof [maps] [studies] [surveys]`, or all.

maps: a million random states of random scenes of each kind of wall are mapped on both, in double precision: how far the
ends are apart, how many itineraries and statuses differ, nanoseconds a map of each. studies: an orbit, its branch, its
special points and basins on both. surveys: a map over two parameters, kept in a store, on both.
"""

import sys
import tempfile
import time

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.output.label_codes import CHAOTIC, UNDECIDED

WALLS = {
    "none": (None, None),
    "one": (None, 1.0),
    "two": (-1.0, 1.0),
    "moving": (jv.Wall(-1.5, 0.6), jv.Wall(1.0, 0.8, motion=jv.Motion(0.1, 0.3, 2))),
    "soft": (jv.Wall(-1.5, stiffness=90.0, damping=1.0), jv.Wall(1.0, 0.8)),
}
ROUNDS = 3


def mapped(device, scene, state, slots):
    """(the end and the impacts on the host, seconds of the first call, median seconds of the next) on a device."""
    with jax.default_device(device):
        scene, state = jax.device_put((scene, state), device)
        times = []
        for _ in range(ROUNDS + 1):
            begun = time.perf_counter()
            found = jax.block_until_ready(jv.strobe(scene, state, slots=slots))
            times.append(time.perf_counter() - begun)
    return jax.device_get(found), times[0], float(np.median(times[1:]))


def maps(card, host, count=1_000_000):
    rng = np.random.default_rng(1)
    for kind, walls in WALLS.items():
        numbers = rng.uniform(0.5, 4.0, count), rng.uniform(0.6, 3.0, count), rng.uniform(0.0, 0.4, count)
        scene = jv.make_scene(*numbers, 0.7, walls)
        state = jv.State(rng.uniform(-0.8, 0.8, count), rng.uniform(-2.0, 2.0, count))
        for slots in (0, 4):
            (one, hits), first, fast = mapped(card, scene, state, slots)
            (two, met), _, slow = mapped(host, scene, state, slots)
            apart = np.maximum(abs(one.x - two.x), abs(one.v - two.v)) / (1.0 + abs(two.v))
            known = np.isfinite(apart)
            differ = np.sum(hits.status != met.status) + np.sum((hits.side != met.side).any(axis=-1)) * (slots > 0)
            nans = np.sum(np.isfinite(one.x) != np.isfinite(two.x))
            print(
                f"{kind}, {slots} impacts: {count} states, apart {np.median(apart[known]):.1e} (median),"
                f" {np.quantile(apart[known], 0.999):.1e} (99.9 %), {apart[known].max():.1e} (most), {differ} differ,"
                f" {nans} finite on one alone; card {1e9 * fast / count:.1f} ns a map (first call {first:.1f} s),"
                f" processor {1e9 * slow / count:.1f} ns, {slow / fast:.2f} times as long",
                flush=True,
            )


def studies(card, host):
    tables = []
    for device in (host, card):
        with jax.default_device(device):
            begun = time.perf_counter()
            scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
            state, _ = jv.strobe(scene, jv.State(0.9, -1.1))
            slope = jax.grad(lambda x, scene=scene: jv.strobe(scene, jv.State(x, -1.1))[0].x)(0.9)
            branch = jv.follow(jv.find_orbit(scene, state), "amplitude", (0.0, 6.0))
            values = [each.value for each in branch.special]
            basin = jv.basins(scene, np.linspace(-0.9, 0.9, 40), np.linspace(-2.0, 2.0, 40))["label"].values
            tables.append((float(slope), values, basin))
        print(f"{device.device_kind}: {time.perf_counter() - begun:.1f} s; {branch}", flush=True)
    (one, first, left), (two, second, right) = tables
    print(f"slopes {abs(one - two):.1e}, places {max(abs(np.subtract(first, second))):.1e} apart")
    print(f"{np.sum(left != right)} of {left.size} cells of basins differ")


def surveys(card, host, side=64):
    tables, grid = [], {"amplitude": np.linspace(0.5, 6.0, side), "frequency": np.linspace(1.5, 4.0, side)}
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
    for device in (host, card):
        with jax.default_device(device), tempfile.TemporaryDirectory() as folder:
            times = []
            for name in "ab":
                begun = time.perf_counter()
                found = jv.map_parameters(scene, grid, store=jv.Store(f"{folder}/{name}.zarr"))
                times.append(time.perf_counter() - begun)
            tables.append((found["label"].values.copy(), found["exponent"].values.copy()))
        print(
            f"{device.device_kind}: {side} x {side} cells in {times[1]:.1f} s, the first time {times[0]:.1f} s",
            flush=True,
        )
    (one, first), (two, second) = tables
    told = (one != UNDECIDED) & (two != UNDECIDED)
    same = told & (one == two)
    apart = abs(first - second)[same & (one != CHAOTIC)]
    print(f"{np.sum(told & ~same)} of {one.size} cells differ, {np.sum(~told)} undecided on one at least")
    print(f"exponents of the periodic ones {np.nanmedian(apart):.1e} apart (median), {np.nanmax(apart):.1e} (most)")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    card, host = jax.devices("gpu")[0], jax.devices("cpu")[0]
    print(f"{card.device_kind}, jax {jax.__version__}")
    for part in (maps, studies, surveys):
        if len(sys.argv) == 1 or part.__name__ in sys.argv[1:]:
            part(card, host)
