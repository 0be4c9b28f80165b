"""Define the colours, labels, units and argument checks that all figures share."""

from typing import NamedTuple

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import is_color_like, to_rgb

from continuation.argument_checks import ArgumentType, check_arguments

from ..output.units import LENGTH, SPEED, TIME, display_unit, quantity_text, read_scales, require_unit_system, unit_of
from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scales import require_scales
from ..scene.scene import SIDES

# Colours of Okabe and Ito for colour-blind readers, ordered so that neighbours also differ in lightness.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#F0E442", "#009E73", "#56B4E9", "#D55E00")
WALL_COLOUR = "0.55"
COLOUR_KIND = ArgumentType(
    lambda value: value is None or (isinstance(value, str | tuple | list) and is_color_like(value)), "a colour or None"
)

# Decorate a plot function: check its optional arguments by their annotations. It checks the required ones itself.
check_plot_options = check_arguments(
    ArgumentError, lambda parameter: parameter.default is not parameter.empty, colour=COLOUR_KIND
)

LEGEND_GID = "legend"  # group id of legends that `add_legend` makes
WALL_GID = "wall"  # group id of the lines of fixed walls
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


def parameter_value_text(scales, parameter_name, value):
    """Format a parameter of a scene for a title.

    Parameters
    ----------
    scales : Scales or None
        Physical scales; None formats the value in scene units.
    parameter_name : str
        Parameter.
    value : float
        Value in scene units.

    Returns
    -------
    str
        For example ``"A = 4.65"``, or ``"F = 12 N"`` with scales. A parameter without a symbol appears by its name.
    """
    parameter_symbol = (SYMBOLS if scales is None else _PHYSICAL_SYMBOLS).get(
        parameter_name, escape_formulas(parameter_name)
    )
    return f"{parameter_symbol} = {quantity_text(scales, unit_of(parameter_name), value)}"


class AxisLabelAndFactor(NamedTuple):
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


def parameter_axis(scales, parameter_name):
    """Return the label and the factor of the axis of a parameter.

    Parameters
    ----------
    scales : Scales or None
        Physical scales; None keeps scene units.
    parameter_name : str
        Parameter of a scene.

    Returns
    -------
    AxisLabelAndFactor
        Label and factor from scene units.
    """
    return AxisLabelAndFactor(
        parameter_label(parameter_name, _PARAMETER_LABELS if scales is None else _PHYSICAL_LABELS),
        display_unit(unit_of(parameter_name), scales)[1],
    )


def variable_axis(scales, variable):
    """Return the `AxisLabelAndFactor` of a variable of a motion or orbit, in physical units if `scales` is not None.

    Raises ArgumentError for an unknown variable.
    """
    check.require_choice("variable", variable, VARIABLE_LABELS)
    return AxisLabelAndFactor(
        (VARIABLE_LABELS if scales is None else _PHYSICAL_VARIABLES)[variable],
        display_unit(VARIABLE_UNITS[variable], scales)[1],
    )


def time_axis(scales, frequency):
    """Return the `AxisLabelAndFactor` of a time, in drive periods, or in seconds if `scales` is not None."""
    if scales is None:
        return AxisLabelAndFactor(TIME_LABEL, frequency / (2.0 * np.pi))
    unit, factor = display_unit(TIME, scales)
    return AxisLabelAndFactor(f"time ({unit})", factor)


def phase_plane_axes(scales):
    """Return the `AxisLabelAndFactor` of the position and the `AxisLabelAndFactor` of the velocity."""
    return variable_axis(scales, "x"), variable_axis(scales, "v")


def scales_of(record, unit_system):
    """Return the physical scales of a record, or None for scene units.

    Parameters
    ----------
    record : Scene, Dataset or record with a scene
        Source of the scales.
    unit_system : {"scene", "physical"}
        Units of a figure.

    Returns
    -------
    Scales or None
        None for scene units, else the scales of the record.

    Raises
    ------
    ArgumentError
        If `unit_system` is unknown, or ``"physical"`` and the scene has no scales.
    """
    if require_unit_system(unit_system) == "scene":
        return None
    return read_scales(record) if isinstance(record, xr.Dataset) else require_scales(getattr(record, "scene", record))


def parameter_label(parameter_name, labels=_PARAMETER_LABELS):
    """Return the axis label of a parameter of a scene, with symbol and unit.

    Parameters
    ----------
    parameter_name : str
        Parameter, for example ``"amplitude"``, ``"left.position"``, ``"force.k"`` or ``"drive.1.phase"``.
    labels : dict of str to str, optional
        Labels of the parameters, by default in scene units.

    Returns
    -------
    str
        Label, with matplotlib formulas.
    """
    prefix, _, name_after_dot = parameter_name.partition(".")
    if prefix == "force":
        return f"force: {escape_formulas(name_after_dot)}"
    if prefix == "drive":
        drive_term_number, _, drive_term_field = name_after_dot.partition(".")
        return f"{_DRIVE_TERM_LABELS[drive_term_field]} of the drive's term {drive_term_number}"
    name_after_dot = "contact damping" if name_after_dot == "damping" else name_after_dot
    return f"{prefix} wall: {labels[name_after_dot]}" if name_after_dot else labels[parameter_name]


