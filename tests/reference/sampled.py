"""The motion of a linear oscillator at a given time, certified."""

from flint import arb, ctx

from .soft import Way


class Until(Way):
    """A mass on its way between walls that may be soft, to a time in place of a number of periods."""

    def __init__(self, draw, time):
        """draw: numbers may be balls, displaced by a little."""
        scene, x, v, phase = draw
        super().__init__(scene, arb(x), arb(v), arb(phase), 0.0, 1, 1e-2)
        self.end = arb(time)


def soft_end(draw, time, precision=400):
    """The `soft.Record` of the way to a time. Raises Discard and Undecided as `soft.strobe` does."""
    with ctx.workprec(precision):
        return Until(draw, time).go()
