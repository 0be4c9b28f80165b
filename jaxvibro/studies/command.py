"""Define the command line; heavy modules load only when needed, so that `jaxvibro --help` answers at once."""

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
MAX_MESSAGE_LENGTH = 300  # characters of an error message
EXTRA_OF_MODULE = {
    "distributed": "cluster",
    "cloudpickle": "cluster",
    "tornado": "view",
}  # extra that installs each module
ENVIRONMENT_MODULE = "jaxvibro.studies.environment"
MAX_WORKERS = 4  # processes of `paper`: each needs a gigabyte or more

_RUN_HELP = """\
Runs the analyses in a scene file: a [sweep] gives a swept diagram, [attractors] and [orbits] give attractors and
periodic orbits, stable and unstable, from many starts; [branch] follows periodic orbits along a parameter with all
branches that bifurcate from them, [explore] finds all branches by itself; [locus] follows their special points in two
parameters; [margin] computes the distance of an orbit to the nearest bifurcations; [fit] fits parameters to a record of
impacts or samples in a CSV file; [map] computes the attractor at each cell of a grid over two parameters, and resumes
after an interruption. A file without analyses gives the motion from rest. Walls are rigid or soft. Writes DIR/NAME.png,
NAME.nc and NAME.txt for a scene file NAME.toml, with a [locus] also NAME.loci.png, with a [margin] NAME.margin.png,
with a [map] NAME.map.png and NAME.zarr; a [map] alone has no other picture. The tables [spectrum], [basins] and
[panels] are for paper, [[view]] for view."""
_PAPER_HELP = """\
Recomputes figures 2 to 12 of Cheng and Xu (2007), its formulas, and its claims about one wall and about moving
walls, and checks every claim by numbers. Writes DIR/report.html, DIR/report.md and, for each NAME, NAME.json (the
claims) and, if they exist, NAME.png and NAME.nc. Keeps results of an earlier run: an interrupted run resumes."""
_SHOW_HELP = """Shows a stored [map], complete or not: prints its table and draws its picture."""
_VIEW_HELP = """\
Explores a scene on a page in the browser: branches, selected points, the attractor for slider values. The
analyses in the file run first; a scene file that the page saved is resumed. The page is served to this machine only,
under the address that is printed; Ctrl-C ends it."""
_WARM_HELP = """\
Compiles the usual first steps for a scene (a strobe, an orbit, its branch, bifurcating branches, loci, attractors), so
that later processes compile nothing for scenes with the same kinds of walls. Takes half a minute or more, a minute or
more with soft walls. A session in Python uses this cache with the settings that are printed."""
_REPORT_HELP = """\
Prints versions, processor, settings of JAX, compiler hints and the cache folder, as the commands use them.
Add the output to a problem report."""
_SET_HELP = """\
another value for this run, key and value as in the scene file: --set sweep.count=201. The prefix "scene." may be left
out: --set amplitude=3. Strings keep their quotes: --set 'sweep.parameter="frequency"'. May be repeated."""


