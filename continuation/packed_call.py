"""A compiled function called from the host: its many small numbers handed over, and fetched, in one array of each type.

Handing an array over takes two microseconds, fetching one three, and a scene, a place and a control are thirty: most of
the time of a short function.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax

from .in_numpy import PLAIN


class Layout:
    """How arrays lie in one row for each type. like: what has their shapes and types."""

    def __init__(self, like):
        shapes = [np.shape(each) for each in like]
        groups, found = {}, {}
        for place, each in enumerate(like):
            groups.setdefault(np.dtype(each.dtype), []).append(place)
        self.order = list(groups.values())
        for row, group in enumerate(self.order):
            first = 0
            for place in group:
                size = math.prod(shapes[place])
                found[place] = row, first, first + size, shapes[place]
                first += size
        self.places = [found[place] for place in range(len(shapes))]  # of each array: (which row, from, up to, shape)

    def rows(self, arrays: Sequence[Any]) -> list[np.ndarray]:
        """The rows, of NumPy's arrays."""
        return [np.concatenate([arrays[place] for place in group], axis=None) for group in self.order]

    def arrays(self, rows: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The arrays in NumPy's rows."""
        return [rows[row][first:last].reshape(shape) for row, first, last, shape in self.places]

    def traced_rows(self, arrays: Sequence[Any]) -> list[jax.Array]:
        """The rows, of jax's arrays."""
        flat = [lax.reshape(each, (each.size,)) for each in arrays]
        return [lax.concatenate([flat[place] for place in group], 0) for group in self.order]

    def traced_arrays(self, rows: Sequence[jax.Array]) -> list[jax.Array]:
        """The arrays in jax's rows."""
        return [lax.reshape(lax.slice(rows[row], (first,), (last,)), shape) for row, first, last, shape in self.places]


class PackedCall:
    """A function of numbers, compiled for those of one kind: of leaves, as the host has them, to its result with
    NumPy's arrays. function: of the leaves in a row; leaves: some of that kind."""

    def __init__(self, function: Callable[..., Any], leaves: Sequence[Any], options: dict[str, Any]) -> None:
        self.function = function
        self.packed = [place for place, leaf in enumerate(leaves) if type(leaf) not in PLAIN]
        self.plain = [place for place, leaf in enumerate(leaves) if type(leaf) in PLAIN]
        self.given = Layout([leaves[place] for place in self.packed])
        self.found: tuple[Layout, Any] | None = None
        self.run = jax.jit(self._traced, **options)

    def _traced(self, rows, plain):
        leaves = dict(zip(self.packed, self.given.traced_arrays(rows), strict=True))
        leaves |= zip(self.plain, plain, strict=True)
        results, form = jax.tree.flatten(self.function(*[leaves[place] for place in range(len(leaves))]))
        results = [jax.numpy.asarray(each) for each in results]
        layout = Layout(results)
        self.found = layout, form
        return layout.traced_rows(results)

    def __call__(self, leaves: Sequence[Any]) -> Any:
        arrays = [leaves[place] for place in self.packed] if self.plain else leaves
        results = self.run(self.given.rows(arrays), [leaves[place] for place in self.plain])
        assert self.found is not None  # it has been traced
        layout, form = self.found
        return form.unflatten(layout.arrays([np.asarray(each) for each in results]))
