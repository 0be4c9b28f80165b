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
from ..output.atomic_write import atomic_file
from . import jax_settings, scene_template

EXIT_BAD_INPUT, EXIT_INTERRUPTED = 2, 130
MAX_MESSAGE_LENGTH = 300  # characters of a complaint
EXTRA_OF_MODULE = {"distributed": "cluster", "cloudpickle": "cluster", "tornado": "view"}  # modules: what brings them
ENVIRONMENT_MODULE = "jaxvibro.studies.environment"
MAX_WORKERS = 4  # of `paper`: each takes a gigabyte and more

_RUN_HELP = """Does what a scene file asks: a [sweep] is drawn, [attractors] are looked for from many starts, and so are
periodic [orbits], stable and unstable; a [branch] of them is followed along a parameter, with the branches that leave
it, or all branches are found by themselves ([explore]); a [locus] follows their special points in two parameters; a
[margin] tells how far the nearest bifurcations of an orbit are; a [fit] which numbers made a record of impacts, a CSV
file; a [map] tells what each cell of a grid over two parameters settles on, and goes on where it was interrupted; a
scene with none of these is followed from rest. Walls are rigid or soft. Writes DIR/NAME.png, NAME.nc and NAME.txt, for
a scene file NAME.toml, with a [locus] NAME.loci.png, with a [margin] NAME.margin.png, with a [map] NAME.map.png and
NAME.zarr, for a [map] alone no other picture. The tables [spectrum], [basins] and [panels] are for paper,
[[view]] for view."""
_PAPER_HELP = """\
Recomputes figures 2 to 12 of Cheng and Xu (2007), its formulas and what it says of one wall and of walls
that move, and judges every claim by numbers. Writes DIR/report.html, DIR/report.md and, for each NAME, NAME.json (the
claims) and, where there are such, NAME.png and NAME.nc. What an earlier run has done is kept: an interrupted one goes
on where it stopped."""
_SHOW_HELP = """Shows a [map] that is kept, as far as it is done: prints its table and draws its picture."""
_VIEW_HELP = """\
Shows a scene on a page in the browser: its branches, what is clicked, the attractor as sliders move. What
the file asks for is looked at first; a scene file that the page gave is gone on with. The page is served to this
machine alone, to whoever has the address that is printed; ends with Ctrl-C."""
_WARM_HELP = """\
Asks of a scene what is asked first (a strobe, an orbit, its branch, those that leave it, loci), all of it
compiled, so that later processes compile nothing for scenes with the same kinds of walls. It takes half a minute and
more, a minute and more with soft walls; a session in Python finds what is kept with the settings that are printed."""
_REPORT_HELP = """\
Prints versions, processor, settings of JAX, compiler hints and the cache folder, as the commands use them.
Add it to a report of a fault."""
_SET_HELP = """another value for this run, both as in the scene file: --set sweep.count=201. The "scene." may go:
--set amplitude=3. A text keeps its quotes: --set 'sweep.parameter="frequency"'. May be given more than once."""


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line."""

    def error(self, message):
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {_single_line(message)}\n")


def main(arguments=None):
    """Runs the command line; the exit code: 0, 2 on bad input, with one line on stderr, or 130 when interrupted."""
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as system_exit:
        return system_exit.code
    try:
        options.does(options)
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_OF_MODULE:
            raise
        return _report_error(
            f"{error.name} is not installed: pip install 'jaxvibro[{EXTRA_OF_MODULE[error.name]}]'", EXIT_BAD_INPUT
        )
    except KeyboardInterrupt:
        return _report_error("interrupted", EXIT_INTERRUPTED)
    except MemoryError:
        return _report_error("there is not enough memory for this", EXIT_BAD_INPUT)
    except OSError as error:
        return _report_error(_os_error_text(error), EXIT_BAD_INPUT)
    except jv.ArgumentError as error:  # last: looking it up loads jax
        return _report_error(error, EXIT_BAD_INPUT)
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

    run = commands.add_parser("run", help="do what a scene file asks", description=_RUN_HELP, allow_abbrev=False)
    run.add_argument("scene", metavar="SCENE", help="a scene file")
    run.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="changes", help=_SET_HELP)
    run.add_argument("--out", metavar="DIR", default="out", help="folder to write into; default: out")
    run.add_argument("--force", action="store_true", help="overwrite what is there")
    run.add_argument("--json", action="store_true", help="print a summary for machines, and only that, on stdout")
    run.add_argument("--csv", action="store_true", help="write tables for spreadsheets too, a row a point")
    help_text = (
        "of tables and pictures: those of the scene, or N, Hz, mm, m/s, W where it has [scene.scales]; default: scene"
    )
    run.add_argument("--units", choices=("scene", "physical"), default="scene", help=help_text)
    run.add_argument("--engine", choices=("local", "dask"), help="who works out a [map]; default: local, this process")
    run.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that is there, as tcp://host:8786")
    help_text = "chunks of a [map] at a time; default: one for each processor core"
    run.add_argument("--workers", metavar="N", type=int, help=help_text)
    run.set_defaults(does=_run)

    show = commands.add_parser("show", help="show a map that is kept", description=_SHOW_HELP, allow_abbrev=False)
    show.add_argument("path", metavar="STORE", help="the folder of a map, NAME.zarr")
    show.add_argument("--picture", metavar="FILE", help="default: NAME.png beside it")
    show.add_argument("--data", metavar="FILE", help="write all of it as a NetCDF file too")
    show.add_argument("--force", action="store_true", help="overwrite what is there")
    show.add_argument("--units", choices=("scene", "physical"), default="scene", help="of the table and the picture")
    show.set_defaults(does=_show)

    paper = commands.add_parser("paper", help="recompute the paper", description=_PAPER_HELP, allow_abbrev=False)
    paper.add_argument("names", metavar="NAME", nargs="*", help="fig2 to fig12, walls, formulas; default: all")
    paper.add_argument("--scenes", metavar="DIR", help="folder of the scene files; default: those of the package")
    paper.add_argument("--out", metavar="DIR", default="out/paper", help="folder to write into; default: out/paper")
    paper.add_argument("--force", action="store_true", help="compute again what is there already")
    help_text = f"figures at once; default: one for each processor core, at most {MAX_WORKERS}"
    paper.add_argument(
        "--workers", metavar="N", type=int, default=min(MAX_WORKERS, os.cpu_count() or 1), help=help_text
    )
    paper.set_defaults(does=_paper)

    view = commands.add_parser(
        "view", help="explore a scene in the browser", description=_VIEW_HELP, allow_abbrev=False
    )
    view.add_argument("scene", metavar="SCENE", help="a scene file")
    view.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="changes", help=_SET_HELP)
    help_text = "of this machine's own, default: 127.0.0.1"
    view.add_argument("--address", metavar="ADDRESS", default="127.0.0.1", help=help_text)
    help_text = "default: the first free one of 8420 to 8439; the same one again lets a page of before go on"
    view.add_argument("--port", metavar="N", type=int, help=help_text)
    view.add_argument("--no-browser", action="store_true", help="print the address, and open nothing")
    view.set_defaults(does=_view)

    warm = commands.add_parser("warm", help="fill the compile cache", description=_WARM_HELP, allow_abbrev=False)
    warm.add_argument("scene", metavar="SCENE", nargs="?", help="a scene file; default: the README's scene")
    warm.set_defaults(does=_warm)

    help_text = "print versions, processor and settings, for reports of faults"
    report = commands.add_parser("report", help=help_text, description=_REPORT_HELP, allow_abbrev=False)
    report.add_argument("--json", action="store_true", help="print it for machines")
    report.set_defaults(does=_report)
    return parser


def _init(options):
    with atomic_file(options.path, options.force) as file:
        file.write(scene_template.SCENE_TEMPLATE.encode())
    print(f"wrote {options.path}; next: jaxvibro run {options.path}")


def _run(options):
    jax_settings.prepare_environment()
    settings = {"csv": options.csv, "units": options.units, "engine": _map_engine(options)}
    result = _load("run")(options.scene, options.out, options.changes, options.force, progress=True, **settings)
    if options.json:
        print(json.dumps(result.summary, indent=2, allow_nan=False))
        return
    print(result.table)
    for kind, path in result.summary["files"].items():
        print(f"{kind:17}{path}" if len(kind) > 7 else f"{kind:8}{path}")


def _map_engine(options):
    """Who works out a map, None for this process with all of its cores."""
    if options.engine == "dask" or (options.scheduler is not None and options.engine is None):
        return _load("DaskEngine")(options.scheduler, options.workers)
    if options.scheduler is not None:
        raise jv.ArgumentError("scheduler", "must not be given with the engine local", options.scheduler)
    return None if options.workers is None else _load("LocalEngine")(options.workers)


def _show(options):
    jax_settings.prepare_environment()
    picture = options.picture or os.path.splitext(options.path.rstrip(os.sep))[0] + ".png"
    print(_load("show")(options.path, picture, options.data, options.force, options.units))
    for kind, path in (("picture", picture), ("data", options.data)):
        if path:
            print(f"{kind:8}{path}")


def _view(options):
    jax_settings.prepare_environment()
    page = _load("view")(options.scene, options.port, options.address, options.changes, jax_settings.page_token())
    print(page.url, flush=True)
    if not options.no_browser:
        webbrowser.open(page.url)
    try:
        page.wait()
    except KeyboardInterrupt:
        page.stop()


def _paper(options):
    jax_settings.prepare_environment()
    report = _load("paper")(
        options.names, options.out, options.scenes, options.force, progress=True, workers=options.workers
    )
    print(report.told)
    for kind, path in (("page", report.page), ("text", report.text)):
        print(f"{kind:8}{path}")


def _warm(options):
    settings = jax_settings.prepare_environment()
    scene = _load("load_scene")(options.scene) if options.scene else None
    result = _load("warm")(scene, lambda step: print(f"{step} ...", file=sys.stderr))
    for step, seconds in result.done:
        print(f"{step:16}{seconds:6.1f} s of processor time")
    for step in result.left:
        print(f"left out: {_single_line(step)}")
    print("kept; for a session in Python:")
    for name, value in settings.items():
        print(f"export {name}={value}")


def _report(options):
    jax_settings.prepare_environment()
    environment = _load("describe_environment", ENVIRONMENT_MODULE)()
    print(
        json.dumps(environment, indent=2)
        if options.json
        else _load("format_environment", ENVIRONMENT_MODULE)(environment)
    )


def _load(name, module_name=None):
    """A function of the package, or of a module of it, once all that it needs is loaded. Until then an interrupt ends
    the process at once: one in the middle of loading compiled modules would end in a crash. What is loaded stays:
    Python's collector of circles need not look at it, now or later."""
    previous_handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    try:
        return getattr(import_module(module_name) if module_name else jv, name)
    finally:
        gc.freeze()
        gc.enable()
        signal.signal(signal.SIGINT, previous_handler)


def _os_error_text(error):
    if error.strerror:
        return (
            f"{str(error.filename)[-MAX_MESSAGE_LENGTH // 2 :]}: {error.strerror}" if error.filename else error.strerror
        )
    return str(error)


def _report_error(message, exit_code):
    print(f"jaxvibro: {_single_line(message)}", file=sys.stderr)
    return exit_code


def _single_line(text):
    return " ".join(str(text)[: 10 * MAX_MESSAGE_LENGTH].split())[:MAX_MESSAGE_LENGTH]
