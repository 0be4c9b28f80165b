"""Show a stored map, complete or not: its table, its picture and its data as one NetCDF file."""

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
    """Return the table of a stored map and optionally write its picture and data.

    Cells that are not yet computed are left out.

    Parameters
    ----------
    path : path-like
        Store of the map.
    picture : path-like, optional
        File for the picture.
    data : path-like, optional
        NetCDF file for the data.
    force : bool, optional
        Overwrite existing files.
    units : {"scene", "physical"}, optional
        Units of the table and the picture. Physical units need a scene with scales.

    Returns
    -------
    str
        The table.

    Raises
    ------
    ArgumentError
        If the folder is not the store of a map, or is damaged.
    OSError
        If a file cannot be read or written.

    See Also
    --------
    map_parameters : Compute a map.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> store = jv.Store(mkdtemp() + "/small.zarr")
    >>> grid = {"amplitude": np.array([1.0, 2.0]), "frequency": np.array([2.0, 2.1])}
    >>> small = jv.map_parameters(scene, grid, store=store)
    >>> print(jv.show(store.path).splitlines()[1])
    map over amplitude and frequency: 2 x 2 cells
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
