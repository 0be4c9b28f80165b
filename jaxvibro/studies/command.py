"""The command line. Nothing heavy is loaded before there is work: `jaxvibro --help` answers at once."""

import argparse
import gc
import json
import os
import signal
import sys
import webbrowser
from importlib import import_module

import jaxvibro as jv

from .. import __version__
from ..output.atomic_write import whole
from . import jax_settings, scene_template

BAD, INTERRUPTED = 2, 130
LONGEST = 300  # characters of a complaint
EXTRAS = {"distributed": "cluster", "cloudpickle": "cluster", "tornado": "view"}  # modules: what brings them
ENVIRONMENT = "jaxvibro.studies.environment"
MOST_WORKERS = 4  # of `paper`: each takes a gigabyte and more

_RUN = """Does what a scene file asks: a [sweep] is drawn, [attractors] are looked for from many starts, and so are
periodic [orbits], stable and unstable; a [branch] of them is followed along a parameter, with the branches that leave
it, or all branches are found by themselves ([explore]); a [locus] follows their special points in two parameters; a
[margin] tells how far the nearest bifurcations of an orbit are; a [fit] which numbers made a record of impacts, a CSV
file; a [map] tells what each cell of a grid over two parameters settles on, and goes on where it was interrupted; a
scene with none of these is followed from rest. Walls are rigid or soft. Writes DIR/NAME.png, NAME.nc and NAME.txt, for
a scene file NAME.toml, with a [locus] NAME.loci.png, with a [margin] NAME.margin.png, with a [map] NAME.map.png and
NAME.zarr, for a [map] alone no other picture. The tables [spectrum], [basins] and [panels] are for paper,
[[view]] for view."""
_PAPER = """Recomputes figures 2 to 12 of Cheng and Xu (2007), its formulas and what it says of one wall and of walls
that move, and judges every claim by numbers. Writes DIR/report.html, DIR/report.md and, for each NAME, NAME.json (the
claims) and, where there are such, NAME.png and NAME.nc. What an earlier run has done is kept: an interrupted one goes
on where it stopped."""
_SHOW = """Shows a [map] that is kept, as far as it is done: prints its table and draws its picture."""
_VIEW = """Shows a scene on a page in the browser: its branches, what is clicked, the attractor as sliders move. What
the file asks for is looked at first; a scene file that the page gave is gone on with. The page is served to this
machine alone, to whoever has the address that is printed; ends with Ctrl-C."""
_WARM = """Asks of a scene what is asked first (a strobe, an orbit, its branch, those that leave it, loci), all of it
compiled, so that later processes compile nothing for scenes with the same kinds of walls. It takes half a minute and
more, a minute and more with soft walls; a session in Python finds what is kept with the settings that are printed."""
_REPORT = """Prints versions, processor, settings of JAX, compiler hints and the cache folder, as the commands use them.
Add it to a report of a fault."""
_SET = """another value for this run, both as in the scene file: --set sweep.count=201. The "scene." may go:
--set amplitude=3. A text keeps its quotes: --set 'sweep.parameter="frequency"'. May be given more than once."""


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line."""

    def error(self, message):
        self.exit(BAD, f"{self.prog}: {_line(message)}\n")


def main(arguments=None):
    """Runs the command line; the exit code: 0, 2 on bad input, with one line on stderr, or 130 when interrupted."""
    try:
        given = _parser().parse_args(arguments)
    except SystemExit as end:
        return end.code
    try:
        given.does(given)
    except ModuleNotFoundError as error:
        if error.name not in EXTRAS:
            raise
        return _told(f"{error.name} is not installed: pip install 'jaxvibro[{EXTRAS[error.name]}]'", BAD)
    except KeyboardInterrupt:
        return _told("interrupted", INTERRUPTED)
    except MemoryError:
        return _told("there is not enough memory for this", BAD)
    except OSError as error:
        return _told(_complaint(error), BAD)
    except jv.ArgumentError as error:  # last: looking it up loads jax
        return _told(error, BAD)
    return 0


def _parser():
    parser = _Parser("jaxvibro", description="Vibro-impact oscillators with rigid and soft walls.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    init = commands.add_parser("init", help="write a scene file to begin with", allow_abbrev=False)
    init.description = "Writes a commented scene file to begin with."
    init.add_argument("path", metavar="PATH", nargs="?", default="scene.toml", help="default: scene.toml")
    init.add_argument("--force", action="store_true", help="overwrite what is there")
    init.set_defaults(does=_init)

    run = commands.add_parser("run", help="do what a scene file asks", description=_RUN, allow_abbrev=False)
    run.add_argument("scene", metavar="SCENE", help="a scene file")
    run.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="changes", help=_SET)
    run.add_argument("--out", metavar="DIR", default="out", help="folder to write into; default: out")
    run.add_argument("--force", action="store_true", help="overwrite what is there")
    run.add_argument("--json", action="store_true", help="print a summary for machines, and only that, on stdout")
    run.add_argument("--csv", action="store_true", help="write tables for spreadsheets too, a row a point")
    told = (
        "of tables and pictures: those of the scene, or N, Hz, mm, m/s, W where it has [scene.scales]; default: scene"
    )
    run.add_argument("--units", choices=("scene", "physical"), default="scene", help=told)
    run.add_argument("--engine", choices=("local", "dask"), help="who works out a [map]; default: local, this process")
    run.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that is there, as tcp://host:8786")
    told = "chunks of a [map] at a time; default: one for each processor core"
    run.add_argument("--workers", metavar="N", type=int, help=told)
    run.set_defaults(does=_run)

    show = commands.add_parser("show", help="show a map that is kept", description=_SHOW, allow_abbrev=False)
    show.add_argument("path", metavar="STORE", help="the folder of a map, NAME.zarr")
    show.add_argument("--picture", metavar="FILE", help="default: NAME.png beside it")
    show.add_argument("--data", metavar="FILE", help="write all of it as a NetCDF file too")
    show.add_argument("--force", action="store_true", help="overwrite what is there")
    show.add_argument("--units", choices=("scene", "physical"), default="scene", help="of the table and the picture")
    show.set_defaults(does=_show)

    paper = commands.add_parser("paper", help="recompute the paper", description=_PAPER, allow_abbrev=False)
    paper.add_argument("names", metavar="NAME", nargs="*", help="fig2 to fig12, walls, formulas; default: all")
    paper.add_argument("--scenes", metavar="DIR", help="folder of the scene files; default: those of the package")
    paper.add_argument("--out", metavar="DIR", default="out/paper", help="folder to write into; default: out/paper")
    paper.add_argument("--force", action="store_true", help="compute again what is there already")
    told = f"figures at once; default: one for each processor core, at most {MOST_WORKERS}"
    paper.add_argument("--workers", metavar="N", type=int, default=min(MOST_WORKERS, os.cpu_count() or 1), help=told)
    paper.set_defaults(does=_paper)

    view = commands.add_parser("view", help="explore a scene in the browser", description=_VIEW, allow_abbrev=False)
    view.add_argument("scene", metavar="SCENE", help="a scene file")
    view.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="changes", help=_SET)
    told = "of this machine's own, default: 127.0.0.1"
    view.add_argument("--address", metavar="ADDRESS", default="127.0.0.1", help=told)
    told = "default: the first free one of 8420 to 8439; the same one again lets a page of before go on"
    view.add_argument("--port", metavar="N", type=int, help=told)
    view.add_argument("--no-browser", action="store_true", help="print the address, and open nothing")
    view.set_defaults(does=_view)

    warm = commands.add_parser("warm", help="fill the compile cache", description=_WARM, allow_abbrev=False)
    warm.add_argument("scene", metavar="SCENE", nargs="?", help="a scene file; default: the README's scene")
    warm.set_defaults(does=_warm)

    told = "print versions, processor and settings, for reports of faults"
    report = commands.add_parser("report", help=told, description=_REPORT, allow_abbrev=False)
    report.add_argument("--json", action="store_true", help="print it for machines")
    report.set_defaults(does=_report)
    return parser


def _init(given):
    with whole(given.path, given.force) as file:
        file.write(scene_template.SCENE.encode())
    print(f"wrote {given.path}; next: jaxvibro run {given.path}")


def _run(given):
    jax_settings.prepare()
    asked = {"csv": given.csv, "units": given.units, "engine": _engine(given)}
    done = _loaded("run")(given.scene, given.out, given.changes, given.force, progress=True, **asked)
    if given.json:
        print(json.dumps(done.summary, indent=2, allow_nan=False))
        return
    print(done.table)
    for kind, path in done.summary["files"].items():
        print(f"{kind:17}{path}" if len(kind) > 7 else f"{kind:8}{path}")


def _engine(given):
    """Who works out a map, None for this process with all of its cores."""
    if given.engine == "dask" or (given.scheduler is not None and given.engine is None):
        return _loaded("DaskEngine")(given.scheduler, given.workers)
    if given.scheduler is not None:
        raise jv.ArgumentError("scheduler", "must not be given with the engine local", given.scheduler)
    return None if given.workers is None else _loaded("LocalEngine")(given.workers)


def _show(given):
    jax_settings.prepare()
    picture = given.picture or os.path.splitext(given.path.rstrip(os.sep))[0] + ".png"
    print(_loaded("show")(given.path, picture, given.data, given.force, given.units))
    for kind, path in (("picture", picture), ("data", given.data)):
        if path:
            print(f"{kind:8}{path}")


def _view(given):
    jax_settings.prepare()
    page = _loaded("view")(given.scene, given.port, given.address, given.changes, jax_settings.token())
    print(page.url, flush=True)
    if not given.no_browser:
        webbrowser.open(page.url)
    try:
        page.wait()
    except KeyboardInterrupt:
        page.stop()


def _paper(given):
    jax_settings.prepare()
    done = _loaded("paper")(given.names, given.out, given.scenes, given.force, progress=True, workers=given.workers)
    print(done.told)
    for kind, path in (("page", done.page), ("text", done.text)):
        print(f"{kind:8}{path}")


def _warm(given):
    kept = jax_settings.prepare()
    scene = _loaded("load_scene")(given.scene) if given.scene else None
    done = _loaded("warm")(scene, lambda what: print(f"{what} ...", file=sys.stderr))
    for what, seconds in done.done:
        print(f"{what:16}{seconds:6.1f} s of processor time")
    for what in done.left:
        print(f"left out: {_line(what)}")
    print("kept; for a session in Python:")
    for name, value in kept.items():
        print(f"export {name}={value}")


def _report(given):
    jax_settings.prepare()
    described = _loaded("describe_environment", ENVIRONMENT)()
    print(json.dumps(described, indent=2) if given.json else _loaded("format_environment", ENVIRONMENT)(described))


def _loaded(name, home=None):
    """A function of the package, or of a module of it, once all that it needs is loaded. Until then an interrupt ends
    the process at once: one in the middle of loading compiled modules would end in a crash. What is loaded stays:
    Python's collector of circles need not look at it, now or later."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    try:
        return getattr(import_module(home) if home else jv, name)
    finally:
        gc.freeze()
        gc.enable()
        signal.signal(signal.SIGINT, before)


def _complaint(error):
    if error.strerror:
        return f"{str(error.filename)[-LONGEST // 2 :]}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _told(message, code):
    print(f"jaxvibro: {_line(message)}", file=sys.stderr)
    return code


def _line(text):
    return " ".join(str(text)[: 10 * LONGEST].split())[:LONGEST]
