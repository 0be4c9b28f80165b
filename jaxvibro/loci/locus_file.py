"""The file of a locus, read: every field is held against what `Locus.save` writes."""

from os import PathLike

from ..output.checksums import opened
from ..output.saved_fields import field, record_of, require_bounds, require_columns, require_fit, scene_in
from ..output.units import scales_in
from ..scene import check
from .first_point import KINDS, RESTS
from .locus import Locus, codim2_of

DIMS: dict[str, tuple[str, ...]] = dict.fromkeys(("least_speed", "least_clearance", "residual"), ("point",))
DIMS |= dict.fromkeys(("time", "speed", "side"), ("point", "impact"))
DIMS |= dict.fromkeys(("multiplier_real", "multiplier_imag"), ("point", "multiplier"))


@check.host("use what was loaded before")
def load_locus(path: str | PathLike[str]) -> Locus:
    """The `Locus` of a file that `Locus.save` wrote.

    Raises ArgumentError where the file is damaged or no locus, OSError where it cannot be read.
    """
    return opened(path, lambda content, path: record_of(content, path, "Locus", _locus))


def _locus(data):
    """The `Locus` of a file's data. Raises an error of one kind or another where its fields are no locus'."""
    attrs = data.attrs
    kind, bounds = str(attrs["kind"]), field(attrs, "bounds", dict[str, tuple[float, float]])
    names = tuple(bounds)
    require_fit("kind", kind in (*KINDS, *RESTS))
    require_fit("parameters", len(names) == 2)
    for each in bounds.values():
        require_bounds(each)
    scene = scene_in(attrs, *names)
    require_columns(data, dict.fromkeys(names, ("point",)) | DIMS, (*names, "residual"))
    periods = int(attrs["periods"])
    require_fit("periods", periods > 0)
    told, reasons = field(attrs, "special", list[tuple[str, int, float]]), field(attrs, "reasons", tuple[str, str])
    require_fit("special", told and all(each and 0 <= place < data.sizes["point"] for each, place, _ in told))
    data.attrs = {"periods": periods, **scales_in(scene)}
    special = tuple(codim2_of(scene, kind, bounds, data, place, each, residual) for each, place, residual in told)
    return Locus(kind, names, bounds, scene, data, special, reasons)
