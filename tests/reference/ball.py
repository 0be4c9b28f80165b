"""The exact flow of x'' + 2 gamma x' + x = A cos(theta0 + omega t) in ball arithmetic (python-flint).

Every double is taken as the exact number it stores; every result is a ball that contains the true value.
"""

from flint import arb, arb_mat, ctx

PRECISION = 200
SMALL = 1e-6  # below this D the closed form cancels too much and the matrix exponential is taken


class Spring:
    """x'' + 2 g x' + k x = 0, for under-, critical and overdamping alike; k and g are balls."""

    def __init__(self, k, g):
        self.k, self.g = k, g
        square = k - g**2  # exact, so that critical damping is seen
        self.kind = 0 if square == 0 else (1 if square > 0 else -1)
        self.root = abs(square).sqrt()

    def homogeneous(self, t):
        """Rows (E11, E12), (E21, E22) of the flow of (x, x') over t."""
        if self.kind > 0:
            s, c = (self.root * t).sin_cos()
        elif self.kind < 0:
            s, c = (self.root * t).sinh_cosh()
        else:
            s, c = t, arb(1)
        if self.kind:
            s = s / self.root
        decay = (-self.g * t).exp()
        s, c = decay * s, decay * c
        gs = self.g * s
        return (c + gs, s), (-self.k * s, c - gs)


class Oscillator(Spring):
    """The oscillator's constants as balls, at the precision in force when it is made."""

    def __init__(self, gamma, omega, amplitude):
        super().__init__(arb(1), arb(gamma))
        self.gamma, self.omega, self.amplitude = self.g, arb(omega), arb(amplitude)
        self.stiff = 1 - self.omega**2
        self.drag = 2 * self.gamma * self.omega
        self.d = self.stiff**2 + self.drag**2
        self.closed = bool(self.d > SMALL)

    def forced(self, theta):
        """The steady response (x, v) at drive phase theta: Re of A exp(i theta) / (1 - omega^2 + 2 i gamma omega)."""
        sin, cos = theta.sin_cos()
        x = self.amplitude * (self.stiff * cos + self.drag * sin) / self.d
        v = self.amplitude * self.omega * (self.drag * cos - self.stiff * sin) / self.d
        return x, v

    def flow(self, x, v, theta, t):
        """(x, v) after the time t from (x, v) at drive phase theta; all balls."""
        return Flight(self, x, v, theta)(t) if self.closed else self.flow_matrix(x, v, theta, t)

    def flow_matrix(self, x, v, theta, t):
        """The same by the exponential of the augmented matrix on (x, v, A cos, A sin): right at any D."""
        w = self.omega
        generator = arb_mat(4, 4, [0, 1, 0, 0, -1, -2 * self.gamma, 1, 0, 0, 0, 0, -w, 0, 0, w, 0])
        sin, cos = theta.sin_cos()
        start = arb_mat(4, 1, [x, v, self.amplitude * cos, self.amplitude * sin])
        end = (generator * t).exp() * start
        return end[0, 0], end[1, 0]


class Flight:
    """One free flight: call it with a time since its start for (x, v)."""

    def __init__(self, oscillator, x, v, theta):
        self.oscillator, self.x, self.v, self.theta = oscillator, x, v, theta
        if oscillator.closed:
            p, q = oscillator.forced(theta)
            self.free = (x - p, v - q)

    def __call__(self, t):
        o = self.oscillator
        if t.is_zero():
            return self.x, self.v
        if not o.closed:
            return o.flow_matrix(self.x, self.v, self.theta, t)
        p, q = o.forced(self.theta + o.omega * t)
        (a, b), (c, d) = o.homogeneous(t)
        x, v = self.free
        return p + a * x + b * v, q + c * x + d * v


def flow(gamma, omega, amplitude, theta, x, v, t, precision=PRECISION):
    """Exact (x, v) after t, as two balls; numbers or balls go in, gamma >= 0 and omega > 0."""
    with ctx.workprec(precision):
        return Oscillator(gamma, omega, amplitude).flow(arb(x), arb(v), arb(theta), arb(t))
