"""A map's store shown, half done too: its table, its picture, and what it holds as one NetCDF file."""

from os import PathLike
from pathlib import Path

from ..output.atomic_write import atomic_file, require_writable_folder
from ..output.checksums import netcdf_bytes
from ..output.units import require_unit_system
from ..scene.check import ArgumentError, host_only
from ..stores.zarr_store import load_store
from ..surveys.map import add_label_flags
from . import map_report


@host_only("use what was loaded before")
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
    require_unit_system(units)
    for target in (picture, data):
        if target is not None:
            require_writable_folder(Path(target).parent)
    map_data = load_store(path)
    if "label" not in map_data or "scene_file" not in map_data.attrs:
        raise ArgumentError("path", "must be the store of a map", str(path))
    map_data = add_label_flags(map_data)
    contents = {} if picture is None else {picture: map_report.map_picture(map_data, units)}
    contents |= {} if data is None else {data: netcdf_bytes(map_data)}
    for output_path, content in contents.items():
        with atomic_file(output_path, force) as file:
            file.write(content)
    n_done, n_chunks = map_data.attrs["chunks_done"], map_data.attrs["chunks"]
    return "\n".join([f"{path}: {n_done} of {n_chunks} chunks are done", *map_report.map_lines(map_data, units)])
