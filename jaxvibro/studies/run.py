"""Run the analyses in a scene file and write picture, data and table, either all or none."""

import os
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import jaxvibro as jv

from ..output.atomic_files import atomic_file, require_writable_folder
from ..output.checksums import netcdf_bytes
from ..output.units import require_unit_system
from ..scene.check import SceneError, host_only, nearest_name
from ..scene.scales import require_scales
from ..scene.scene_table import SceneTable
from ..stores.engines import Engine, LocalEngine
from . import map_report, results_report, scene_file
from .csv_tables import csv_table, requested_table_names
from .record_file import load_measured_record
from .result_pictures import draw_loci_picture, draw_main_picture, draw_margin_picture
from .results_dataset import make_results_dataset
from .scene_file_studies import run_studies
from .schema import SceneFile

STORE_SUFFIX = ".zarr"
# Additional pictures for tables of a scene file, {table: {kind: (suffix, function of results and units)}}.
_PICTURES_BY_TABLE = {
    "locus": {"loci": (".loci.png", draw_loci_picture)},
    "margin": {"margin": (".margin.png", draw_margin_picture)},
    "map": {"map": (".map.png", lambda results, units: map_report.draw_map_picture(results.map, units))},
}
PAPER_TABLES = ("spectrum", "basins", "panels")  # tables for `paper` only


@dataclass(frozen=True)
class Done:
    """Results of `run`.

    Attributes
    ----------
    summary : dict
        Results as numbers, texts, lists and dicts, as ``--json`` prints them.
    table : str
        Results as a readable table.
    """

    summary: dict[str, Any]
    table: str


@host_only("use strobe or monodromy")
def run(
    path: str | PathLike[str],
    out: str | PathLike[str] = "out",
    changes: Iterable[str] = (),
    force: bool = False,
    progress: bool = False,
    csv: bool = False,
    units: str = "scene",
    engine: Engine | None = None,
) -> Done:
    """Run the analyses in a scene file and write their results into a folder.

    The output files are a picture, data and a table. A [locus], [margin] or [map] has an additional picture. A [map]
    also writes its `Store`, from which a later run resumes. If a [map] is the only analysis, the output files are its
    picture and the table.

    Parameters
    ----------
    path : path-like
        Scene file. The names of the output files begin with its name without suffix.
    out : path-like, optional
        Folder of the output files, created if it does not exist.
    changes : iterable of str, optional
        Values that replace those in the file, each "key=value" as in the file, for example ``"sweep.count=201"``. The
        prefix "scene." may be omitted.
    force : bool, optional
        Overwrite existing files.
    progress : bool, optional
        Show progress bars on stderr.
    csv : bool, optional
        Also write CSV tables of the sweep, the attractors, the branches and the loci, one row per point.
    units : {"scene", "physical"}, optional
        Units of the tables and pictures. Physical units (N, Hz, mm, ...) require the table [scene.scales].
    engine : LocalEngine or DaskEngine, optional
        Execution engine of a [map]. None uses a `LocalEngine`.

    Returns
    -------
    Done
        Summary and table of the run.

    Raises
    ------
    SceneError
        If the file or a change is invalid, before any computation. If the record of a [fit] has too few data, or the
        start of a [branch] does not lead to an orbit that can be continued, before the other analyses. If the start of
        a [margin] does not lead to such an orbit.
    ArgumentError
        If `units` is "physical" and the scene has no scales, before any computation.
    FileExistsError
        If an output file already exists and `force` is False, before any computation.
    OSError
        If a file cannot be read or the folder cannot be written to, before any computation.

    See Also
    --------
    show : Show a stored map.
    load_scene : Read the scene of a scene file.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> folder = mkdtemp()
    >>> jv.save_scene(scene, f"{folder}/driven.toml")
    >>> done = jv.run(f"{folder}/driven.toml", out=folder)
    >>> sorted(done.summary["files"])
    ['data', 'picture', 'table']
    """
    start_time = time.perf_counter()
    path, out = Path(path), Path(out)
    file_tables = scene_file.read_scene_file(path, [_qualified_change(change) for change in changes])
    for table_name in PAPER_TABLES:
        if getattr(file_tables, table_name):
            raise SceneError(table_name, "is a table for `jaxvibro paper`, not for a run", path.name)
    output_files = _requested_files(file_tables, path.name, csv)
    path_by_kind = {kind: out / (path.stem + suffix) for kind, (suffix, _) in output_files.items()}
    scene = file_tables.scene.make()
    if require_unit_system(units) == "physical":
        require_scales(scene)
    _check_writable_outputs(path, out, path_by_kind.values(), force)
    map_store = None if file_tables.map is None else _make_map_store(out, path.stem, engine)
    measured_record = None if file_tables.fit is None else load_measured_record(path.parent, file_tables.fit, scene)
    results = run_studies(file_tables, measured_record, progress, map_store)
    content_by_kind = {kind: make_content(results, units) for kind, (_, make_content) in output_files.items()}
    content_by_kind = {kind: content for kind, content in content_by_kind.items() if content is not None}
    _write_files({path_by_kind[kind]: content for kind, content in content_by_kind.items()}, force)
    written_paths = {kind: str(path_by_kind[kind]) for kind in content_by_kind}
    if map_store is not None:
        written_paths["store"] = map_store.path
    summary = results_report.summarise_results(results, written_paths)
    summary["seconds"] = round(time.perf_counter() - start_time, 3)
    return Done(summary, content_by_kind["table"].decode())


