"""A second, slow route to the strobe: Taylor steps in mpmath, contacts by a look at a grid.

It checks orbit.py and, for walls that are not too stiff, soft.py only.
"""

from mpmath import cos, mpf, pi, sin, sqrt

from .scene import Soft

ORDER, STEP, LOOKS = 30, mpf(1) / 8, 24


def taylor(scene, x, v, theta, inside=None):
    """Coefficients of x about a time with drive phase theta, lowest first; inside: the soft wall it is beyond."""
    omega, factor = mpf(scene.omega), mpf(scene.amplitude)
    gamma, stiffness, force = mpf(scene.gamma), mpf(0), [mpf(0)] * ORDER
    if inside is not None:
        gamma, stiffness = mpf(inside.damping), mpf(inside.stiffness)
        force = wall_taylor(inside, omega, theta)
    series = [x, v]
    for k in range(ORDER - 2):
        pull = factor * cos(theta + k * pi / 2) + stiffness * (force[k] - series[k])
        pull -= 2 * gamma * (k + 1) * series[k + 1] + series[k]
        series.append(pull / ((k + 1) * (k + 2)))
        factor = factor * omega / (k + 1)
    return series


def wall_taylor(wall, omega, theta):
    """Coefficients of a wall's position about a time with drive phase theta."""
    if wall.motion is None:
        return [mpf(wall.position)] + [mpf(0)] * (ORDER - 1)
    factor, phase, m = mpf(wall.motion.amplitude), mpf(wall.motion.phase), wall.motion.harmonic
    series = []
    for k in range(ORDER):
        series.append(factor * cos(m * theta + phase + k * pi / 2))
        factor = factor * m * omega / (k + 1)
    series[0] += wall.position
    return series


def value(series, t):
    """A Taylor polynomial by Horner's rule."""
    total = mpf(0)
    for coefficient in reversed(series):
        total = total * t + coefficient
    return total


def derivative(series, t):
    """Slope of a Taylor polynomial."""
    return value([k * series[k] for k in range(1, len(series))], t)


def wall_at(wall, omega, theta):
    """Position and velocity of a wall at drive phase theta."""
    if wall.motion is None:
        return mpf(wall.position), mpf(0)
    b, phase, m = mpf(wall.motion.amplitude), mpf(wall.motion.phase), wall.motion.harmonic
    psi = m * theta + phase
    return wall.position + b * cos(psi), -b * m * omega * sin(psi)


def contact(scene, series, theta, length, held):
    """(time, side, wall) of the first contact, or of the way out of the wall on side `held`, seen within a step."""
    omega = mpf(scene.omega)
    for k in range(1, LOOKS + 1):
        hits = []
        for side, wall in scene.walls():

            def gap(u, side=side, wall=wall):
                gap = side * (wall_at(wall, omega, theta + omega * u)[0] - value(series, u))
                return -gap if side == held else gap

            low, high = length * (k - 1) / LOOKS, length * k / LOOKS
            if gap(high) < 0:
                for _ in range(110):
                    middle = (low + high) / 2
                    low, high = (low, middle) if gap(middle) < 0 else (middle, high)
                hits.append((high, side, wall))
        if hits:
            return min(hits)
    return None


def strobe(scene, x, v, phase=0.0, periods=1):
    """(x, v, [(time, side, speed)]) after whole periods, at mpmath's precision; it loops for ever in a chatter.

    A way out of a soft wall is not among the impacts.
    """
    omega = mpf(scene.omega)
    x, v, t, end, impacts = mpf(x), mpf(v), mpf(0), 2 * pi * periods / omega, []
    held = sum(side for side, wall in scene.walls() if side * (x - wall_at(wall, omega, phase)[0]) > 0)
    while t < end:
        inside = {0: None, -1: scene.left, 1: scene.right}[held]
        quick = 1 if inside is None else sqrt(1 + mpf(inside.stiffness)) + 2 * mpf(inside.damping)
        theta, length = phase + omega * t, min(STEP / quick, end - t)
        series = taylor(scene, x, v, theta, inside)
        hit = contact(scene, series, theta, length, held)
        u = hit[0] if hit else length
        x, v, t = value(series, u), derivative(series, u), t + u
        if hit:
            x, speed = wall_at(hit[2], omega, phase + omega * t)
            if held:
                held = 0
                continue
            impacts.append((t, hit[1], abs(v - speed)))
            if isinstance(hit[2], Soft):
                held = hit[1]
            else:
                v = speed - mpf(hit[2].restitution) * (v - speed)
    return x, v, impacts
