"""Define the command line.

Modules that take long to import are imported when they are needed, so that `jaxvibro --help` answers at once.
"""

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
from ..output.atomic_files import atomic_file
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
Prints versions, processor, settings of JAX, compiler hints, the cache folder and the version of the NumPy rules, as the
commands use them. Add the output to a problem report."""
_SET_HELP = """\
another value for this run, key and value as in the scene file: --set sweep.count=201. The prefix "scene." may be left
out: --set amplitude=3. Strings keep their quotes: --set 'sweep.parameter="frequency"'. May be repeated."""


class _Parser(argparse.ArgumentParser):
    """Argument parser with one-line error messages."""

    def error(self, message):
        """Print a one-line message and exit."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {_to_single_line(message)}\n")


def main(command_arguments=None):
    """Run the command line.

    Parameters
    ----------
    command_arguments : list of str, optional
        Command-line arguments. None uses those of the process.

    Returns
    -------
    int
        Exit code: 0 for success, 130 after an interrupt, and 2 for invalid input, a file that cannot be read or
        written, a missing optional package or insufficient memory. Errors are reported as one line on stderr.
    """
    try:
        options = _make_parser().parse_args(command_arguments)
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


def _make_parser():
    parser = _Parser("jaxvibro", description="Vibro-impact oscillators with rigid and soft walls.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for command_name, (run_command, command_help, description, arguments) in _COMMANDS.items():
        command_parser = subparsers.add_parser(
            command_name, help=command_help, description=description, allow_abbrev=False
        )
        for argument_name, argument_options in arguments.items():
            command_parser.add_argument(argument_name, **argument_options)
        command_parser.set_defaults(does=run_command)
    return parser


def _write_scene_template(options):
    with atomic_file(options.path, options.force) as file:
        file.write(scene_template.SCENE_TEMPLATE.encode())
    print(f"wrote {options.path}; next: jaxvibro run {options.path}")


def _run_scene_file(options):
    jax_settings.set_jax_environment()
    run_settings = {"csv": options.csv, "units": options.units, "engine": _map_engine(options)}
    run_result = _import_function("run")(
        options.scene, options.out, options.changes, options.force, progress=True, **run_settings
    )
    if options.json:
        print(json.dumps(run_result.summary, indent=2, allow_nan=False))
        return
    print(run_result.table)
    for file_kind, file_path in run_result.summary["files"].items():
        print(f"{file_kind:17}{file_path}" if len(file_kind) > 7 else f"{file_kind:8}{file_path}")


def _map_engine(options):
    """Return the execution engine for a [map] from the command-line options; None for the default engine."""
    if options.engine == "dask" or (options.scheduler is not None and options.engine is None):
        return _import_function("DaskEngine")(options.scheduler, options.workers)
    if options.scheduler is not None:
        raise jv.ArgumentError("scheduler", "must not be given with the engine local", options.scheduler)
    return None if options.workers is None else _import_function("LocalEngine")(options.workers)


def _show_stored_map(options):
    jax_settings.set_jax_environment()
    picture_path = options.picture or os.path.splitext(options.path.rstrip(os.sep))[0] + ".png"
    print(_import_function("show")(options.path, picture_path, options.data, options.force, options.units))
    for file_kind, file_path in (("picture", picture_path), ("data", options.data)):
        if file_path:
            print(f"{file_kind:8}{file_path}")


def _serve_explorer(options):
    jax_settings.set_jax_environment()
    explorer_view = _import_function("view")(
        options.scene, options.port, options.address, options.changes, jax_settings.load_page_token()
    )
    print(explorer_view.url, flush=True)
    if not options.no_browser:
        webbrowser.open(explorer_view.url)
    try:
        explorer_view.wait()
    except KeyboardInterrupt:
        explorer_view.stop()


def _recompute_paper(options):
    jax_settings.set_jax_environment()
    paper_report = _import_function("paper")(
        options.names, options.out, options.scenes, options.force, progress=True, workers=options.workers
    )
    print(paper_report.told)
    for file_kind, file_path in (("page", paper_report.page), ("text", paper_report.text)):
        print(f"{file_kind:8}{file_path}")


def _fill_compile_cache(options):
    environment_variables = jax_settings.set_jax_environment()
    scene = _import_function("load_scene")(options.scene) if options.scene else None
    warm_result = _import_function("warm")(scene, lambda step: print(f"{step} ...", file=sys.stderr))
    for step_name, processor_seconds in warm_result.done:
        print(f"{step_name:16}{processor_seconds:6.1f} s of processor time")
    for step_name in warm_result.left:
        print(f"omitted: {_to_single_line(step_name)}")
    print("the compile cache is filled; for a session in Python:")
    for variable_name, variable_value in environment_variables.items():
        print(f"export {variable_name}={variable_value}")


def _print_environment(options):
    jax_settings.set_jax_environment()
    environment = _import_function("describe_environment", ENVIRONMENT_MODULE)()
    print(
        json.dumps(environment, indent=2)
        if options.json
        else _import_function("format_environment", ENVIRONMENT_MODULE)(environment)
    )


_FORCE = {"action": "store_true", "help": "overwrite existing files"}
_SET = {"metavar": "KEY=VALUE", "action": "append", "default": [], "dest": "changes", "help": _SET_HELP}
_UNITS = {"choices": ("scene", "physical"), "default": "scene"}
_RUN_ARGUMENTS = {
    "scene": {"metavar": "SCENE", "help": "a scene file"},
    "--set": _SET,
    "--out": {"metavar": "DIR", "default": "out", "help": "folder to write into; default: out"},
    "--force": _FORCE,
    "--json": {"action": "store_true", "help": "print only a JSON summary on stdout"},
    "--csv": {"action": "store_true", "help": "also write CSV tables, one row per point"},
    "--units": {
        **_UNITS,
        "help": "units of tables and pictures: the scene's, or N, Hz, mm, m/s, W if it has [scene.scales];"
        " default: scene",
    },
    "--engine": {
        "choices": ("local", "dask"),
        "help": "execution engine of a [map]; default: local, this process",
    },
    "--scheduler": {"metavar": "ADDRESS", "help": "address of a running Dask cluster, as tcp://host:8786"},
    "--workers": {
        "metavar": "N",
        "type": int,
        "help": "chunks of a [map] computed at a time; default: one per processor core",
    },
}
_SHOW_ARGUMENTS = {
    "path": {"metavar": "STORE", "help": "the folder of a map, NAME.zarr"},
    "--picture": {"metavar": "FILE", "help": "default: NAME.png beside it"},
    "--data": {"metavar": "FILE", "help": "also write the data to a NetCDF file"},
    "--force": _FORCE,
    "--units": {**_UNITS, "help": "units of the table and the picture"},
}
_PAPER_ARGUMENTS = {
    "names": {"metavar": "NAME", "nargs": "*", "help": "fig2 to fig12, walls, formulas; default: all"},
    "--scenes": {"metavar": "DIR", "help": "folder of the scene files; default: those of the package"},
    "--out": {"metavar": "DIR", "default": "out/paper", "help": "folder to write into; default: out/paper"},
    "--force": {"action": "store_true", "help": "recompute existing results"},
    "--workers": {
        "metavar": "N",
        "type": int,
        "default": min(MAX_WORKERS, os.cpu_count() or 1),
        "help": f"figures computed at a time; default: one per processor core, at most {MAX_WORKERS}",
    },
}
_VIEW_ARGUMENTS = {
    "scene": {"metavar": "SCENE", "help": "a scene file"},
    "--set": _SET,
    "--address": {
        "metavar": "ADDRESS",
        "default": "127.0.0.1",
        "help": "address of this machine; default: 127.0.0.1",
    },
    "--port": {
        "metavar": "N",
        "type": int,
        "help": "default: the first free port from 8420 to 8439; with the same port an earlier page resumes",
    },
    "--no-browser": {"action": "store_true", "help": "print the address without opening a browser"},
}
# {name of a command: (function of the options, help, description, {argument: options of `add_argument`})}.
_COMMANDS = {
    "init": (
        _write_scene_template,
        "write a commented scene file",
        "Writes a commented scene file to start from.",
        {
            "path": {"metavar": "PATH", "nargs": "?", "default": "scene.toml", "help": "default: scene.toml"},
            "--force": _FORCE,
        },
    ),
    "run": (_run_scene_file, "run the analyses in a scene file", _RUN_HELP, _RUN_ARGUMENTS),
    "show": (_show_stored_map, "show a stored map", _SHOW_HELP, _SHOW_ARGUMENTS),
    "paper": (_recompute_paper, "recompute the paper", _PAPER_HELP, _PAPER_ARGUMENTS),
    "view": (_serve_explorer, "explore a scene in the browser", _VIEW_HELP, _VIEW_ARGUMENTS),
    "warm": (
        _fill_compile_cache,
        "fill the compile cache",
        _WARM_HELP,
        {"scene": {"metavar": "SCENE", "nargs": "?", "help": "a scene file; default: the README's scene"}},
    ),
    "report": (
        _print_environment,
        "print versions, processor and settings, for problem reports",
        _REPORT_HELP,
        {"--json": {"action": "store_true", "help": "print JSON"}},
    ),
}


def _import_function(function_name, module_name=None):
    """Import a function from the package, or from one of its modules.

    An interrupt during the import ends the process at once, because an interrupt inside the import of a compiled module
    may crash. Imported objects remain in memory and are excluded from garbage collection.
    """
    previous_sigint_handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    try:
        return getattr(import_module(module_name) if module_name else jv, function_name)
    finally:
        gc.freeze()
        gc.enable()
        signal.signal(signal.SIGINT, previous_sigint_handler)


def _os_error_text(error):
    """Format the file name and the reason of an OSError."""
    if error.strerror:
        return (
            f"{str(error.filename)[-MAX_MESSAGE_LENGTH // 2 :]}: {error.strerror}" if error.filename else error.strerror
        )
    return str(error)


def _report_error(message, exit_code):
    """Print a one-line message on stderr and return the exit code."""
    print(f"jaxvibro: {_to_single_line(message)}", file=sys.stderr)
    return exit_code


def _to_single_line(text):
    """Convert a text to one line of limited length."""
    return " ".join(str(text)[: 10 * MAX_MESSAGE_LENGTH].split())[:MAX_MESSAGE_LENGTH]
