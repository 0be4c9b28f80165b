"""Measures everything, and writes the page and its pictures at the end. `benchmarks.run` starts it on one core."""

import argparse
import os
import pathlib
import time
from functools import partial

import jax

from benchmarks import (
    branches,
    derivatives,
    first,
    kernel,
    limit,
    loci,
    machine,
    orbits,
    own_force,
    page,
    rigid,
    scenes,
    soft,
)
from benchmarks.rows import Size, Topic

PAGE = "benchmarks.md"
SMALL = (
    "**Measured in small, to see that it runs**: a sixteenth of the states that rows name, two rounds, few questions."
)


def topics(yardstick, size, only):
    """Each part of the page as it is measured, or one only. Those of fresh processes come first, while this one is
    small."""
    parts = {
        "first answers": partial(first.measure, size),
        "scenes": partial(scenes.measure, size),
        "yardstick": partial(kernel.measure, yardstick, size),
        "map": partial(rigid.measure, yardstick, size),
        "derivatives": partial(derivatives.measure, size),
        "orbits": partial(orbits.measure, size),
        "branches": partial(branches.measure, size),
        "loci": partial(loci.measure, size),
        "soft walls": partial(soft.measure, size),
        "own force": partial(own_force.measure, size),
    }
    for part, measure in parts.items():
        if only in (None, part):
            yield partly(part, measure)


def partly(part, measure):
    """A part's `Topic`; what was compiled for it is let go."""
    print(f"{part}:", flush=True)
    begun = time.monotonic()
    topic = measure()
    jax.clear_caches()
    print(f"  {time.monotonic() - begun:.0f} s in all", flush=True)
    return topic


def main(directory, quick, out, only):
    """Measure, then write the page and its pictures into a folder. only: a part, beside which the machine is told."""
    yardstick, line = limit.found(directory)
    print(f"yardstick: {line}")
    found = list(topics(yardstick, Size(quick), only))
    about = (*machine.describe(), f"Yardstick: {line}", *([SMALL] if quick else []))
    if only:
        found = [topic._replace(notes=(*topic.notes, "Measured by itself.", *about[:3])) for topic in found]
    else:
        found = [Topic("machine", [], notes=about), *found]
    for topic in found:
        for file, (_, draw) in topic.pictures.items():
            draw(out / file)
    page.write(out / PAGE, {topic.part: page.body(topic) for topic in found})
    print(f"written: {out / PAGE}, {', '.join(file for topic in found for file in topic.pictures)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.run", description="What answers cost, ours and others'."
    )
    parser.add_argument("--limit", metavar="DIR", default=os.environ.get("LIMIT"), help="where the yardstick is kept")
    parser.add_argument("--quick", action="store_true", help="fewer states and rounds, written to out/")
    parser.add_argument("--out", metavar="DIR", help="where to write (docs, or out when quick)")
    parser.add_argument("--part", choices=page.PARTS, help="measure this part of the page alone")
    given = parser.parse_args()
    folder = pathlib.Path(given.out or ("out" if given.quick else "docs"))
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    main(given.limit, given.quick, folder, given.part)
