"""Run the analyses in a scene file and write picture, data and table, all together or not at all."""

import os
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import jaxvibro as jv

from ..output.atomic_write import atomic_file, require_writable_folder
from ..output.checksums import netcdf_bytes
from ..output.units import require_unit_system
from ..scene.check import SceneError, host_only, nearest_name
from ..scene.scales import require_scales
from ..scene.scene_table import SceneTable
from ..stores.engines import Engine, LocalEngine
from . import map_report, report, scene_file
from .compute import run_studies
from .csv_tables import csv_tables, requested_tables
from .figures import loci_picture, main_picture, margin_picture
from .record_file import load_record
from .results_dataset import results_dataset
from .schema import SceneFile

SUFFIXES = {"picture": ".png", "data": ".nc", "table": ".txt"}
# Results of further tables; the study itself writes the store of a map, a folder.
EXTRA_SUFFIXES = {"locus": {"loci": ".loci.png"}, "margin": {"margin": ".margin.png"}, "map": {"map": ".map.png"}}
STORE_SUFFIX = ".zarr"
PAPER_TABLES = ("spectrum", "basins", "panels")  # tables for `paper` only


@dataclass(frozen=True)
class Done:
    """Results of `run`.

    Attributes
    ----------
    summary : dict
        Plain numbers, texts, lists and dicts, as ``--json`` prints them.
    table : str
        Table for reading.
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

    The results are a picture, data and a table, with a further picture for a [locus], [margin] or [map]. A [map] also
    writes its `Store`, from which a later run resumes.

    Parameters
    ----------
    path : path-like
        Scene file. Its name without suffix names the results.
    out : path-like, optional
        Folder, created if it is missing.
    changes : iterable of str, optional
        Other values for this run, each "key=value" as in the file, for example ``"sweep.count=201"``. The prefix
        "scene." may be left out.
    force : bool, optional
        Overwrite existing results.
    progress : bool, optional
        Show progress bars on stderr.
    csv : bool, optional
        Also write CSV tables of the sweep, the attractors, the branches and the loci, one row per point.
    units : {"scene", "physical"}, optional
        Units of the tables and pictures. Physical units (N, Hz, mm, ...) need [scene.scales].
    engine : LocalEngine or DaskEngine, optional
        Execution engine of a [map]. None runs in this process.

    Returns
    -------
    Done
        Summary and table of the run.

    Raises
    ------
    SceneError
        If the file or the changes break a rule, before any computation. Also, before the other analyses, if no orbit
        that can be continued is found at the start of a [branch], or if the record of a [fit] has less data than it
        needs.
    FileExistsError
        If a result already exists, before any computation.
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
    file = scene_file.read(path, [_qualified_change(change) for change in changes])
    for name in PAPER_TABLES:
        if getattr(file, name):
            raise SceneError(name, "is a table for `jaxvibro paper`, not for a run", path.name)
    suffixes = {"table": SUFFIXES["table"]} if file.has_only_map else dict(SUFFIXES)
    for name, extra_suffixes in EXTRA_SUFFIXES.items():
        suffixes |= extra_suffixes if getattr(file, name) is not None else {}
    if csv:
        suffixes |= {f"{table_name} table": f".{table_name}.csv" for table_name in requested_tables(file)}
    files = {kind: out / (path.stem + suffix) for kind, suffix in suffixes.items()}
    scene = file.scene.make()
    if require_unit_system(units) == "physical":
        require_scales(scene)
    _require_writable(path, out, files.values(), force)
    store = None if file.map is None else _map_store(out, path.stem, engine)
    data_record = None if file.fit is None else load_record(path.parent, file.fit, scene)
    results = run_studies(file, data_record, progress, store)
    table = report.results_table(results, path.name, units)
    contents = (
        {}
        if file.has_only_map
        else {"picture": main_picture(results, units), "data": netcdf_bytes(results_dataset(results))}
    )
    contents["table"] = table.encode()
    extra_pictures = {
        "loci": loci_picture,
        "margin": margin_picture,
        "map": lambda results, units: map_report.map_picture(results.map, units),
    }
    contents |= {kind: draw(results, units) for kind, draw in extra_pictures.items() if kind in files}
    contents |= {f"{table_name} table": text for table_name, text in csv_tables(results, units).items()} if csv else {}
    files = {kind: files[kind] for kind in contents}
    _write_files({files[kind]: content for kind, content in contents.items()}, force)
    output_files = files if store is None else files | {"store": Path(store.path)}
    summary = report.summary(results, {kind: str(file_path) for kind, file_path in output_files.items()})
    return Done(summary | {"seconds": round(time.perf_counter() - start_time, 3)}, table)


def _map_store(out, stem, engine):
    """Return the store of a [map] in an existing folder."""
    out.mkdir(parents=True, exist_ok=True)
    return jv.Store(out / (stem + STORE_SUFFIX), engine or LocalEngine())


def _qualified_change(change):
    """Return a change with its full key: the key of a scene's parameter may begin below [scene]."""
    first_key = change.split("=")[0].split(".")[0].strip()
    table_names, scene_keys = SceneFile.__struct_fields__, SceneTable.__struct_fields__
    is_scene_key = first_key not in table_names and (
        first_key in scene_keys or nearest_name(first_key, (*table_names, *scene_keys)) in scene_keys
    )
    return f"scene.{change}" if is_scene_key else change


def _require_writable(path, out, files, force):
    """Check in advance that all results can be written."""
    require_writable_folder(out)
    for file_path in files:
        if file_path.is_dir() or (file_path.exists() and file_path.samefile(path)):
            raise FileExistsError(f"out: {file_path} is a folder or the scene file, which are not overwritten")
        if os.path.lexists(file_path) and not force:
            raise FileExistsError(f"out: {file_path} already exists; --force overwrites it")


def _write_files(contents, force):
    """Write all files under temporary names first, then rename all of them."""
    with ExitStack() as stack:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(atomic_file(path, force))
            file.write(content)
            file.flush()
