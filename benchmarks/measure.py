"""Measure everything and write the page and its pictures at the end; `benchmarks.run` starts it on one core."""

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
    "**Reduced measurement, to check that it runs**: a sixteenth of the states that rows name, two rounds, few rows."
)


def topics(yardstick, size, only):
    """Yield each part of the page as it is measured, or a single part.

    Parts with processes of their own come first, while this process is small.
    """
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
    """Return a part's `Topic` and release its compiled code."""
    print(f"{part}:", flush=True)
    begun = time.monotonic()
    topic = measure()
    jax.clear_caches()
    print(f"  {time.monotonic() - begun:.0f} s in all", flush=True)
    return topic


def main(directory, quick, out, only):
    """Measure and write the page and its pictures into a folder; `only` selects one part, with the machine."""
    yardstick, line = limit.found(directory)
    print(f"yardstick: {line}")
    found = list(topics(yardstick, Size(quick), only))
    about = (*machine.describe(), f"Hand-written kernel: {line}", *([SMALL] if quick else []))
    if only:
        found = [
            topic._replace(notes=(*topic.notes, "This part was measured in a separate run:", *about[:3]))
            for topic in found
        ]
    else:
        found = [Topic("machine", [], notes=about), *found]
    for topic in found:
        for file, (_, draw) in topic.pictures.items():
            draw(out / file)
    page.write(out / PAGE, {topic.part: page.body(topic) for topic in found})
    print(f"written: {out / PAGE}, {', '.join(file for topic in found for file in topic.pictures)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.run", description="Measure the cost of results of jaxvibro and others."
    )
    parser.add_argument("--limit", metavar="DIR", default=os.environ.get("LIMIT"), help="folder of the kernel")
    parser.add_argument("--quick", action="store_true", help="fewer states and rounds, written to out/")
    parser.add_argument("--out", metavar="DIR", help="output folder (docs, or out with --quick)")
    parser.add_argument("--part", choices=page.PARTS, help="measure only this part of the page")
    given = parser.parse_args()
    folder = pathlib.Path(given.out or ("out" if given.quick else "docs"))
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    main(given.limit, given.quick, folder, given.part)
