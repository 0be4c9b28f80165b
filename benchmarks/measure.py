"""Measures everything, and writes the page and its pictures at the end. `benchmarks.run` starts it on one core."""

import argparse
import os
import pathlib
import time

import jax

from benchmarks import branches, derivatives, first, kernel, limit, loci, machine, orbits, page, rigid, scenes, soft
from benchmarks.rows import Size, Topic

PAGE = "benchmarks.md"
SMALL = (
    "**Measured in small, to see that it runs**: a sixteenth of the states that rows name, two rounds, few questions."
)


def topics(yardstick, size):
    """Each part of the page as it is measured. Those of fresh processes come first, while this one is small."""
    yield partly("first answers", first.measure, size)
    yield partly("scenes", scenes.measure, size)
    yield partly("yardstick", kernel.measure, yardstick, size)
    yield partly("map", rigid.measure, yardstick, size)
    yield partly("derivatives", derivatives.measure, size)
    yield partly("orbits", orbits.measure, size)
    yield partly("branches", branches.measure, size)
    yield partly("loci", loci.measure, size)
    yield partly("soft walls", soft.measure, size)


def partly(part, measure, *given):
    """A part's `Topic`; what was compiled for it is let go."""
    print(f"{part}:", flush=True)
    begun = time.monotonic()
    topic = measure(*given)
    jax.clear_caches()
    print(f"  {time.monotonic() - begun:.0f} s in all", flush=True)
    return topic


def main(directory, quick, out):
    """Measure, then write the page and its pictures into a folder."""
    yardstick, line = limit.found(directory)
    print(f"yardstick: {line}")
    found = list(topics(yardstick, Size(quick)))
    about = (*machine.describe(), f"Yardstick: {line}", *([SMALL] if quick else []))
    for topic in (found := [Topic("machine", [], notes=about), *found]):
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
    given = parser.parse_args()
    folder = pathlib.Path(given.out or ("out" if given.quick else "docs"))
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    main(given.limit, given.quick, folder)
