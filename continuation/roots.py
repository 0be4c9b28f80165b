"""Find roots of functions of one variable."""


def find_sign_change(function, upper):
    """Find the root of a function between 0 and `upper` to 1e-14 by Chandrupatla's method.

    Parameters
    ----------
    function : callable
        Function of one number with different signs at 0 and `upper`.
    upper : float
        Upper end of the interval.

    Returns
    -------
    float
        The root.

    Notes
    -----
    The method combines bisection and inverse quadratic interpolation (Advances in Engineering Software 28, 145, 1997).
    Loading SciPy's root finders would take as long as loading everything else.
    """
    newest, opposite, previous = upper, 0.0, 0.0  # newest point, point of opposite sign, previous point
    f_newest, f_opposite, f_previous = function(newest), function(opposite), 0.0
    fraction = 0.5
    while True:
        trial = newest + fraction * (opposite - newest)
        value = function(trial)
        if value * f_newest > 0:
            previous, f_previous = newest, f_newest
        else:
            opposite, f_opposite, previous, f_previous = newest, f_newest, opposite, f_opposite
        newest, f_newest = trial, value
        best = newest if abs(f_newest) < abs(f_opposite) else opposite
        min_fraction = 1e-14 * (1.0 + abs(best)) / abs(opposite - newest)
        if f_newest == 0 or min_fraction > 0.5:
            return best
        xi, phi = (newest - opposite) / (previous - opposite), (f_newest - f_opposite) / (f_previous - f_opposite)
        fraction = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            fraction = f_newest / (f_opposite - f_newest) * f_previous / (f_opposite - f_previous) + (
                previous - newest
            ) / (opposite - newest) * f_newest / (f_previous - f_newest) * f_opposite / (f_previous - f_opposite)
        fraction = min(max(fraction, min_fraction), 1.0 - min_fraction)
