"""Does what a scene file asks, and writes picture, data and table: all of them whole, or none."""

import os
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import jaxvibro as jv

from ..output.atomic_write import refuse_folder, whole
from ..output.checksums import netcdf
from ..output.units import require_system
from ..scene.check import SceneError, host, nearest
from ..scene.scales import require_scales
from ..scene.scene_table import SceneTable
from ..stores.engines import Engine, LocalEngine
from . import map_report, report, scene_file
from .compute import study
from .csv_tables import asked_for, csv_tables
from .figures import loci, margin, picture
from .record_file import record
from .results_dataset import dataset
from .schema import SceneFile

ENDINGS = {"picture": ".png", "data": ".nc", "table": ".txt"}
# Where a table asks for it; a map's store is a folder, which the study itself writes.
MORE = {"locus": {"loci": ".loci.png"}, "margin": {"margin": ".margin.png"}, "map": {"map": ".map.png"}}
STORE = ".zarr"
FOR_PAPER = ("spectrum", "basins", "panels")  # tables that `paper` knows


@dataclass(frozen=True)
class Done:
    """What a run gives. summary: plain numbers, texts, lists and dicts, as `--json` prints it; table: for reading."""

    summary: dict[str, Any]
    table: str


@host("use strobe or monodromy")
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
    """Does what a scene file asks, and writes its picture, data and table into a folder, with a [locus], [margin] or
    [map] a picture of that too, and of a [map] its `Store`, which a later run goes on with: `Done`.

    path: of the scene file; its name without ending names the results. out: the folder, made where it is missing.
    changes: other values for this run, each "key=value" as in the file ("sweep.count=201"); "scene." may be left out.
    force: overwrite results that are there. progress: show bars on stderr. csv: write a table each of the sweep, the
    attractors, the branches and the loci too, a row a point. units: of these, of the pictures and of the tables of
    branches and loci, "scene", or "physical" (N, Hz, mm, ...) where the scene has [scene.scales]. engine: who works
    out a [map], None: this process.

    Raises SceneError for what the file or the changes may not say, FileExistsError where a result is there already,
    and OSError where a file cannot be read or the folder not be written to, all before any work; and SceneError
    where the start of a [branch] turns out to settle on no orbit that can be followed, before the other studies, or
    where the record of a [fit] holds less than is asked of it.
    """
    began = time.perf_counter()
    path, out = Path(path), Path(out)
    file = scene_file.read(path, [_full(change) for change in changes])
    for name in FOR_PAPER:
        if getattr(file, name):
            raise SceneError(name, "is a table for `jaxvibro paper`, not for a run", path.name)
    endings = {"table": ENDINGS["table"]} if file.is_map_alone else dict(ENDINGS)
    for name, more in MORE.items():
        endings |= more if getattr(file, name) is not None else {}
    if csv:
        endings |= {f"{what} table": f".{what}.csv" for what in asked_for(file)}
    files = {kind: out / (path.stem + ending) for kind, ending in endings.items()}
    scene = file.scene.make()
    if require_system(units) == "physical":
        require_scales(scene)
    _refuse(path, out, files.values(), force)
    store = None if file.map is None else _store(out, path.stem, engine)
    heard = None if file.fit is None else record(path.parent, file.fit, scene)
    found = study(file, heard, progress, store)
    table = report.table(found, path.name, units)
    contents = {} if file.is_map_alone else {"picture": picture(found, units), "data": netcdf(dataset(found))}
    contents["table"] = table.encode()
    draws = {"loci": loci, "margin": margin, "map": lambda found, units: map_report.picture(found.map, units)}
    contents |= {kind: draw(found, units) for kind, draw in draws.items() if kind in files}
    contents |= {f"{what} table": text for what, text in csv_tables(found, units).items()} if csv else {}
    files = {kind: files[kind] for kind in contents}
    _write({files[kind]: content for kind, content in contents.items()}, force)
    told = files if store is None else files | {"store": Path(store.path)}
    summary = report.summary(found, {kind: str(one) for kind, one in told.items()})
    return Done(summary | {"seconds": round(time.perf_counter() - began, 3)}, table)


def _store(out, name, engine):
    """The store of a [map], whose folder is there; what it needs is loaded for it alone."""
    out.mkdir(parents=True, exist_ok=True)
    return jv.Store(out / (name + STORE), engine or LocalEngine())


def _full(change):
    """A change with its key from the top of the file: that of a scene's parameter may begin below [scene]."""
    first = change.split("=")[0].split(".")[0].strip()
    tables, own = SceneFile.__struct_fields__, SceneTable.__struct_fields__
    inner = first not in tables and (first in own or nearest(first, (*tables, *own)) in own)
    return f"scene.{change}" if inner else change


def _refuse(path, out, files, force):
    """Refuse what could not be written at the end."""
    refuse_folder(out)
    for one in files:
        if one.is_dir() or (one.exists() and one.samefile(path)):
            raise FileExistsError(f"out: {one} is in the way")
        if os.path.lexists(one) and not force:
            raise FileExistsError(f"out: {one} is there already; --force overwrites it")


def _write(contents, force):
    """Write all files beside their places first, then put all there."""
    with ExitStack() as stack:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(whole(path, force))
            file.write(content)
            file.flush()
