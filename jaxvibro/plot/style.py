"""Colours, names and units that all pictures share."""

from typing import NamedTuple

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import is_color_like, to_rgb

from continuation.argument_types import ArgumentType, check_arguments

from ..output.units import LENGTH, SPEED, TIME, display_unit, quantity_text, read_scales, require_unit_system, unit_of
from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scales import require_scales

# Okabe and Ito's colours, safe for the colour-blind, in an order in which neighbours differ in lightness too.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#F0E442", "#009E73", "#56B4E9", "#D55E00")
WALL_COLOUR = "0.55"
COLOUR_KIND = ArgumentType(
    lambda value: value is None or (isinstance(value, str | tuple | list) and is_color_like(value)), "a colour or None"
)

# Decorates a picture, which refuses optional arguments that its annotations do not allow; it checks the others itself.
checked_picture = check_arguments(
    ArgumentError, lambda parameter: parameter.default is not parameter.empty, colour=COLOUR_KIND
)

LEGEND_GID = "legend"  # group id of those made here
DEFAULT_LINE_WIDTH = 1.5  # points, of matplotlib's lines

SYMBOLS = {"amplitude": "$A$", "frequency": r"$\omega$", "damping": r"$\gamma$", "restitution": "$R$"}
_PHYSICAL_SYMBOLS = {"amplitude": "$F$", "frequency": r"$\Omega/2\pi$", "damping": "$C$", "restitution": "$R$"}
_PARAMETER_LABELS = {
    "amplitude": r"drive amplitude $A = F\,/\,(M\omega_0^2 d)$",
    "frequency": r"drive frequency $\omega = \Omega\,/\,\omega_0$",
    "damping": r"damping $\gamma = C\,/\,(2M\omega_0)$",
    "restitution": r"restitution $R$",
    "stiffness": r"stiffness $k_2 = K_2\,/\,K$",
    "contact damping": r"damping in contact $\gamma_2 = C_2\,/\,(2M\omega_0)$",
    "hardness": r"hardness of the walls $\log_{10} k_2$",
    "position": r"mean position $X_b\,/\,d$",
    "motion.amplitude": r"amplitude of motion $B\,/\,d$",
    "motion.phase": r"phase of motion (rad)",
}
_PHYSICAL_LABELS = {
    "amplitude": "drive amplitude $F$ (N)",
    "frequency": r"drive frequency $\Omega\,/\,2\pi$ (Hz)",
    "damping": "damping $C$ (N s/m)",
    "restitution": "restitution $R$",
    "stiffness": "stiffness $K_2$ (N/m)",
    "contact damping": "damping in contact $C_2$ (N s/m)",
    "hardness": r"hardness of the walls $\log_{10}(K_2\,/\,K)$",
    "position": "mean position $X_b$ (mm)",
    "motion.amplitude": "amplitude of motion $B$ (mm)",
    "motion.phase": "phase of motion (rad)",
}
_DRIVE_TERM_LABELS = {"amplitude": "amplitude", "phase": "phase (rad)"}
COORDINATE_LABELS = {"x": r"position $x = X\,/\,d$", "v": r"velocity $v = \dot X\,/\,(d\,\omega_0)$"}
_PHYSICAL_COORDINATES = {"x": "position $X$ (mm)", "v": r"velocity $\dot X$ (m/s)"}
VARIABLE_LABELS = {
    **COORDINATE_LABELS,
    "clearance": r"least clearance$\,/\,d$",
    "speed": r"largest impact speed$\,/\,(d\,\omega_0)$",
    "least_speed": r"least impact speed$\,/\,(d\,\omega_0)$",
    "peak": r"largest position $\max|x| = \max|X|\,/\,d$",
}
_PHYSICAL_VARIABLES = {
    **_PHYSICAL_COORDINATES,
    "clearance": "least clearance (mm)",
    "speed": "largest impact speed (m/s)",
    "least_speed": "least impact speed (m/s)",
    "peak": r"largest position $\max|X|$ (mm)",
}
VARIABLE_UNITS = {"x": LENGTH, "v": SPEED, "clearance": LENGTH, "speed": SPEED, "least_speed": SPEED, "peak": LENGTH}
TIME_LABEL = r"time in drive periods, $\omega t\,/\,2\pi$"


def value_text(scales, name, value):
    """A scene's parameter as "A = 4.65", or with `Scales` as "F = 12 N"; its name where it has no symbol."""
    symbol = (SYMBOLS if scales is None else _PHYSICAL_SYMBOLS).get(name, escape_formulas(name))
    return f"{symbol} = {quantity_text(scales, unit_of(name), value)}"


class Axis(NamedTuple):
    """What an axis shows. label: its text; factor: what the scene's numbers are multiplied by."""

    label: str
    factor: float


def parameter_axis(scales, name):
    """The `Axis` of a scene's parameter, in the scene's units, or with `Scales` in physical ones."""
    return Axis(
        parameter_label(name, _PARAMETER_LABELS if scales is None else _PHYSICAL_LABELS),
        display_unit(unit_of(name), scales)[1],
    )


