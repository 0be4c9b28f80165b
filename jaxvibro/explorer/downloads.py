"""Write the files that a page offers: figures, and the data of all results."""

import io
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import xarray as xr

from ..branches.branch import Branch
from ..loci.locus import Locus
from ..orbits.orbit import Orbit
from ..output.checksums import netcdf_bytes
from ..scene.check import ArgumentError
from . import panels
from .page_screen import DRAW_FUNCTIONS, Screen, draw_arguments
from .page_state import PageState, result_members

PICTURE_FORMATS = ("png", "svg", "pdf")


def panel_picture(panel: str, file_format: str, page: PageState, results: Mapping[str, Any], screen: Screen) -> bytes:
    """Return the figure of a panel as a file.

    Raises ArgumentError for an unknown panel or format, and if there is nothing to draw.
    """
    if panel not in DRAW_FUNCTIONS or file_format not in PICTURE_FORMATS:
        raise ArgumentError(
            "picture",
            f"must be one of {', '.join(DRAW_FUNCTIONS)}, as {', '.join(PICTURE_FORMATS)}",
            f"{panel}.{file_format}",
        )
    panel_arguments = draw_arguments(panel, page, results)
    if panel_arguments is None:
        raise ArgumentError("picture", "requires a motion. Select an orbit first", panel)
    limits = screen.limits.get(panel, panels.AxisLimits())
    return panels.export_picture(lambda ax: DRAW_FUNCTIONS[panel](ax, *panel_arguments), limits, file_format)


def data_archive(page: PageState, results: Mapping[str, Any]) -> bytes:
    """Return a ZIP archive of all results: NetCDF files of curves, grids and motions, and tables as text."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as zip_file:
        for call_line in page.lines:
            for file_name, content in result_data_files(call_line.name, results[call_line.name]):
                zip_file.writestr(file_name, content)
    return buffer.getvalue()


def result_data_files(result_name: str, result: Any) -> Iterator[tuple[str, bytes]]:
    """Yield (file name, content) of the data of a result and its members."""
    for reference, member in result_members(result_name, result):
        file_stem = reference.replace("[", "_").replace("]", "")
        if isinstance(member, Branch | Locus):
            yield f"{file_stem}.nc", member.content
        elif isinstance(member, xr.Dataset | Orbit):
            yield f"{file_stem}.nc", netcdf_bytes(panels.trajectory_of_motion(member))
        if hasattr(member, "table"):
            yield f"{file_stem}.txt", f"{member.table()}\n".encode()
