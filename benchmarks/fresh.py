"""Run requests in a process of their own: `python -m benchmarks.fresh WHAT`.

As a script it runs one request after the other and prints, as JSON, pairs of the request and the processor seconds
since `import jax` finished.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import jax

ROOT = Path(__file__).parents[1]
ALONG = (0.0, 6.0)  # bounds of the amplitude of branches
BOUNDS = {"amplitude": (0.0, 12.0), "frequency": (1.5, 3.0)}


def ask(module, *given, **environment):
    """Run `python -m MODULE GIVEN` in a new process and return its output.

    Of JAX's settings it receives only the given ones; it keeps Python's byte code.
    """
    kept = {name: text for name, text in os.environ.items() if not name.startswith("JAX_")}
    kept.pop("PYTHONDONTWRITEBYTECODE", None)
    words = [sys.executable, "-m", module, *given]
    alone = kept | {"JAX_PLATFORMS": "cpu"} | environment
    done = subprocess.run(words, cwd=ROOT, env=alone, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words[1:])} ended with {done.returncode}: {done.stderr.strip()[-500:]}")
    return done.stdout


def readme(jv, said):
    """Run the README's lines."""
    scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
    state, _ = jv.strobe(scene, jv.State(x=0.9, v=-1.1))
    said("strobe")
    orbit = jv.find_orbit(scene, state)
    str((orbit.label, orbit.multipliers, orbit.stable))
    said("find_orbit")
    branch = jv.follow(orbit, "amplitude", bounds=ALONG)
    branch.table()
    said("branch table")
    jv.switch(branch.points("SB")[0])
    said("switch")
    jv.locus(branch.points("SN")[0], tuple(BOUNDS), bounds=BOUNDS)
    said("locus")


def attractors(jv, said):
    """Find the attractors of the README's scene at A = 3."""
    jv.find_attractors(jv.make_scene(3.0, 2.1, 0.05, 0.7, (-1.0, 1.0)))
    said("find_attractors")


def soft(jv, said):
    """Follow a first branch between soft walls and a first locus."""
    walls = tuple(jv.Wall(place, stiffness=400.0, damping=2.0) for place in (-1.0, 1.0))
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls)
    state, _ = jv.strobe(scene, jv.State(0.9, -1.1))
    branch = jv.follow(jv.find_orbit(scene, state), "amplitude", bounds=ALONG)
    branch.table()
    said("soft walls: branch table")
    jv.locus(branch.points("SN")[0], tuple(BOUNDS), bounds=BOUNDS)
    said("soft walls: locus")


QUESTIONS = {"readme": readme, "attractors": attractors, "soft": soft}


def main(what):
    """Run the requests and print the seconds."""
    begun, told = time.process_time(), []
    import jaxvibro as jv  # noqa: PLC0415  # the time includes the import

    jax.config.update("jax_enable_x64", True)
    QUESTIONS[what](jv, lambda name: told.append((name, time.process_time() - begun)))
    print(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
