"""Bifurcations placed in random scenes: `python -m tests.place_proof 50 20`, targets that can be met, and that cannot.

A target that can be met is the point's value in a scene moved at random: it is to be met, by no greater change than
that. One that cannot: a number may go as far as two bounds, and the target lies beyond the values at both.
"""

import sys

import jax
import numpy as np

import jaxvibro as jv
from tests.located_proof import points

UNITS = {"frequency": 0.1, "damping": 0.02, "right.position": 0.05, "restitution": 0.05}
MOST = 0.5  # units: of the random move, of each number


def free_of(point, rng, count):
    """{name: unit} of so many numbers that may change."""
    names = [name for name in UNITS if name in point.scene.names and name != point.name]
    if point.kind == "SB":
        names = [name for name in names if name != "right.position"]
    return {str(name): UNITS[name] for name in rng.choice(names, min(count, len(names)), replace=False)}


def moved(scene, free, by):
    """The scene with its numbers moved by so many units, kept within their domains."""
    numbers = {
        name: float(scene.parameter(name)) + unit * way for (name, unit), way in zip(free.items(), by, strict=True)
    }
    numbers |= {name: abs(numbers[name]) for name in ("damping",) if name in numbers}
    numbers |= {name: min(numbers[name], 1.0) for name in ("restitution",) if name in numbers}
    return scene.replace(**numbers)


def main(can, cannot, seed=0):
    """Print what was met and what was not."""
    jax.config.update("jax_enable_x64", True)
    rng, told, errors = np.random.default_rng(seed), [], []
    for point in points(3 * can, seed, ("SN", "PD", "GR")):
        free = free_of(point, rng, rng.integers(1, 4))
        by = rng.uniform(-MOST, MOST, len(free))
        try:
            known = jv.located(point).solve(moved(point.scene, free, by))
            if int(known.status) != 0:
                continue
            found = jv.place(point, point.name, float(known.value), free)
        except jv.ArgumentError as error:
            print("  skipped:", str(error)[:100], flush=True)
            continue
        error = abs(float(jv.located(point)(found.scene)) - float(known.value))
        told.append((found.met, found.distance <= np.linalg.norm(by) * (1 + 1e-9) or found.at_bound))
        errors.append(error)
        print(point.kind, point.name, list(free), found.met, f"{error:.1e}", f"{found.distance:.4f}", flush=True)
        if len(told) == can:
            break
    met, least = (sum(map(bool, each)) for each in zip(*told, strict=True))
    print(
        f"of {len(told)} targets that can be met {met} met, largest error {max(errors):.2g}; no greater change: {least}"
    )
    said = 0
    for point in points(10 * cannot, seed + 1, ("SN", "PD", "GR")):
        free = free_of(point, rng, 1)
        (name, unit), value = next(iter(free.items())), float(point.scene.parameter(next(iter(free))))
        ends = [jv.located(point).solve(moved(point.scene, free, [way])) for way in (-0.3, 0.3)]
        values = [float(one.value) for one in ends]
        if any(int(one.status) for one in ends) or not min(values) < point.value < max(values):
            continue
        target = max(values) + 0.5 * (max(values) - min(values))
        bounds = {name: (value - 0.3 * unit if name != "damping" else max(value - 0.3 * unit, 0.0), value + 0.3 * unit)}
        if name == "restitution":
            bounds = {name: (bounds[name][0], min(bounds[name][1], 1.0))}
        found = jv.place(point, point.name, target, free, bounds)
        said += (not found.met) and bool(found.why)
        print(point.kind, name, found.met, found.why, flush=True)
        cannot -= 1
        if not cannot:
            break
    print(f"said that they cannot be met: {said}; left: {cannot}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
