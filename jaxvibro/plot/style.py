"""Define the colours, labels, units and argument checks that all figures share."""

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

# Colours of Okabe and Ito for colour-blind readers, ordered so that neighbours also differ in lightness.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#F0E442", "#009E73", "#56B4E9", "#D55E00")
WALL_COLOUR = "0.55"
COLOUR_KIND = ArgumentType(
    lambda value: value is None or (isinstance(value, str | tuple | list) and is_color_like(value)), "a colour or None"
)

# Decorate a plot function: check its optional arguments by their annotations. It checks the required ones itself.
checked_picture = check_arguments(
    ArgumentError, lambda parameter: parameter.default is not parameter.empty, colour=COLOUR_KIND
)

LEGEND_GID = "legend"  # group id of legends that `add_legend` makes
DEFAULT_LINE_WIDTH = 1.5  # points, the default of matplotlib

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
    """Format a parameter of a scene for a title.

    Parameters
    ----------
    scales : Scales or None
        Physical scales; None formats the value in scene units.
    name : str
        Parameter.
    value : float
        Value in scene units.

    Returns
    -------
    str
        For example ``"A = 4.65"``, or ``"F = 12 N"`` with scales. A parameter without a symbol appears by its name.
    """
    symbol = (SYMBOLS if scales is None else _PHYSICAL_SYMBOLS).get(name, escape_formulas(name))
    return f"{symbol} = {quantity_text(scales, unit_of(name), value)}"


class Axis(NamedTuple):
    """Label of an axis and the factor from scene units to the units of the axis.

    Attributes
    ----------
    label : str
        Text of the axis.
    factor : float
        Factor that converts numbers of the scene into the units of the axis.
    """

    label: str
    factor: float


def parameter_axis(scales, name):
    """Return the label and the factor of the axis of a parameter.

    Parameters
    ----------
    scales : Scales or None
        Physical scales; None keeps scene units.
    name : str
        Parameter of a scene.

    Returns
    -------
    Axis
        Label and factor from scene units.
    """
    return Axis(
        parameter_label(name, _PARAMETER_LABELS if scales is None else _PHYSICAL_LABELS),
        display_unit(unit_of(name), scales)[1],
    )


def variable_axis(scales, name):
    """Return the `Axis` of a variable of a motion or orbit, in scene units, or with `Scales` in physical units.

    Raises ArgumentError for an unknown variable.
    """
    check.require_choice("variable", name, VARIABLE_LABELS)
    return Axis(
        (VARIABLE_LABELS if scales is None else _PHYSICAL_VARIABLES)[name],
        display_unit(VARIABLE_UNITS[name], scales)[1],
    )


def time_axis(scales, frequency):
    """Return the `Axis` of a time, in drive periods, or with `Scales` in seconds."""
    if scales is None:
        return Axis(TIME_LABEL, frequency / (2.0 * np.pi))
    unit, factor = display_unit(TIME, scales)
    return Axis(f"time ({unit})", factor)


def phase_plane_axes(scales):
    """Return the `Axis` of the position and that of the velocity."""
    return variable_axis(scales, "x"), variable_axis(scales, "v")


def scales_of(record, units):
    """Return the scales for a system of units.

    Parameters
    ----------
    record : Scene, Dataset or record with a scene
        Source of the scales.
    units : {"scene", "physical"}
        Units of a figure.

    Returns
    -------
    Scales or None
        None for scene units, else the scales of the record.

    Raises
    ------
    ArgumentError
        If `units` is unknown, or ``"physical"`` and the scene has no scales.
    """
    if require_unit_system(units) == "scene":
        return None
    return read_scales(record) if isinstance(record, xr.Dataset) else require_scales(getattr(record, "scene", record))


