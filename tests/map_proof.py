"""Maps and basins at full size: `python -m tests.map_proof map SIDE FOLDER | cells COUNT FOLDER | basins FOLDER |
devices SIDE | workers SIDE`.

map: (omega, A) of figure 4, SIDE x SIDE cells, label and exponent, kept in FOLDER/map.zarr: time and memory. cells: so
many of them against single runs by `spectrum`. basins: figure 5's, 1e5 to 1e8 starts: what it takes, the slope of the
cost, set-up taken off and printed. devices: two of jax's local devices, as many threads as is usual, against one and
its thread, and, as what the machine itself allows, two processes at once against one; workers: two Dask workers
against one; in turn, medians.
"""

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np

import jaxvibro as jv
from jaxvibro.output.label_codes import CHAOTIC, UNDECIDED, label_code_from_counts, label_of
from jaxvibro.studies.scene_file import read_scene_file

ROOT = Path(__file__).parents[1]
REST = jv.State(0.0, 0.0)
ROUNDS = 3


def figure_4():
    return jv.load_scene(ROOT / "scenes" / "fig4.toml")


def grid(side):
    return {"amplitude": np.linspace(0.5, 6.0, side), "frequency": np.linspace(1.5, 4.0, side)}


def memory():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def a_map(side, folder):
    began = time.perf_counter()
    jv.map_parameters(figure_4(), {"amplitude": [4.65], "frequency": [2.1]})
    first, began = time.perf_counter() - began, time.perf_counter()

    def told(one):
        if one.done % (50 * 4000) == 0:
            print(f"{one.done} cells, {one.rate:.0f} a second, {one.undecided} undecided", flush=True)

    found = jv.map_parameters(figure_4(), grid(side), store=jv.Store(Path(folder) / "map.zarr"), progress=told)
    seconds = time.perf_counter() - began
    undecided = int((found["label"] == UNDECIDED).sum())
    print(f"{side} x {side} cells: {seconds:.0f} s after {first:.1f} s of compiling, {memory():.2f} GiB at most")
    print(f"{undecided} undecided, {len(np.unique(found['label']))} labels")


def cells(count, folder):
    """Cells drawn at random against `spectrum` of their scene alone, until its error is 0.01 or 2^17 periods."""
    found, scene, rng = jv.load_store(Path(folder) / "map.zarr"), figure_4(), np.random.default_rng(25)
    others = undecided = 0
    worst = 0.0
    for _ in range(count):
        i, j = (int(rng.integers(found.sizes[name])) for name in ("amplitude", "frequency"))
        mine, here = found.isel(amplitude=i, frequency=j), scene.replace(amplitude=float(found["amplitude"][i]))
        one = jv.spectrum(here, "frequency", [float(found["frequency"][j])], REST, error=1e-2, most=2**17)
        n, rate, error = int(one["periods"][0]), float(one["exponent"][0, 0]), float(one["error"][0, 0])
        if n:
            known = int(label_code_from_counts(n, *np.rint(n * one["impacts_on"].values[0]).astype(int)))
        else:
            known = CHAOTIC if rate - 3.0 * error > 0.01 else UNDECIDED
        label = int(mine["label"])
        if UNDECIDED in (label, known):
            undecided += 1
            continue
        if label != known:
            others += 1
            place = f"A {float(here.amplitude):.6g}, omega {float(mine['frequency']):.6g}"
            print(f"{place}: {label_of(label)}, alone {label_of(known)}")
        elif n:
            worst = max(worst, abs(float(mine["exponent"]) - rate) if np.isfinite(rate) else 0.0)
    print(f"{count} cells: {others} other, {undecided} undecided; exponents of orbits {worst:.1e} apart at most")