def rc_scaled_line_width(width):
    """Return a line width in points, scaled by the ratio of the line width in `rcParams` to the default."""
    return width * mpl.rcParams["lines.linewidth"] / DEFAULT_LINE_WIDTH


def escape_formulas(text):
    """Escape dollar signs in user text, so that matplotlib shows the text literally.

    Parameters
    ----------
    text : str
        User text.

    Returns
    -------
    str
        Escaped text.
    """
    return text.replace("$", r"\$")


def lighten(colour):
    """Return a colour half way to white."""
    return tuple(0.5 + 0.5 * channel for channel in to_rgb(colour))


def cell_edges(cell_centres):
    """Return the edges of cells around values; the cell of a single value has width 1."""
    half_widths = 0.5 * (np.diff(cell_centres) if len(cell_centres) > 1 else np.ones(1))
    return np.concatenate(
        [
            cell_centres[:1] - half_widths[:1],
            cell_centres[:-1] + half_widths[: len(cell_centres) - 1],
            cell_centres[-1:] + half_widths[-1:],
        ]
    )


def fixed_wall_positions(attributes):
    """Return the positions of the fixed walls in the attributes of a Dataset, in scene units."""
    return [
        attributes[f"{side}.position"]
        for side in SIDES
        if f"{side}.position" in attributes and f"{side}.motion.amplitude" not in attributes
    ]


def draw_fixed_walls(ax, positions):
    """Draw each wall once as a horizontal line, unless it is far from the curves."""
    y_min, y_max = ax.get_ylim()
    axis_margin = (y_max - y_min) / 4
    for position in positions:
        if y_min - axis_margin <= position <= y_max + axis_margin and not any(
            line.get_gid() == WALL_GID and line.get_ydata()[0] == position for line in ax.lines
        ):
            ax.axhline(position, color=WALL_COLOUR, linewidth=0.8, zorder=0, gid=WALL_GID)


def label_once(ax, gid, legend_text):
    """Return a text as a label, hidden in the legend if a line of this group id already has the text as its label."""
    is_labelled = any(line.get_gid() == gid and line.get_label() == legend_text for line in ax.lines)
    return f"_{legend_text}" if is_labelled else legend_text


def axes_or_new(ax: Axes | None) -> Axes:
    """Return the given Axes, or the Axes of a new figure for None."""
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def axes_width_in_points(ax):
    """Return the width of Axes in points."""
    return 72.0 * ax.figure.get_figwidth() * ax.get_position().width


def add_legend(ax, is_new_axes):
    """Add a legend to new Axes, or update a legend that `add_legend` made; legends of the user remain unchanged."""
    earlier_legend = ax.get_legend()
    if is_new_axes or (earlier_legend is not None and earlier_legend.get_gid() == LEGEND_GID):
        ax.legend(frameon=False, fontsize="small").set_gid(LEGEND_GID)


def require_record(plot_name, record_type, *values):
    """Raise ArgumentError unless every value is a record of this type."""
    for value in values:
        if not isinstance(value, record_type):
            indefinite_article = "an" if record_type.__name__[0] in "AEIOU" else "a"
            raise ArgumentError(
                f"plot.{plot_name}",
                f"must be given {indefinite_article} {record_type.__name__}{_plot_function_hint(value)}",
                value,
            )


def require_records(plot_name, record_type, values):
    """Raise ArgumentError unless `values` is a tuple or list of records of this type."""
    if not isinstance(values, tuple | list):
        error_rule = f"must be given a tuple of {record_type.__name__}s{_plot_function_hint(values)}"
        raise ArgumentError(f"plot.{plot_name}", error_rule, values)
    require_record(plot_name, record_type, *values)


def require_dataset(plot_name, source_function, required_names, value):
    """Raise ArgumentError unless `value` is a Dataset with variables or attributes of these names."""
    if not isinstance(value, xr.Dataset) or not all(
        required_name in value.variables or required_name in value.attrs for required_name in required_names
    ):
        error_rule = f"must be given a Dataset of {source_function}{_plot_function_hint(value)}"
        raise ArgumentError(f"plot.{plot_name}", error_rule, type(value).__name__)


PICTURE_OF_TYPE = {name: f"plot.{name.lower()}" for name in ("Branch", "Orbit", "Locus", "Margin", "Fit")}
PICTURE_OF_TYPE |= {"HeldBranch": "plot.held", "Diagram": "plot.branch, one call for each of its branches"}


def _plot_function_hint(value):
    """Return the end of an error text that names the plot function of a record; "" if it has no plot function."""
    type_name = type(value).__name__
    indefinite_article = "an" if type_name[0] in "AEIOU" else "a"
    return (
        f" ({indefinite_article} {type_name} is drawn by {PICTURE_OF_TYPE[type_name]})"
        if type_name in PICTURE_OF_TYPE
        else ""
    )
