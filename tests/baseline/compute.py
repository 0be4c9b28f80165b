"""Compute the reference values with the installed package: `python compute.py FOLDER` writes them to a folder.

The script uses only public names of jaxvibro and imports nothing from the tests, so that it runs in the environment of
an earlier commit as well: `python -m tests.baseline.compare COMMIT`.
"""

import argparse
import inspect
import json
import re
import sys
from pathlib import Path

import jax
import numpy as np

import continuation
import jaxvibro as jv

STATES = 6  # initial states per scene
PERIODS = (1, 3)
README = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7, "walls": (-1.0, 1.0)}


def duffing(t, x, v, params):
    return -x - params["cubic"] * x**3 - 2.0 * params["damping"] * v


def gravity(t, x, v, params):
    return -params["g"] + 0.0 * x


def fold(u, p, args):
    return u * u - p["mu"]


def scenes():
    """One scene of each kind: {name: Scene}."""
    moving = jv.Wall(-1.0, 0.8, motion=jv.Motion(0.1, 0.4, harmonic=2))
    soft = jv.Wall(1.0, stiffness=40.0, damping=0.3)
    swaying = jv.Wall(-0.8, stiffness=25.0, damping=0.2, motion=jv.Motion(0.05, 1.0))
    hertz = jv.Wall(1.0, law=jv.Push("hertz", {"stiffness": 50.0}))
    oscillator = {"amplitude": 2.0, "frequency": 2.1, "damping": 0.05, "restitution": 0.7}
    forced = {"amplitude": 2.0, "frequency": 2.1, "restitution": 0.7, "walls": (-1.0, 1.0)}
    params = {"cubic": 0.5, "damping": 0.05}
    return {
        "rigid": jv.make_scene(**README),
        "rigid_float32": jv.make_scene(**README, dtype=np.float32),
        "one_wall_at_0": jv.make_scene(**oscillator, walls=(None, 0.0)),
        "restitution_per_wall": jv.make_scene(**oscillator, walls=(jv.Wall(0.3, 1.0), jv.Wall(1.7, 0.2))),
        "sticking": jv.make_scene(1.5, 0.7, 0.05, 0.0, (-0.5, None)),
        "moving": jv.make_scene(**oscillator, walls=(moving, 1.0)),
        "soft": jv.make_scene(**oscillator, walls=(-1.0, soft)),
        "soft_moving": jv.make_scene(**oscillator, walls=(swaying, soft)),
        "overdamped_undriven": jv.make_scene(0.0, 1.0, 1.3, 0.9, (-0.2, 0.4)),
        "harmonics": jv.make_scene(**oscillator, walls=(-1.0, 1.0), drive=(jv.Motion(0.4, 0.3, harmonic=3),)),
        "without_walls": jv.make_scene(**oscillator, walls=(None, None)),
        "duffing": jv.make_scene(**forced, force=jv.Force(duffing, params, 1e-13)),
        "bouncing_ball": jv.make_scene(
            0.3, 2.0, restitution=0.6, walls=(0.0, None), force=jv.Force(gravity, {"g": 1.0})
        ),
        "solver": jv.make_scene(**forced, force=jv.Force(duffing, params, 1e-9, solver="Dopri8")),
        "hertz": jv.make_scene(2.0, 2.1, restitution=0.7, walls=(-1.0, hertz), force=jv.Force(duffing, params, 1e-13)),
    }


def states(name, scene):
    """Random initial states in the gap of a scene, the same for each commit."""
    rng = np.random.default_rng(sum(map(ord, name)))
    left = -1.5 if scene.left is None else float(scene.left.position)
    right = left + 2.0 if scene.right is None else float(scene.right.position)
    dtype = np.asarray(scene.amplitude).dtype
    x = rng.uniform(left + 0.15 * (right - left), right - 0.15 * (right - left), STATES)
    return jv.State(x.astype(dtype), rng.uniform(-1.5, 1.5, STATES).astype(dtype))