def basins(folder):
    """Figure 5's basins from 1e5 starts to 1e8, each in a store."""
    asked = read_scene_file(ROOT / "scenes" / "fig5.toml")
    scene, phase = asked.scene.make(), asked.basins.phase
    few = [-0.5, 0.5], [-1.0, 1.0]
    began = time.perf_counter()
    attractors = jv.find_attractors(scene)
    jv.basins(scene, *few, phase, attractors, store=jv.Store(Path(folder) / "few.zarr"))
    print(f"set-up (attractors, compiling, trapping regions): {time.perf_counter() - began:.1f} s")
    costs = []
    for side, rounds in ((316, 15), (1000, 3), (3162, 1), (10_000, 1)):
        axes = np.linspace(*asked.basins.x, side), np.linspace(*asked.basins.v, side)
        spent = []
        for k in range(rounds):
            for what in (few, axes):  # the first is the set-up
                place = Path(folder) / f"basins_{side}_{k}_{len(what[0])}.zarr"
                began = time.perf_counter()
                found = jv.basins(scene, *what, phase, attractors, store=jv.Store(place))
                spent.append(time.perf_counter() - began)
        before, all_of_it = np.median(spent[::2]), np.median(spent[1::2])
        costs.append((side * side, all_of_it - before))
        unresolved = float((found["label"] == -1).mean())
        print(f"{side * side} starts: {costs[-1][1]:.3f} s after {before:.3f} s of set-up, {memory():.2f} GiB at most,")
        print(f"  shares {found['fraction'].values.round(5).tolist()}, unresolved {unresolved:.2e}", flush=True)
    starts, seconds = np.log(np.array(costs)).T
    print(f"slope of the cost: {np.polyfit(starts, seconds, 1)[0]:.3f}")


ONE = """
import sys, tempfile, time
import jax
jax.config.update("jax_enable_x64", True)
import jaxvibro as jv
from tests.map_proof import figure_4, grid
if __name__ == "__main__":
    kind, count, side = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    local = jv.LocalEngine(None if count == 2 else 1, count)
    engine = jv.DaskEngine(workers=count) if kind == "workers" else local
    with tempfile.TemporaryDirectory() as folder:
        seen = []
        store = jv.Store(folder + "/map", engine)
        note = lambda one: seen.append((time.perf_counter(), one.done))
        jv.map_parameters(figure_4(), grid(side), store=store, progress=note)
    (start, some), (end, whole) = seen[4], seen[-1]  # all workers have compiled by then
    print((end - start) / (whole - some) * whole)
"""


def ratio(kind, side):
    """How much faster two are than one: seconds of the cells after the first chunks, in turn."""
    known = {1: [], 2: [], "apart": []}
    for _ in range(ROUNDS):
        for count in (1, 2):
            known[count].append(seconds_of(begun(kind, count, side)))
            print(kind, count, f"{known[count][-1]:.2f} s", flush=True)
        both = [begun(kind, 1, side) for _ in range(2)]
        known["apart"].append(np.mean([seconds_of(one) for one in both]) / 2.0)
    one, two, apart = (np.array(known[count]) for count in known)
    for name, other in ((f"two {kind}", two), ("two processes at once", apart)):
        ratios = one / other
        print(f"{name} against one: {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


def begun(kind, count, side):
    """A process that works a map out."""
    flags = f"--xla_force_host_platform_device_count={count}" if kind == "devices" else ""
    env = {**os.environ, "PYTHONPATH": str(ROOT), "XLA_FLAGS": flags}
    script = ROOT / "out" / "engines.py"
    script.parent.mkdir(exist_ok=True)
    script.write_text(ONE)
    told = [sys.executable, str(script), kind, str(count), str(side)]
    return subprocess.Popen(told, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def seconds_of(process):
    return float(process.communicate()[0].split()[-1])


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, *rest = sys.argv[1:]
    if what == "map":
        a_map(int(rest[0]), rest[1])
    elif what == "cells":
        cells(int(rest[0]), rest[1])
    elif what == "basins":
        basins(rest[0])
    else:
        ratio(what, int(rest[0]))
