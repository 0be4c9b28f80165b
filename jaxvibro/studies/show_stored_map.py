"""Show a stored map, complete or partial: return its table and write its picture and data."""

from os import PathLike
from pathlib import Path

from ..output.atomic_files import atomic_file, require_writable_folder
from ..output.checksums import netcdf_bytes
from ..output.units import require_unit_system
from ..scene.check import ArgumentError, host_only
from ..stores.zarr_store import load_store
from ..surveys.map import add_flag_attributes
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

    The table counts the cells that are not yet computed under the label "not done"; in the picture they are blank.

    Parameters
    ----------
    path : path-like
        Store of the map.
    picture : path-like, optional
        PNG file for the picture. None writes no picture.
    data : path-like, optional
        NetCDF file for the data. None writes no data.
    force : bool, optional
        Overwrite existing files.
    units : {"scene", "physical"}, optional
        Units of the table and the picture. Physical units need a scene with scales.

    Returns
    -------
    str
        Table of the map.

    Raises
    ------
    ArgumentError
        If the folder is not the store of a map, or is damaged. If a picture is requested and the map does not have two
        parameters, or physical units are requested for a scene without scales.
    OSError
        If a file cannot be read or written, or already exists and `force` is False.

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
    for picture_or_data_path in (picture, data):
        if picture_or_data_path is not None:
            require_writable_folder(Path(picture_or_data_path).parent)
    map_data = load_store(path)
    if "label" not in map_data or "scene_file" not in map_data.attrs:
        raise ArgumentError("path", "must be the store of a map", str(path))
    map_data = add_flag_attributes(map_data)
    content_by_path = {} if picture is None else {picture: map_report.draw_map_picture(map_data, units)}
    content_by_path |= {} if data is None else {data: netcdf_bytes(map_data)}
    for output_path, content in content_by_path.items():
        with atomic_file(output_path, force) as file:
            file.write(content)
    n_chunks_done, n_chunks = map_data.attrs["chunks_done"], map_data.attrs["chunks"]
    return "\n".join([f"{path}: {n_chunks_done} of {n_chunks} chunks are done", *map_report.map_lines(map_data, units)])
