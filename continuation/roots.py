"""Where a function of one number changes its sign."""


def sign_change(function, end):
    """Where a function changes its sign between 0 and an end, to 1e-14: Chandrupatla's mix of halving and inverse
    quadratics (Advances in Engineering Software 28, 145, 1997). SciPy's roots take as long to load as all the rest."""
    a, b, c = end, 0.0, 0.0  # the newest, that with the other sign, the one before
    f_a, f_b, f_c = function(a), function(b), 0.0
    share = 0.5
    while True:
        new = a + share * (b - a)
        value = function(new)
        if value * f_a > 0:
            c, f_c = a, f_a
        else:
            b, f_b, c, f_c = a, f_a, b, f_b
        a, f_a = new, value
        best = a if abs(f_a) < abs(f_b) else b
        least = 1e-14 * (1.0 + abs(best)) / abs(b - a)
        if f_a == 0 or least > 0.5:
            return best
        xi, phi = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        share = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)
        share = min(max(share, least), 1.0 - least)