class _Parser(argparse.ArgumentParser):
    """Argument parser with one-line error messages."""

    def error(self, message):
        """Exit with a one-line message."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {_single_line(message)}\n")


def main(arguments=None):
    """Run the command line.

    Parameters
    ----------
    arguments : list of str, optional
        Arguments. None takes those of the process.

    Returns
    -------
    int
        Exit code: 0, 2 for invalid input, with one line on stderr, or 130 after an interrupt.
    """
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
        return _report_error("not enough memory for this run", EXIT_BAD_INPUT)
    except OSError as error:
        return _report_error(_os_error_text(error), EXIT_BAD_INPUT)
    except jv.ArgumentError as error:  # last, because this name loads jax
        return _report_error(error, EXIT_BAD_INPUT)
    return 0


def _parser():
    parser = _Parser("jaxvibro", description="Vibro-impact oscillators with rigid and soft walls.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    init = commands.add_parser("init", help="write a commented scene file", allow_abbrev=False)
    init.description = "Writes a commented scene file to start from."
    init.add_argument("path", metavar="PATH", nargs="?", default="scene.toml", help="default: scene.toml")
    init.add_argument("--force", action="store_true", help="overwrite existing files")
    init.set_defaults(does=_init)

    run = commands.add_parser("run", help="run the analyses in a scene file", description=_RUN_HELP, allow_abbrev=False)
    run.add_argument("scene", metavar="SCENE", help="a scene file")
    run.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="changes", help=_SET_HELP)
    run.add_argument("--out", metavar="DIR", default="out", help="folder to write into; default: out")
    run.add_argument("--force", action="store_true", help="overwrite existing files")
    run.add_argument("--json", action="store_true", help="print only a JSON summary on stdout")
    run.add_argument("--csv", action="store_true", help="also write CSV tables, one row per point")
    help_text = (
        "units of tables and pictures: the scene's, or N, Hz, mm, m/s, W if it has [scene.scales]; default: scene"
    )
    run.add_argument("--units", choices=("scene", "physical"), default="scene", help=help_text)
    run.add_argument(
        "--engine", choices=("local", "dask"), help="execution engine of a [map]; default: local, this process"
    )
    run.add_argument("--scheduler", metavar="ADDRESS", help="address of a running Dask cluster, as tcp://host:8786")
    help_text = "chunks of a [map] computed at a time; default: one per processor core"
    run.add_argument("--workers", metavar="N", type=int, help=help_text)
    run.set_defaults(does=_run)

    show = commands.add_parser("show", help="show a stored map", description=_SHOW_HELP, allow_abbrev=False)
    show.add_argument("path", metavar="STORE", help="the folder of a map, NAME.zarr")
    show.add_argument("--picture", metavar="FILE", help="default: NAME.png beside it")
    show.add_argument("--data", metavar="FILE", help="also write the data to a NetCDF file")
    show.add_argument("--force", action="store_true", help="overwrite existing files")
    show.add_argument(
        "--units", choices=("scene", "physical"), default="scene", help="units of the table and the picture"
    )
    show.set_defaults(does=_show)

    paper = commands.add_parser("paper", help="recompute the paper", description=_PAPER_HELP, allow_abbrev=False)
    paper.add_argument("names", metavar="NAME", nargs="*", help="fig2 to fig12, walls, formulas; default: all")
    paper.add_argument("--scenes", metavar="DIR", help="folder of the scene files; default: those of the package")
    paper.add_argument("--out", metavar="DIR", default="out/paper", help="folder to write into; default: out/paper")
    paper.add_argument("--force", action="store_true", help="recompute existing results")
    help_text = f"figures computed at a time; default: one per processor core, at most {MAX_WORKERS}"
    paper.add_argument(
        "--workers", metavar="N", type=int, default=min(MAX_WORKERS, os.cpu_count() or 1), help=help_text
    )
    paper.set_defaults(does=_paper)

    view = commands.add_parser(
        "view", help="explore a scene in the browser", description=_VIEW_HELP, allow_abbrev=False
    )
    view.add_argument("scene", metavar="SCENE", help="a scene file")
    view.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="changes", help=_SET_HELP)
    help_text = "address of this machine; default: 127.0.0.1"
    view.add_argument("--address", metavar="ADDRESS", default="127.0.0.1", help=help_text)
    help_text = "default: the first free port from 8420 to 8439; with the same port an earlier page resumes"
    view.add_argument("--port", metavar="N", type=int, help=help_text)
    view.add_argument("--no-browser", action="store_true", help="print the address without opening a browser")
    view.set_defaults(does=_view)

    warm = commands.add_parser("warm", help="fill the compile cache", description=_WARM_HELP, allow_abbrev=False)
    warm.add_argument("scene", metavar="SCENE", nargs="?", help="a scene file; default: the README's scene")
    warm.set_defaults(does=_warm)

    help_text = "print versions, processor and settings, for problem reports"
    report = commands.add_parser("report", help=help_text, description=_REPORT_HELP, allow_abbrev=False)
    report.add_argument("--json", action="store_true", help="print JSON")
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
    """Return the execution engine of a map; None for this process with all of its cores."""
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
        print(f"omitted: {_single_line(step)}")
    print("the compile cache is filled; for a session in Python:")
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
    """Return a function of the package, or of one of its modules, after loading everything that it needs.

    During the import an interrupt ends the process at once, because an interrupt inside the import of a compiled module
    may crash. Loaded objects stay, so the garbage collector need not scan them.
    """
    previous_handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    try:
        return getattr(import_module(module_name) if module_name else jv, name)
    finally:
        gc.freeze()
        gc.enable()
        signal.signal(signal.SIGINT, previous_handler)


def _os_error_text(error):
    """Return the file and the reason of an OSError."""
    if error.strerror:
        return (
            f"{str(error.filename)[-MAX_MESSAGE_LENGTH // 2 :]}: {error.strerror}" if error.filename else error.strerror
        )
    return str(error)


def _report_error(message, exit_code):
    """Print a one-line message on stderr and return the exit code."""
    print(f"jaxvibro: {_single_line(message)}", file=sys.stderr)
    return exit_code


def _single_line(text):
    """Put a text on one line of limited length."""
    return " ".join(str(text)[: 10 * MAX_MESSAGE_LENGTH].split())[:MAX_MESSAGE_LENGTH]
