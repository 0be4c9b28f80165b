"""One picture of each kind that the package draws, 8.6 cm wide, as in a column of a journal:
`python -m tests.pictures keep` writes those that `test_pictures` compares with, `python -m tests.pictures show FOLDER`
finer ones to look at, each in colour and in grey.
"""

import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import jaxvibro as jv

KEPT = Path(__file__).parent / "pictures"
WIDE = 8.6 / 2.54  # inches
DOTS, FINE = 100, 300  # per inch: of what is kept, and of what is looked at
STYLE = {"font.size": 7.0, "axes.linewidth": 0.6, "savefig.facecolor": "white"}
RIG = {"mass": 0.5, "stiffness": 3e4, "restitution": 0.7, "damping_ratio": 0.05}
BOUNDS = {"amplitude": (0.0, 6.0), "frequency": (1.6, 2.6)}
LANDING = jv.State(0.9, -1.1)


def tube():
    return jv.scene_from_physical(**RIG, force=69.75, frequency_hz=2.1 * np.sqrt(6e4) / (2 * np.pi), gap=0.5e-3)


def unlike():
    return jv.make_scene(3.1, 1.9, 0.06, 0.75, (jv.Wall(-1.1, 0.6), jv.Wall(0.9, motion=jv.Motion(0.15, 0.4, 2))))


@lru_cache
def orbits():
    return jv.find_orbits(tube(), max_period=1, starts=40)


@lru_cache
def branches():
    return jv.follow(jv.find_orbit(tube(), LANDING), "amplitude", (0.0, 6.0)), jv.follow(
        jv.find_orbit(tube().replace(amplitude=2.0), jv.State(0.0, 0.0)), "amplitude", (0.0, 6.0)
    )


@lru_cache
def swept():
    ways = np.stack([np.linspace(0.3, 5.7, 46), np.linspace(5.7, 0.3, 46)], -1)
    return jv.sweep(tube(), "amplitude", ways, jv.State(0.1, 0.0), settle=200, keep=2).rename(lane="leg")


def saddles():
    return [one for one in orbits() if abs(one.multipliers[0]) > 1.0 > abs(one.multipliers[1])]


def axes(rows=1, high=2.6):
    return Figure(figsize=(WIDE, high), layout="constrained").subplots(rows, 1, squeeze=False)[:, 0]


def diagram():
    (ax,) = axes()
    return jv.plot.diagram(swept(), "x", ax, units="physical").legend()


def over_branches():
    (ax,) = axes(high=4.4)
    jv.plot.diagram(swept(), "x", ax, faint=True)
    for one in branches():
        jv.plot.branch(one, "x", ax)
    jv.plot.mark(jv.find_attractors(tube(), starts=40), 4.65, "x", ax)
    jv.plot.mark_points(branches(), ax)
    return ax.figure.legend(loc="outside lower center", fontsize="x-small", ncols=2, frameon=False)


def _speeds(variable, **more):
    (ax,) = axes()
    for one in branches():
        jv.plot.branch(one, variable, ax, **more)
    return ax.legend()


def speed():
    return _speeds("speed", units="physical", labels="auto")


def clearance():
    return _speeds("clearance")


def orbit():
    places = axes(2, 4.6)
    stable = next(one for one in orbits() if one.stable)
    for ax, one in zip(places, (stable, saddles()[0]), strict=True):
        jv.plot.orbit(one, ax)
    return places[0]


def marked_orbits():
    (ax,) = axes()
    jv.plot.diagram(swept(), "v", ax)
    return jv.plot.mark_orbits(orbits(), 4.65, "v", ax).legend(fontsize="x-small", loc="upper left")


def motion():
    places = axes(2, 4.2)
    found = jv.simulate(unlike(), LANDING, 3, 300)
    jv.plot.portrait(found, unlike(), places[0])
    return jv.plot.trace(found, unlike(), places[1])


def basins():
    (ax,) = axes(high=3.6)
    found = jv.basins(tube(), np.linspace(-0.999, 0.999, 121), np.linspace(-6.0, 6.0, 121))
    return jv.plot.basins(found, ax)


def manifolds():
    (ax,) = axes()
    for kind in ("stable", "unstable"):
        jv.plot.manifold(jv.manifold(saddles()[0], kind, length=6.0, phase=0.0), ax)
    return ax.legend()


def sections():
    places = axes(2, 4.2)
    slow = jv.make_scene(3.1, 1.9, 0.002, 0.97, (-1.1, 0.9))  # long on its way to where it settles
    found = jv.sections(slow, LANDING, periods=300, settle=0)
    jv.plot.section(found, "sigma", places[0])
    return jv.plot.section(found, "right", places[1])


def spectrum():
    (ax,) = axes()
    found = jv.spectrum(tube(), "amplitude", np.linspace(4.2, 5.3, 12), LANDING, error=0.02)
    return jv.plot.spectrum(found, ax).legend()


def shares():
    (ax,) = axes(high=3.4)
    return jv.plot.fractions(jv.fractions(tube(), "amplitude", np.linspace(4.5, 5.0, 6), 60), ax, units="physical")


def loci():
    (ax,) = axes(high=3.4)
    points = [branches()[1].points(kind)[0] for kind in ("SN", "GR")]
    both = [jv.locus(one, ("amplitude", "frequency"), BOUNDS) for one in points]
    for one in both:
        jv.plot.locus(one, ax)
    jv.plot.region(*both, "P100 and P111", ax)
    jv.plot.held(jv.follow(jv.find_orbit(tube(), LANDING), tuple(BOUNDS), BOUNDS, hold={"least_speed": 2.8}), ax)
    return ax.legend(fontsize="x-small")


def margins():
    places = axes(2, 5.0)
    one = jv.find_orbit(tube(), LANDING)
    for ax, more in zip(places, ({}, {"damping": 0.01}), strict=True):
        jv.plot.margin(jv.margin(one, {"amplitude": 0.1, "frequency": 0.05} | more, directions=16), ax)
    return places[0]


def fit():
    (ax,) = axes()
    rng = np.random.default_rng(3)
    _, impacts = jv.strobe(unlike(), LANDING, periods=20, slots=64)
    sides = np.asarray(impacts.side)[: int(impacts.count)]
    times = np.asarray(impacts.time)[: sides.size] + 1e-3 * rng.normal(size=sides.size)
    record = jv.ImpactRecord(times, sides, sigma=1e-3)
    return jv.plot.fit(jv.fit(unlike().replace(damping=0.07), record, free={"damping": 0.01}), record, ax)


PICTURES: tuple[Callable, ...] = (diagram, over_branches, speed, clearance, orbit, marked_orbits, motion)
PICTURES += (basins, manifolds, sections, spectrum, shares, loci, margins, fit)


def write(draw, path, dots):
    """One picture into a file."""
    with mpl.rc_context({"figure.dpi": dots, **STYLE}):
        draw().figure.savefig(path, dpi=dots)


def grey(path):
    """A picture's file beside it, in shades of grey as a printer makes them."""
    shades = plt.imread(path)[..., :3] @ [0.299, 0.587, 0.114]
    plt.imsave(path.with_suffix(".grey.png"), shades, cmap="gray", vmin=0.0, vmax=1.0)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, *rest = sys.argv[1:]
    folder = KEPT if what == "keep" else Path(*rest)
    folder.mkdir(parents=True, exist_ok=True)
    for draw in PICTURES:
        file = folder / f"{draw.__name__}.png"
        write(draw, file, DOTS if what == "keep" else FINE)
        if what != "keep":
            grey(file)
        print(file.name, flush=True)
