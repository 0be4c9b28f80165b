"""Read a `Locus` from a file and check every field of the file: `load_locus`."""

from os import PathLike

from ..output.checksums import parse_checked_file
from ..output.saved_curve_checks import (
    decode_field,
    decode_plane_curve,
    parse_saved_curve,
    require_valid_columns,
    require_valid_field,
)
from ..output.units import scales_attributes
from ..scene import check
from .locus import Locus, build_codim2
from .locus_start import KINDS, STICKING_KINDS

DIMENSIONS: dict[str, tuple[str, ...]] = dict.fromkeys(("least_speed", "least_clearance", "residual"), ("point",))
DIMENSIONS |= dict.fromkeys(("time", "speed", "side"), ("point", "impact"))
DIMENSIONS |= dict.fromkeys(("multiplier_real", "multiplier_imag"), ("point", "multiplier"))


@check.host_only("use what was loaded before")
def load_locus(path: str | PathLike[str]) -> Locus:
    """Read a locus from a file that `Locus.save` wrote.

    Parameters
    ----------
    path : str or os.PathLike
        Path of the file.

    Returns
    -------
    Locus
        The locus, with the same numbers as when it was saved.

    Raises
    ------
    ArgumentError
        If the file is damaged or is not a locus.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> special = branch.points("SN")[0]
    >>> curve = jv.locus(special, ("amplitude", "frequency"), {"amplitude": (0.0, 6.0), "frequency": (2.05, 2.15)})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     curve.save(f"{folder}/curve.nc")
    ...     print(jv.load_locus(f"{folder}/curve.nc").kind)
    SN
    """
    return parse_checked_file(path, lambda content, path: parse_saved_curve(content, path, "Locus", _parse_locus))


def _parse_locus(data):
    """Build the `Locus` from the data of a file, or raise an error if a field is invalid."""
    attrs = data.attrs
    kind, (names, bounds, scene, reasons) = str(attrs["kind"]), decode_plane_curve(attrs)
    require_valid_field("kind", kind in (*KINDS, *STICKING_KINDS))
    require_valid_columns(data, dict.fromkeys(names, ("point",)) | DIMENSIONS, (*names, "residual"))
    periods = int(attrs["periods"])
    require_valid_field("periods", periods > 0)
    codim2_entries = decode_field(attrs, "special", list[tuple[str, int, float]])
    require_valid_field(
        "special",
        codim2_entries
        and all(entry and 0 <= row_index < data.sizes["point"] for entry, row_index, _ in codim2_entries),
    )
    data.attrs = {"periods": periods, **scales_attributes(scene)}
    special = tuple(
        build_codim2(scene, kind, bounds, data, row_index, entry, residual)
        for entry, row_index, residual in codim2_entries
    )
    return Locus(kind, names, bounds, scene, data, special, reasons)
