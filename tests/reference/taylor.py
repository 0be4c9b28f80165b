"""Taylor series of a clearance with a bound on what is cut off; plain arithmetic, so floats and arrays both do.

clearance c = side * (x_wall - x), which is >= 0 between the walls.
"""

ORDER = 8
FACTORIAL = [1, 1, 2, 6, 24, 120, 720, 5040, 40320]


def response(gamma, omega, x, v, drive, quadrature, more=()):
    """x and its derivatives up to ORDER - 1; drive = A cos(theta), quadrature = -A sin(theta); more: further forces,
    each with its derivatives."""
    force = [drive, omega * quadrature]
    for _ in range(ORDER - 4):
        force.append(-omega * omega * force[-2])
    series = [x, v]
    for k in range(ORDER - 2):
        series.append(force[k] + sum(own[k] for own in more) - 2 * gamma * series[k + 1] - series[k])
    return series


def motion(rate, cosine, sine):
    """Derivatives 0 to ORDER - 1 of B cos(psi), psi' = rate, from B cos(psi) and B sin(psi)."""
    series = [cosine, -rate * sine]
    for _ in range(ORDER - 2):
        series.append(-rate * rate * series[-2])
    return series


def ceiling(gamma, omega, amplitude, energy, radius, grown):
    """Bound of the ORDER-th derivative of x within radius of a point where hypot(x, v) <= energy.

    d/dt hypot(x, v) lies between -2 gamma hypot - A and A; grown >= exp(2 gamma radius) pays for going backward.
    """
    on_x, on_v, on_force = 1.0, 0.0, 0.0
    for _ in range(ORDER):
        on_force = on_force * omega + abs(on_v)
        on_x, on_v = -on_v, on_x - 2 * gamma * on_v
    return (abs(on_x) + abs(on_v)) * (energy + amplitude * radius) * grown + amplitude * on_force


def spread(series, first, radius, bound):
    """How far the derivative number `first` can move from its central value within radius."""
    total = bound * radius ** (ORDER - first) / FACTORIAL[ORDER - first]
    for k in range(ORDER - 1, first, -1):
        total = total + abs(series[k]) * radius ** (k - first) / FACTORIAL[k - first]
    return total
