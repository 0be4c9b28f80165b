"""One picture of each kind that the package draws, 8.6 cm wide, as in a column of a journal:
`python -m tests.pictures keep` writes those that `test_pictures` compares with, `python -m tests.pictures show FOLDER`
finer ones to look at, each in colour and in grey.
"""

import sys
from functools import lru_cache, wraps
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
PICTURES = []


def tube():
    return jv.scene_from_physical(**RIG, force=69.75, frequency_hz=2.1 * np.sqrt(6e4) / (2 * np.pi), gap=0.5e-3)


def unlike():
    return jv.make_scene(3.1, 1.9, 0.06, 0.75, (jv.Wall(-1.1, 0.6), jv.Wall(0.9, motion=jv.Motion(0.15, 0.4, 2))))


@lru_cache
def orbits():
    return jv.find_orbits(tube(), max_period=1, starts=40)


@lru_cache
def branches():
    starts = jv.find_orbit(tube(), LANDING), jv.find_orbit(tube().replace(amplitude=2.0), jv.State(0.0, 0.0))
    return [jv.follow(start, "amplitude", (0.0, 6.0)) for start in starts]


@lru_cache
def swept():
    legs = np.stack([np.linspace(0.3, 4.9, 46), np.linspace(4.9, 0.3, 46)], -1)
    return jv.sweep(tube(), "amplitude", legs, jv.State(0.1, 0.0), settle=200, keep=2).rename(lane="leg")


def saddle():
    return next(one for one in orbits() if abs(one.multipliers[0]) > 1.0 > abs(one.multipliers[1]))


def picture(rows=1, high=2.6):
    """Make a picture of a function that draws into Axes, one below the other: a function that returns the Figure."""

    def decorate(draw):
        @wraps(draw)
        def drawn():
            figure = Figure(figsize=(WIDE, high), layout="constrained")
            draw(*figure.subplots(rows, 1, squeeze=False)[:, 0])
            return figure

        PICTURES.append(drawn)
        return drawn

    return decorate


@picture()
def diagram(ax):
    jv.plot.diagram(swept(), "x", ax, units="physical").legend(loc="lower right")


@picture(high=4.4)
def over_branches(ax):
    jv.plot.diagram(swept(), "x", ax, faint=True)
    for one in branches():
        jv.plot.branch(one, "x", ax)
    jv.plot.mark(jv.find_attractors(tube(), starts=40), 4.65, "x", ax)
    jv.plot.mark_points(branches(), ax)
    ax.figure.legend(loc="outside lower center", fontsize="x-small", ncols=2, frameon=False)


@picture()
def speed(ax):
    for one in branches():
        jv.plot.branch(one, "speed", ax, units="physical", labels="auto")
    ax.legend(loc="upper left")  # not "best": which is best may depend on roundings


@picture()
def clearance(ax):
    for one in branches():
        jv.plot.branch(one, "clearance", ax)
    ax.legend(loc="upper left")


@picture(2, 4.6)
def orbit(above, below):
    jv.plot.orbit(next(one for one in orbits() if one.stable), above)
    jv.plot.orbit(saddle(), below)


@picture()
def marked_orbits(ax):
    jv.plot.diagram(swept(), "v", ax)
    jv.plot.mark_orbits(orbits(), 4.65, "v", ax).legend(fontsize="x-small", loc="upper left")


@picture(2, 4.2)
def motion(above, below):
    path = jv.simulate(unlike(), LANDING, 3, 300)
    jv.plot.portrait(path, unlike(), above)
    jv.plot.trace(path, unlike(), below)


@picture(high=3.6)
def basins(ax):
    jv.plot.basins(jv.basins(tube(), np.linspace(-0.999, 0.999, 121), np.linspace(-6.0, 6.0, 121)), ax)


@picture()
def manifolds(ax):
    for kind in ("stable", "unstable"):
        jv.plot.manifold(jv.manifold(saddle(), kind, length=6.0, phase=0.0), ax)
    ax.legend(loc="upper left")


@picture(2, 4.2)
def sections(above, below):
    slow = jv.make_scene(3.1, 1.9, 0.002, 0.97, (-1.1, 0.9))  # long on its way to where it settles
    points = jv.sections(slow, LANDING, periods=300, settle=0)
    jv.plot.section(points, "sigma", above)
    jv.plot.section(points, "right", below)


@picture()
def spectrum(ax):
    exponents = jv.spectrum(tube(), "amplitude", np.linspace(4.2, 5.3, 12), LANDING, error=0.02)
    jv.plot.spectrum(exponents, ax).legend(loc="lower right")
    ax.set_ylim(-3.0, 0.7)


@picture(high=3.4)
def shares(ax):
    jv.plot.fractions(jv.fractions(tube(), "amplitude", np.linspace(4.5, 5.0, 6), 60), ax, units="physical")


@picture(high=3.4)
def loci(ax):
    both = [jv.locus(branches()[1].points(kind)[0], ("amplitude", "frequency"), BOUNDS) for kind in ("SN", "GR")]
    for one in both:
        jv.plot.locus(one, ax)
    jv.plot.region(*both, "P100 and P111", ax)
    jv.plot.held(jv.follow(jv.find_orbit(tube(), LANDING), tuple(BOUNDS), BOUNDS, hold={"least_speed": 2.8}), ax)
    ax.legend(fontsize="x-small", loc="upper left")


@picture(2, 5.0)
def margins(above, below):
    for ax, more in ((above, {}), (below, {"damping": 0.01})):
        free = {"amplitude": 0.1, "frequency": 0.05} | more
        jv.plot.margin(jv.margin(jv.find_orbit(tube(), LANDING), free, directions=16), ax)


@picture()
def fit(ax):
    rng = np.random.default_rng(3)
    _, impacts = jv.strobe(unlike(), LANDING, periods=20, slots=64)
    sides = np.asarray(impacts.side)[: int(impacts.count)]
    times = np.asarray(impacts.time)[: sides.size] + 1e-3 * rng.normal(size=sides.size)
    record = jv.ImpactRecord(times, sides, sigma=1e-3)
    jv.plot.fit(jv.fit(unlike().replace(damping=0.07), record, free={"damping": 0.01}), record, ax)


def write(draw, path, dots):
    """Write a picture into a file."""
    with mpl.rc_context({"figure.dpi": dots, **STYLE}):
        draw().savefig(path, dpi=dots)


def main(command, folder=KEPT):
    """Write all pictures: those to keep, or finer ones and others in shades of grey, as a printer makes them."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    for draw in PICTURES:
        path = Path(folder) / f"{draw.__name__}.png"
        write(draw, path, DOTS if command == "keep" else FINE)
        if command != "keep":
            shades = plt.imread(path)[..., :3] @ [0.299, 0.587, 0.114]
            plt.imsave(path.with_suffix(".grey.png"), shades, cmap="gray", vmin=0.0, vmax=1.0)
        print(path.name, flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(*sys.argv[1:])
