"""Count, draw and write reliability.md: `python -m reliability.run [--quick] [--out DIR] [--part NAME]`.

Two parts are measured at a time, each in a process of its own.
"""

import argparse
import multiprocessing
import os
import pathlib
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import jax

from benchmarks import machine, page
from benchmarks.rows import Size, Topic

from . import (
    branches,
    cases,
    counts,
    curves,
    failure_maps,
    hard_walls,
    limits,
    map_pictures,
    met_by_others,
    near_grazing,
)

PAGE, COMMAND = "reliability.md", "make reliability"
PARTS = {
    "machine": "Machine and date",
    "counts": "Hard cases",
    "speeds": "Impacts by speed",
    "pictures": "Error as a function of the difficulty",
    "maps": "Failure maps",
    "limits": "Limit cases",
    "branches": "Continuation",
    "met by others": "Cases reported by users of other packages",
}
CASES = {case.name: case for case in (*cases.CASES, cases.WHOLE, cases.DOUBT)}
SPEEDS = ("starts into a wall", "slow impacts")
CURVES = {
    "missed_by_depth.png": near_grazing.missed_by_depth,
    "error_by_speed.png": near_grazing.error_by_speed,
    "error_of_rest.png": hard_walls.error_of_rest,
    "error_by_stiffness.png": hard_walls.error_by_stiffness,
    "derivative_error.png": near_grazing.derivative_error,
}
MAPS = dict(zip(("failures_amplitude_omega.png", "failures_restitution_gamma.png"), failure_maps.MAPS, strict=True))


def task(kind, name, size):
    """Measure one item, by its name in a table above."""
    jax.config.update("jax_enable_x64", True)
    begun = time.monotonic()
    if kind == "counts":
        found = counts.of_case(CASES[name], size)
    elif kind == "speeds":
        found = counts.by_speed(CASES[name], size)
    elif kind == "pictures":
        found = CURVES[name](size)
    elif kind == "maps":
        found = failure_maps.measure(MAPS[name], failure_maps.MAPS[MAPS[name]], size)
    elif kind == "limits":
        found = limits.measure(size)
    elif kind == "branches":
        found = branches.table(branches.measure(size))
    else:
        found = met_by_others.table(met_by_others.measure())
    print(f"  {kind}, {name}: {time.monotonic() - begun:.0f} s", flush=True)
    return found


def tasks():
    """Return (part, name) of all items, the longest first."""
    parts = {
        "maps": MAPS,
        "counts": CASES,
        "speeds": SPEEDS,
        "limits": ("limits",),
        "pictures": CURVES,
        "branches": ("table",),
        "met by others": ("table",),
    }
    return [(part, name) for part, names in parts.items() for name in names]


def topics(found, count):
    """Return the `Topic` objects of the results; `count` is the number of periods of a map."""
    given = {part: {name: answer for (own, name), answer in found.items() if own == part} for part in PARTS}
    if given["counts"]:
        named = {CASES[name]: answer for name, answer in given["counts"].items()}
        yield Topic("counts", [], (counts.table(named), counts.described(named)), counts.NOTES)
    if given["speeds"]:
        yield Topic("speeds", [], (counts.speeds_table(given["speeds"]),))
    if given["pictures"]:
        drawn = {file: (each.what, partial(curves.save, curves=each)) for file, each in given["pictures"].items()}
        yield Topic("pictures", [], pictures=drawn)
    if given["maps"]:
        named = {", ".join(answer.names): answer for answer in given["maps"].values()}
        drawn = {
            file: (
                f"Wrong itineraries over {' and '.join(answer.names)}",
                partial(map_pictures.save, found=answer, count=count),
            )
            for file, answer in given["maps"].items()
        }
        yield Topic("maps", [], (map_pictures.table(named, count),), failure_maps.NOTES, drawn)
    if given["limits"]:
        yield Topic("limits", given["limits"]["limits"])
    if given["branches"]:
        yield Topic("branches", [], (given["branches"]["table"],), branches.NOTES)
    if given["met by others"]:
        yield Topic("met by others", [], (given["met by others"]["table"],))


def main(quick, out, only):
    """Measure, then write the page and its pictures into a folder."""
    size, count = Size(quick), 10 if quick else failure_maps.PERIODS
    wanted = [each for each in tasks() if only in (None, each[0])]
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        answers = [pool.submit(task, *each, size) for each in wanted]
        found = {each: answer.result() for each, answer in zip(wanted, answers, strict=True)}
    parts = list(topics(found, count))
    if not only:
        parts = [Topic("machine", [], notes=machine.describe()), *parts]
    for topic in parts:
        for file, (_, draw) in topic.pictures.items():
            draw(out / file)
    texts = {topic.part: page.body(topic) for topic in parts}
    page.write(out / PAGE, texts, page.blank("Reliability", PARTS, COMMAND), COMMAND)
    print(f"written: {out / PAGE}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m reliability.run", description="Count the failures of methods, ours and others."
    )
    parser.add_argument("--quick", action="store_true", help="few flights, to check that it runs, written to out/")
    parser.add_argument("--out", metavar="DIR", help="output folder (docs, or out with --quick)")
    parser.add_argument("--part", choices=[part for part in PARTS if part != "machine"], help="measure only this part")
    given = parser.parse_args()
    folder = pathlib.Path(given.out or ("out" if given.quick else "docs"))
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["JAX_PLATFORMS"] = "cpu"
    main(given.quick, folder, given.part)