def _requested_files(file_tables, file_name, with_csv_tables):
    """Return the output files of a run in the order of its summary, {kind: (suffix, function of results and units)}.

    The functions return the content of the files as bytes, or None if there is nothing to write.
    """
    output_files = {}
    if not file_tables.has_only_map:
        output_files |= {"picture": (".png", draw_main_picture), "data": (".nc", _make_data_file)}
    output_files["table"] = ".txt", partial(_make_table_file, file_name)
    for table_name, kind_and_file in _PICTURES_BY_TABLE.items():
        output_files |= kind_and_file if table_name in file_tables.analyses else {}
    for csv_name in requested_table_names(file_tables) if with_csv_tables else ():
        output_files[f"{csv_name} table"] = f".{csv_name}.csv", partial(csv_table, csv_name)
    return output_files


def _make_table_file(file_name, results, units):
    return results_report.format_results_table(results, file_name, units).encode()


def _make_data_file(results, _):
    return netcdf_bytes(make_results_dataset(results))


def _make_map_store(output_folder, file_stem, engine):
    """Return the `Store` for a [map]; create the output folder if it does not exist."""
    output_folder.mkdir(parents=True, exist_ok=True)
    return jv.Store(output_folder / (file_stem + STORE_SUFFIX), engine or LocalEngine())


def _qualified_change(change):
    """Return a change with its full key: add the prefix "scene." if the key is one of a scene."""
    first_key = change.split("=")[0].split(".")[0].strip()
    table_names, scene_keys = SceneFile.__struct_fields__, SceneTable.__struct_fields__
    is_scene_key = first_key not in table_names and (
        first_key in scene_keys or nearest_name(first_key, (*table_names, *scene_keys)) in scene_keys
    )
    return f"scene.{change}" if is_scene_key else change


def _check_writable_outputs(scene_path, output_folder, output_paths, overwrite):
    """Raise an OSError if an output file could not be written at the end of the run."""
    require_writable_folder(output_folder)
    for output_path in output_paths:
        if output_path.is_dir() or (output_path.exists() and output_path.samefile(scene_path)):
            raise FileExistsError(f"out: {output_path} is a folder or the scene file, which are not overwritten")
        if os.path.lexists(output_path) and not overwrite:
            raise FileExistsError(f"out: {output_path} already exists; --force overwrites it")


def _write_files(content_by_path, overwrite):
    """Write all files under temporary names, then rename all of them."""
    with ExitStack() as exit_stack:
        for output_path, content in content_by_path.items():
            output_path.parent.mkdir(parents=True, exist_ok=True)
            output_file = exit_stack.enter_context(atomic_file(output_path, overwrite))
            output_file.write(content)
            output_file.flush()
