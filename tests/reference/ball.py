"""The exact flow of x'' + 2 gamma x' + x = A cos(theta) + ..., theta = theta0 + omega t, in ball arithmetic
(python-flint); the drive may have further terms A_j cos(m_j theta + phase_j).

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


class Tone:
    """A term of the drive, A cos(m theta + phase), and what answers it."""

    def __init__(self, gamma, omega, amplitude, harmonic, phase):
        self.amplitude, self.harmonic, self.phase = arb(amplitude), harmonic, arb(phase)
        self.rate = harmonic * omega
        self.stiff, self.drag = 1 - self.rate**2, 2 * gamma * self.rate
        self.d = self.stiff**2 + self.drag**2

    def wave(self, theta):
        """A cos and A sin of its angle."""
        sin, cos = (self.harmonic * theta + self.phase).sin_cos()
        return self.amplitude * cos, self.amplitude * sin

    def forced(self, theta):
        """The steady answer (x, v): Re of A exp(i psi) / (1 - rate^2 + 2 i gamma rate)."""
        cos, sin = self.wave(theta)
        return (self.stiff * cos + self.drag * sin) / self.d, self.rate * (self.drag * cos - self.stiff * sin) / self.d


class Oscillator(Spring):
    """The oscillator's constants as balls, at the precision in force when it is made; drive: (amplitude, harmonic,
    phase) of the terms beside A cos(theta)."""

    def __init__(self, gamma, omega, amplitude, drive=()):
        super().__init__(arb(1), arb(gamma))
        self.gamma, self.omega, self.amplitude = self.g, arb(omega), arb(amplitude)
        self.tones = [Tone(self.gamma, self.omega, *term) for term in ((amplitude, 1, 0.0), *drive)]
        self.closed = all(bool(tone.d > SMALL) for tone in self.tones)

    def force(self, theta):
        """The drive's force."""
        return sum((tone.wave(theta)[0] for tone in self.tones), arb(0))

    def forced(self, theta):
        """The steady response (x, v) at drive phase theta."""
        x, v = zip(*(tone.forced(theta) for tone in self.tones), strict=True)
        return sum(x, arb(0)), sum(v, arb(0))

    def flow(self, x, v, theta, t):
        """(x, v) after the time t from (x, v) at drive phase theta; all balls."""
        return Flight(self, x, v, theta)(t) if self.closed else self.flow_matrix(x, v, theta, t)

    def flow_matrix(self, x, v, theta, t):
        """The same by the exponential of the augmented matrix on (x, v, A cos, A sin, ...): right at any D."""
        size, start = 2 + 2 * len(self.tones), [x, v]
        rows = [[arb(0)] * size for _ in range(size)]
        rows[0][1], rows[1][0], rows[1][1] = arb(1), arb(-1), -2 * self.gamma
        for k, tone in zip(range(2, size, 2), self.tones, strict=True):
            rows[1][k], rows[k][k + 1], rows[k + 1][k] = arb(1), -tone.rate, tone.rate
            start += tone.wave(theta)
        end = (arb_mat(size, size, [entry for row in rows for entry in row]) * t).exp() * arb_mat(size, 1, start)
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