def parameter_label(name, labels=_PARAMETER_LABELS):
    """Return the axis label of a parameter of a scene, with symbol and unit.

    Parameters
    ----------
    name : str
        Parameter, for example ``"amplitude"``, ``"left.position"``, ``"force.k"`` or ``"drive.1.phase"``.
    labels : dict of str to str, optional
        Labels of the parameters. The default has scene units.

    Returns
    -------
    str
        Label, with matplotlib formulas.
    """
    side, _, remainder = name.partition(".")
    if side == "force":
        return f"force: {escape_formulas(remainder)}"
    if side == "drive":
        term, _, field = remainder.partition(".")
        return f"{_DRIVE_TERM_LABELS[field]} of the drive's term {term}"
    remainder = "contact damping" if remainder == "damping" else remainder
    return f"{side} wall: {labels[remainder]}" if remainder else labels[name]


def scaled_line_width(width):
    """Return a line width in points, scaled by the line width in `rcParams`."""
    return width * mpl.rcParams["lines.linewidth"] / DEFAULT_LINE_WIDTH


def escape_formulas(text):
    """Escape formula signs in user text, so that matplotlib shows it literally.

    Parameters
    ----------
    text : str
        Text of the user.

    Returns
    -------
    str
        Escaped text.
    """
    return text.replace("$", r"\$")


def lighten(colour):
    """Return a colour half way to white."""
    return tuple(0.5 + 0.5 * channel for channel in to_rgb(colour))


def cell_edges(values):
    """Return the edges of cells around values; the cell of a single value has width 1."""
    half_widths = 0.5 * (np.diff(values) if len(values) > 1 else np.ones(1))
    return np.concatenate(
        [values[:1] - half_widths[:1], values[:-1] + half_widths[: len(values) - 1], values[-1:] + half_widths[-1:]]
    )


def axes_or_new(ax: Axes | None) -> Axes:
    """Return the given Axes, or those of a new figure."""
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def add_legend(ax, is_new):
    """Add a legend to new Axes, or update one that this function made; leave user legends alone."""
    earlier_legend = ax.get_legend()
    if is_new or (earlier_legend is not None and earlier_legend.get_gid() == LEGEND_GID):
        ax.legend(frameon=False, fontsize="small").set_gid(LEGEND_GID)


def require_record(picture_name, record_type, *values):
    """Raise ArgumentError unless every value is a record of this type."""
    for value in values:
        if not isinstance(value, record_type):
            article = "an" if record_type.__name__[0] in "AEIOU" else "a"
            raise ArgumentError(
                f"plot.{picture_name}", f"must be given {article} {record_type.__name__}{_picture_hint(value)}", value
            )


def require_records(picture_name, record_type, values):
    """Raise ArgumentError unless `values` is a tuple or list of records of this type."""
    if not isinstance(values, tuple | list):
        rule = f"must be given a tuple of {record_type.__name__}s{_picture_hint(values)}"
        raise ArgumentError(f"plot.{picture_name}", rule, values)
    require_record(picture_name, record_type, *values)


def require_dataset(picture_name, source, names, value):
    """Raise ArgumentError unless `value` is a Dataset with variables or attributes of these names."""
    if not isinstance(value, xr.Dataset) or not all(name in value.variables or name in value.attrs for name in names):
        rule = f"must be given a Dataset of {source}{_picture_hint(value)}"
        raise ArgumentError(f"plot.{picture_name}", rule, type(value).__name__)


PICTURE_OF_TYPE = {name: f"plot.{name.lower()}" for name in ("Branch", "Orbit", "Locus", "Margin", "Fit")}
PICTURE_OF_TYPE |= {"HeldBranch": "plot.held", "Diagram": "plot.branch, one call for each of its branches"}


def _picture_hint(value):
    """Return the end of an error text that names the function for this record; "" if there is none."""
    name = type(value).__name__
    article = "an" if name[0] in "AEIOU" else "a"
    return f" ({article} {name} is drawn by {PICTURE_OF_TYPE[name]})" if name in PICTURE_OF_TYPE else ""


def require_value(value):
    """Raise ArgumentError unless a position along an axis is a finite number."""
    check.finite_float("value", value)


def require_axes(ax):
    """Raise ArgumentError unless `ax` is an Axes."""
    if not isinstance(ax, Axes):
        raise ArgumentError("ax", "must be an Axes of matplotlib", ax)
