"""Colours, names and units that all pictures share."""

import matplotlib.pyplot as plt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from ..scene.check import ArgumentError

# Okabe and Ito's colours, safe for the colour-blind, in an order in which neighbours differ in lightness too.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#F0E442", "#009E73", "#56B4E9", "#D55E00")
WALL = "0.55"

SYMBOLS = {"amplitude": "$A$", "frequency": r"$\omega$", "damping": r"$\gamma$", "restitution": "$R$"}
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
_OF_TERM = {"amplitude": "amplitude", "phase": "phase (rad)"}
COORDINATES = {"x": r"position $x = X\,/\,d$", "v": r"velocity $v = \dot X\,/\,(d\,\omega_0)$"}
TIME = r"time in drive periods, $\omega t\,/\,2\pi$"


def label(name):
    """The axis label of a scene's parameter, symbol and unit included."""
    side, _, rest = name.partition(".")
    if side == "force":
        return f"force: {plain(rest)}"
    if side == "drive":
        place, _, own = rest.partition(".")
        return f"{_OF_TERM[own]} of the drive's term {place}"
    rest = "contact damping" if rest == "damping" else rest
    return f"{side} wall: {_PARAMETERS[rest]}" if rest else _PARAMETERS[name]


def plain(text):
    """A text of the user's as matplotlib shows it letter by letter, formula signs included."""
    return text.replace("$", r"\$")


def paler(colour):
    """A colour half way to white."""
    return tuple(0.5 + 0.5 * part for part in to_rgb(colour))


def axes(ax: Axes | None) -> Axes:
    """The Axes given, or those of a new figure."""
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def is_of(picture, kind, *values):
    """Refuse what is not of the kind of record that a picture is of."""
    for value in values:
        if not isinstance(value, kind):
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            raise ArgumentError(f"plot.{picture}", f"must be given {article} {kind.__name__}", value)


def are_of(picture, kind, values):
    """Refuse what is no tuple or list of such records."""
    if not isinstance(values, tuple | list):
        raise ArgumentError(f"plot.{picture}", f"must be given a tuple of {kind.__name__}s", values)
    is_of(picture, kind, *values)


def is_from(picture, source, names, value):
    """Refuse what is no Dataset of a function's, which has variables, or attributes, of these names."""
    if not isinstance(value, xr.Dataset) or not all(name in value.variables or name in value.attrs for name in names):
        raise ArgumentError(f"plot.{picture}", f"must be given a Dataset of {source}", type(value).__name__)
