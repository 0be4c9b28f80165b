"""A map's store shown, half done too: its table, its picture, and what it holds as one NetCDF file."""

from os import PathLike
from pathlib import Path

from ..output.atomic_write import refuse_folder, whole
from ..output.checksums import netcdf
from ..output.units import require_system
from ..scene.check import ArgumentError, host
from ..stores.zarr_store import load_store
from ..surveys.map import told
from . import map_report


@host("use what was loaded before")
def show(
    path: str | PathLike[str],
    picture: str | PathLike[str] | None = None,
    data: str | PathLike[str] | None = None,
    force: bool = False,
    units: str = "scene",
) -> str:
    """The table of a map's store, as far as it is done: a text. Writes its picture, and its data as NetCDF, if asked.

    path: of the store; picture, data: of files to write. force: overwrite what is there; units: "scene", or "physical"
    where its scene has scales.

    Raises ArgumentError for what is no map's store, or damaged, OSError where a file cannot be read or written.
    """
    require_system(units)
    for each in (picture, data):
        if each is not None:
            refuse_folder(Path(each).parent)
    found = load_store(path)
    if "label" not in found or "scene_file" not in found.attrs:
        raise ArgumentError("path", "must be the store of a map", str(path))
    found = told(found)
    contents = {} if picture is None else {picture: map_report.picture(found, units)}
    contents |= {} if data is None else {data: netcdf(found)}
    for place, content in contents.items():
        with whole(place, force) as file:
            file.write(content)
    done, of = found.attrs["chunks_done"], found.attrs["chunks"]
    return "\n".join([f"{path}: {done} of {of} chunks are done", *map_report.lines(found, units)])
