"""Symmetric orbits between soft walls at -1 and 1, once in and out of each a period, in as many digits as wanted.

Half an orbit: it enters the right wall at drive phase theta with speed u, stays for a time s, and is at -1 with speed u
half a period after it entered: three equations in (theta, u, s), each flow in closed form. Their derivative is
singular where the branch folds.
"""

from mpmath import cos, cosh, det, exp, findroot, im, matrix, mp, mpc, mpf, pi, re, sinh, sqrt


def flow(gamma, stiffness, time):
    """The matrix of (x, v) over a time of x'' + 2 gamma x' + stiffness x = 0."""
    rate = sqrt(mpc(gamma * gamma - stiffness))
    c, s = re(cosh(rate * time)), re(sinh(rate * time) / rate)
    return exp(-gamma * time) * matrix([[c + gamma * s, s], [-stiffness * s, c - gamma * s]])


class Half:
    """Half an orbit of a scene (A, gamma, gamma2, k2) at a frequency."""

    def __init__(self, scene, omega, theta, u, stay):
        self.amplitude, self.gamma, self.gamma2, k2 = map(mpf, scene)
        self.omega, self.theta, self.u, self.stay = omega, theta, u, stay
        self.stiff = 1 + k2

    def forced(self, gamma, stiffness, theta):
        """((x, v) of the drive's response at a phase, its derivative by the phase)."""
        here = self.amplitude * exp(1j * theta) / (stiffness - self.omega**2 + 2j * gamma * self.omega)
        one = matrix([re(here), -self.omega * im(here)])
        return one, matrix([-im(here), -self.omega * re(here)])

    def within(self, time):
        """(x - 1, v) so long after the mass entered, and its derivatives by theta, u and the time."""
        first, turned = self.forced(self.gamma2, self.stiff, self.theta)
        last, later = self.forced(self.gamma2, self.stiff, self.theta + self.omega * time)
        rest, matrix_ = matrix([-1 / self.stiff, 0]), flow(self.gamma2, self.stiff, time)
        state = matrix_ * (matrix([0, self.u]) - first - rest) + last + rest
        pull = self.amplitude * cos(self.theta + self.omega * time) - 1
        pull -= 2 * self.gamma2 * state[1] + self.stiff * state[0]
        return state, (later - matrix_ * turned, matrix_[:, 1], matrix([state[1], pull]))

    def equations(self):
        """(F, dF/d(theta, u, s))."""
        state, (by_theta, by_u, by_stay) = self.within(self.stay)
        start, turned = self.forced(self.gamma, 1, self.theta + self.omega * self.stay)
        end, later = self.forced(self.gamma, 1, self.theta + pi)
        free = flow(self.gamma, 1, pi / self.omega - self.stay)
        away = state + matrix([1, 0]) - start
        last = free * away + end
        less = matrix([[0, 1], [-1, -2 * self.gamma]]) * free * away
        columns = free * (by_theta - turned) + later, free * by_u, free * (by_stay - self.omega * turned) - less
        values = [state[0], last[0] + 1, last[1] + self.u]
        rows = matrix([[each[0] for each in (by_theta, by_u, by_stay)], *([c[k] for c in columns] for k in (0, 1))])
        rows[2, 1] += 1
        return values, rows


def fold(scene, omega, theta, u, stay):
    """The frequency of the saddle-node near these numbers; scene: (A, gamma, gamma2, k2)."""

    def system(omega, theta, u, stay):
        values, rows = Half(scene, omega, theta, u, stay).equations()
        return [*values, det(rows)]

    return findroot(system, (omega, theta, u, stay), tol=mpf(10) ** (-2 * mp.dps + 8))[0]


def grazing(amplitude, gamma):
    """The higher frequency at which the motion without impacts has amplitude 1."""
    amplitude, half = mpf(amplitude), 1 - 2 * mpf(gamma) ** 2
    return sqrt(half + sqrt(half * half - 1 + amplitude * amplitude))


def height(scene, omega, theta, u):
    """The largest x of a stay within the right wall that begins at a drive phase with a speed."""
    half = Half(scene, omega, theta, u, None)
    turn = findroot(lambda time: half.within(time)[0][1], (0, pi / sqrt(half.stiff)), solver="anderson")
    return 1 + half.within(turn)[0][0]