def variable_axis(scales, name):
    """The `Axis` of a variable of a motion or orbit, likewise. Raises ArgumentError."""
    check.require_choice("variable", name, VARIABLE_LABELS)
    return Axis(
        (VARIABLE_LABELS if scales is None else _PHYSICAL_VARIABLES)[name],
        display_unit(VARIABLE_UNITS[name], scales)[1],
    )


def time_axis(scales, frequency):
    """The `Axis` of a time: in periods of a drive, or with `Scales` in seconds."""
    if scales is None:
        return Axis(TIME_LABEL, frequency / (2.0 * np.pi))
    unit, factor = display_unit(TIME, scales)
    return Axis(f"time ({unit})", factor)


def phase_plane_axes(scales):
    """The `Axis` of position and that of velocity."""
    return variable_axis(scales, "x"), variable_axis(scales, "v")


def scales_of(record, units):
    """None for the units "scene"; for "physical" the `Scales` of a scene, of a record or its scene, or of a Dataset."""
    if require_unit_system(units) == "scene":
        return None
    return read_scales(record) if isinstance(record, xr.Dataset) else require_scales(getattr(record, "scene", record))


def parameter_label(name, labels=_PARAMETER_LABELS):
    """The axis label of a scene's parameter, symbol and unit included."""
    side, _, remainder = name.partition(".")
    if side == "force":
        return f"force: {escape_formulas(remainder)}"
    if side == "drive":
        term, _, field = remainder.partition(".")
        return f"{_DRIVE_TERM_LABELS[field]} of the drive's term {term}"
    remainder = "contact damping" if remainder == "damping" else remainder
    return f"{side} wall: {labels[remainder]}" if remainder else labels[name]


def scaled_line_width(width):
    """A line's width, points, in proportion to what `rcParams` say of lines."""
    return width * mpl.rcParams["lines.linewidth"] / DEFAULT_LINE_WIDTH


def escape_formulas(text):
    """A text of the user's as matplotlib shows it letter by letter, formula signs included."""
    return text.replace("$", r"\$")


def lighten(colour):
    """A colour half way to white."""
    return tuple(0.5 + 0.5 * channel for channel in to_rgb(colour))


def cell_edges(values):
    """The edges of cells around values; around a single one, of width 1."""
    half_widths = 0.5 * (np.diff(values) if len(values) > 1 else np.ones(1))
    return np.concatenate(
        [values[:1] - half_widths[:1], values[:-1] + half_widths[: len(values) - 1], values[-1:] + half_widths[-1:]]
    )


def axes_or_new(ax: Axes | None) -> Axes:
    """The Axes given, or those of a new figure."""
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def add_legend(ax, is_new):
    """A legend in Axes that were made for one picture, or have one of these; whoever gives Axes makes his own."""
    earlier_legend = ax.get_legend()
    if is_new or (earlier_legend is not None and earlier_legend.get_gid() == LEGEND_GID):
        ax.legend(frameon=False, fontsize="small").set_gid(LEGEND_GID)


def require_record(picture_name, record_type, *values):
    """Refuse what is not of the kind of record that a picture is of."""
    for value in values:
        if not isinstance(value, record_type):
            article = "an" if record_type.__name__[0] in "AEIOU" else "a"
            raise ArgumentError(
                f"plot.{picture_name}", f"must be given {article} {record_type.__name__}{_picture_hint(value)}", value
            )


def require_records(picture_name, record_type, values):
    """Refuse what is no tuple or list of such records."""
    if not isinstance(values, tuple | list):
        rule = f"must be given a tuple of {record_type.__name__}s{_picture_hint(values)}"
        raise ArgumentError(f"plot.{picture_name}", rule, values)
    require_record(picture_name, record_type, *values)


def require_dataset(picture_name, source, names, value):
    """Refuse what is no Dataset of a function's, which has variables, or attributes, of these names."""
    if not isinstance(value, xr.Dataset) or not all(name in value.variables or name in value.attrs for name in names):
        rule = f"must be given a Dataset of {source}{_picture_hint(value)}"
        raise ArgumentError(f"plot.{picture_name}", rule, type(value).__name__)


PICTURE_OF_TYPE = {name: f"plot.{name.lower()}" for name in ("Branch", "Orbit", "Locus", "Margin", "Fit")}
PICTURE_OF_TYPE |= {"HeldBranch": "plot.held", "Diagram": "plot.branch, one call for each of its branches"}


def _picture_hint(value):
    """The end of a rule that a record breaks: the picture that draws it; "" where there is none."""
    name = type(value).__name__
    article = "an" if name[0] in "AEIOU" else "a"
    return f" ({article} {name} is drawn by {PICTURE_OF_TYPE[name]})" if name in PICTURE_OF_TYPE else ""


def require_value(value):
    """Refuse a place along an axis that is no finite number."""
    check.finite_float("value", value)


def require_axes(ax):
    """Refuse what is no Axes."""
    if not isinstance(ax, Axes):
        raise ArgumentError("ax", "must be an Axes of matplotlib", ax)
