"""What a branch and a locus have in common: orbits in the rows of a Dataset, special points among them, two ends."""

from functools import cached_property

from ..maps import itinerary as words
from ..scene.check import ArgumentError
from .orbit_on_branch import described_orbit


class SpecialOrbit:
    """A class of special points has scene, at the point; spot, the `OrbitPoint`; itinerary."""

    @property
    def label(self):
        """P n p q of the orbit."""
        return words.label(self.itinerary)

    @cached_property
    def orbit(self):
        """The `Orbit` at the point. At a grazing an impact may have no speed."""
        return described_orbit(self.scene, self.spot)


class OrbitRows:
    """A class of these has data, special and reasons; `NOUN`, what it is called; `located(place)`: (the scene at a
    point, its `OrbitPoint`)."""

    def __len__(self):
        return self.data.sizes["point"]

    @property
    def reason(self):
        """Why each end is one: {"first": ..., "last": ...}."""
        return dict(zip(("first", "last"), self.reasons, strict=True))

    def points(self, kind):
        """The special points of a kind, a tuple."""
        return tuple(one for one in self.special if one.kind == kind)

    def orbit(self, place):
        """The `Orbit` at one of the points, by its place."""
        count = len(self)
        if not -count <= place < count:
            raise ArgumentError("place", f"must be a point of the {self.NOUN}, from 0 to {count - 1}", place)
        return described_orbit(*self.located(place))