def strobes():
    """{scene/periods/quantity: array} of the stroboscopic map."""
    values = {}
    for name, scene in scenes().items():
        for periods in PERIODS:
            end, impacts = jv.strobe(scene, states(name, scene), periods=periods)
            quantities = {"x": end.x, "v": end.v, "status": impacts.status, "count": impacts.count}
            quantities |= {"time": impacts.time, "speed": impacts.speed, "side": impacts.side}
            values |= {f"strobe/{name}/{periods}/{key}": np.asarray(value) for key, value in quantities.items()}
    return values


def readme(folder):
    """{name: array} of the branch and the locus of the README; writes them and what else can be saved to a folder."""
    scene = jv.make_scene(**README)
    branch = jv.follow(jv.find_orbit(scene, jv.State(x=0.9, v=-1.1)), "amplitude", bounds=(0.0, 6.0))
    (point,) = branch.points("SN")
    bounds = {"amplitude": (0.0, 12.0), "frequency": (1.5, 3.0)}
    locus = jv.locus(point, ("amplitude", "frequency"), bounds=bounds)
    values = {}
    for kind, curve, names in (("branch", branch, ("amplitude",)), ("locus", locus, ("amplitude", "frequency"))):
        points = curve.special
        values[f"{kind}/kinds"] = np.array([point.kind for point in points])
        for name in names:
            numbers = [point.value if kind == "branch" else point.scene.parameter(name) for point in points]
            values[f"{kind}/{name}"] = np.array([float(number) for number in numbers])
        values[f"{kind}/multipliers"] = np.array([point.multipliers for point in points])
    if folder:
        save(folder, scene, branch, locus)
    return values


def save(folder, scene, branch, locus):
    """Write one file of each kind that can be read again."""
    branch.save(folder / "branch.nc")
    locus.save(folder / "locus.nc")
    bounds = {"amplitude": (1.5, 4.0), "frequency": (2.09, 2.11)}
    row = int(abs(branch.values - 2.0).argmin())
    hold = {"least_speed": float(branch.data.least_speed[row])}
    held = jv.follow(branch.orbit(row), ("amplitude", "frequency"), bounds, hold=hold)
    held.save(folder / "held_branch.nc")
    jv.explore(scene, "amplitude", (2.0, 2.2), max_period=1).save(folder / "diagram")
    jv.save_scene(scene, folder / "scene.toml")
    store = jv.Store(folder / "map")
    jv.map_parameters(scene, {"amplitude": np.linspace(2.0, 5.0, 3)}, store=store)
    parabola = continuation.trace(continuation.equilibria(fold), [1.0], {"mu": 1.0}, "mu", (-1.0, 2.0))
    continuation.save(parabola, folder / "continuation.npz")


def map_cells():
    """{name: array} of a map with random starts and one with a single start."""
    scene, grid = jv.make_scene(**README), {"amplitude": np.linspace(1.0, 6.0, 4), "frequency": np.array([1.9, 2.3])}
    data = jv.map_parameters(scene, grid)
    return {f"map/{name}": np.asarray(data[name].values) for name in data.data_vars}


def signatures():
    """{public name: signature, or the fields and public attributes of a class}."""
    table = {}
    for module in (jv, jv.plot, continuation):
        for name in sorted(set(module.__all__) - {"plot", "__version__"}):
            value = getattr(module, name)
            entry = table[f"{module.__name__}.{name}"] = {"signature": _signature(value)}
            if inspect.isclass(value):
                own = {key for key in dir(value) if not key.startswith("_")} | {*getattr(value, "__annotations__", ())}
                entry["attributes"] = {key: _signature(getattr(value, key, None)) for key in sorted(own)}
    return table


def _signature(value):
    """Kind, name and default of each parameter; annotations may become more precise."""
    if not callable(value):
        return []
    try:
        parameters = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):
        return []
    blank = inspect.Parameter.empty
    plain = [f"{p.kind.name.lower()} {p.replace(annotation=blank)}" for p in parameters]
    return [re.sub(r"<function \w+ at \w+>", "function", text) for text in plain]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    values = strobes() | readme(folder) | map_cells()
    np.savez_compressed(folder / "values.npz", **values)
    (folder / "signatures.json").write_text(json.dumps(signatures(), indent=1, sort_keys=True) + "\n")
    print(f"{len(values)} arrays in {folder}, by {sys.executable}")


if __name__ == "__main__":
    main()
