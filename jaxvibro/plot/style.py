"""Colours, names and units that all pictures share."""

from typing import NamedTuple

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import is_color_like, to_rgb

from continuation.argument_types import Kind, checked

from ..output.units import LENGTH, SPEED, TIME, amount_text, require_system, scales_from, told, unit_of
from ..scene import check
from ..scene.check import ArgumentError
from ..scene.scales import require_scales

# Okabe and Ito's colours, safe for the colour-blind, in an order in which neighbours differ in lightness too.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#F0E442", "#009E73", "#56B4E9", "#D55E00")
WALL = "0.55"
COLOUR = Kind(
    lambda one: one is None or (isinstance(one, str | tuple | list) and is_color_like(one)), "a colour or None"
)

# Decorates a picture, which refuses optional arguments that its annotations do not allow; it checks the others itself.
picture = checked(ArgumentError, lambda parameter: parameter.default is not parameter.empty, colour=COLOUR)

LEGEND = "legend"  # group id of those made here
OWN_WIDTH = 1.5  # points, of matplotlib's lines

SYMBOLS = {"amplitude": "$A$", "frequency": r"$\omega$", "damping": r"$\gamma$", "restitution": "$R$"}
_PHYSICAL_SYMBOLS = {"amplitude": "$F$", "frequency": r"$\Omega/2\pi$", "damping": "$C$", "restitution": "$R$"}
_PARAMETERS = {
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
_PHYSICAL = {
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
_OF_TERM = {"amplitude": "amplitude", "phase": "phase (rad)"}
COORDINATES = {"x": r"position $x = X\,/\,d$", "v": r"velocity $v = \dot X\,/\,(d\,\omega_0)$"}
_PHYSICAL_COORDINATES = {"x": "position $X$ (mm)", "v": r"velocity $\dot X$ (m/s)"}
VARIABLES = {
    **COORDINATES,
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
UNITS = {"x": LENGTH, "v": SPEED, "clearance": LENGTH, "speed": SPEED, "least_speed": SPEED, "peak": LENGTH}
TIME_IN_PERIODS = r"time in drive periods, $\omega t\,/\,2\pi$"


def value_text(scales, name, value):
    """A scene's parameter as "A = 4.65", or with `Scales` as "F = 12 N"; its name where it has no symbol."""
    symbol = (SYMBOLS if scales is None else _PHYSICAL_SYMBOLS).get(name, plain(name))
    return f"{symbol} = {amount_text(scales, unit_of(name), value)}"


class Axis(NamedTuple):
    """What an axis shows. label: its text; size: what the scene's numbers are multiplied by."""

    label: str
    size: float


def of_parameter(scales, name):
    """The `Axis` of a scene's parameter, in the scene's units, or with `Scales` in physical ones."""
    return Axis(label(name, _PARAMETERS if scales is None else _PHYSICAL), told(unit_of(name), scales)[1])


def of_variable(scales, name):
    """The `Axis` of a variable of a motion or orbit, likewise. Raises ArgumentError."""
    check.choice("variable", name, VARIABLES)
    return Axis((VARIABLES if scales is None else _PHYSICAL_VARIABLES)[name], told(UNITS[name], scales)[1])


def of_time(scales, frequency):
    """The `Axis` of a time: in periods of a drive, or with `Scales` in seconds."""
    if scales is None:
        return Axis(TIME_IN_PERIODS, frequency / (2.0 * np.pi))
    unit, size = told(TIME, scales)
    return Axis(f"time ({unit})", size)


def of_plane(scales):
    """The `Axis` of position and that of velocity."""
    return of_variable(scales, "x"), of_variable(scales, "v")


def scales_of(one, units):
    """None for the units "scene"; for "physical" the `Scales` of a scene, of a record or its scene, or of a Dataset."""
    if require_system(units) == "scene":
        return None
    return scales_from(one) if isinstance(one, xr.Dataset) else require_scales(getattr(one, "scene", one))


def label(name, parameters=_PARAMETERS):
    """The axis label of a scene's parameter, symbol and unit included."""
    side, _, rest = name.partition(".")
    if side == "force":
        return f"force: {plain(rest)}"
    if side == "drive":
        place, _, own = rest.partition(".")
        return f"{_OF_TERM[own]} of the drive's term {place}"
    rest = "contact damping" if rest == "damping" else rest
    return f"{side} wall: {parameters[rest]}" if rest else parameters[name]


def wide(points):
    """A line's width, points, in proportion to what `rcParams` say of lines."""
    return points * mpl.rcParams["lines.linewidth"] / OWN_WIDTH


def plain(text):
    """A text of the user's as matplotlib shows it letter by letter, formula signs included."""
    return text.replace("$", r"\$")


def paler(colour):
    """A colour half way to white."""
    return tuple(0.5 + 0.5 * part for part in to_rgb(colour))


def edges(values):
    """The edges of cells around values; around a single one, of width 1."""
    half = 0.5 * (np.diff(values) if len(values) > 1 else np.ones(1))
    return np.concatenate([values[:1] - half[:1], values[:-1] + half[: len(values) - 1], values[-1:] + half[-1:]])


def axes(ax: Axes | None) -> Axes:
    """The Axes given, or those of a new figure."""
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def legend(ax, alone):
    """A legend in Axes that were made for one picture, or have one of these; whoever gives Axes makes his own."""
    known = ax.get_legend()
    if alone or (known is not None and known.get_gid() == LEGEND):
        ax.legend(frameon=False, fontsize="small").set_gid(LEGEND)


def is_of(picture, kind, *values):
    """Refuse what is not of the kind of record that a picture is of."""
    for value in values:
        if not isinstance(value, kind):
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            raise ArgumentError(f"plot.{picture}", f"must be given {article} {kind.__name__}{_drawn_by(value)}", value)


def are_of(picture, kind, values):
    """Refuse what is no tuple or list of such records."""
    if not isinstance(values, tuple | list):
        rule = f"must be given a tuple of {kind.__name__}s{_drawn_by(values)}"
        raise ArgumentError(f"plot.{picture}", rule, values)
    is_of(picture, kind, *values)


def is_from(picture, source, names, value):
    """Refuse what is no Dataset of a function's, which has variables, or attributes, of these names."""
    if not isinstance(value, xr.Dataset) or not all(name in value.variables or name in value.attrs for name in names):
        rule = f"must be given a Dataset of {source}{_drawn_by(value)}"
        raise ArgumentError(f"plot.{picture}", rule, type(value).__name__)


DRAWN_BY = {name: f"plot.{name.lower()}" for name in ("Branch", "Orbit", "Locus", "Margin", "Fit")}
DRAWN_BY |= {"HeldBranch": "plot.held", "Diagram": "plot.branch, one call for each of its branches"}


def _drawn_by(value):
    """The end of a rule that a record breaks: the picture that draws it; "" where there is none."""
    name = type(value).__name__
    article = "an" if name[0] in "AEIOU" else "a"
    return f" ({article} {name} is drawn by {DRAWN_BY[name]})" if name in DRAWN_BY else ""


def require_value(value):
    """Refuse a place along an axis that is no finite number."""
    check.single("value", value)


def require_axes(ax):
    """Refuse what is no Axes."""
    if not isinstance(ax, Axes):
        raise ArgumentError("ax", "must be an Axes of matplotlib", ax)
