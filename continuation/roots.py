"""Find roots of functions of one variable."""


def find_bracketed_root(function, upper_end):
    """Find the root of a function between 0 and `upper_end`, accurate to 1e-14, by Chandrupatla's method.

    Parameters
    ----------
    function : callable
        Function of one number with different signs at 0 and `upper_end`.
    upper_end : float
        Upper end of the interval.

    Returns
    -------
    float
        The root, accurate to ``1e-14*(1 + abs(root))``.

    Notes
    -----
    The method combines bisection and inverse quadratic interpolation (Advances in Engineering Software 28, 145, 1997).
    SciPy's root finders are not used, because importing them would take as long as all other imports.
    """
    newest_point, opposite_point, previous_point = (
        upper_end,
        0.0,
        0.0,
    )  # newest point, point of opposite sign, previous point
    f_newest, f_opposite, f_previous = function(newest_point), function(opposite_point), 0.0
    step_fraction = 0.5
    while True:
        trial_point = newest_point + step_fraction * (opposite_point - newest_point)
        value = function(trial_point)
        if value * f_newest > 0:
            previous_point, f_previous = newest_point, f_newest
        else:
            opposite_point, f_opposite, previous_point, f_previous = newest_point, f_newest, opposite_point, f_opposite
        newest_point, f_newest = trial_point, value
        best_point = newest_point if abs(f_newest) < abs(f_opposite) else opposite_point
        min_fraction = 1e-14 * (1.0 + abs(best_point)) / abs(opposite_point - newest_point)
        if f_newest == 0 or min_fraction > 0.5:
            return best_point
        point_ratio, value_ratio = (
            (newest_point - opposite_point) / (previous_point - opposite_point),
            (f_newest - f_opposite) / (f_previous - f_opposite),
        )
        step_fraction = 0.5
        if value_ratio * value_ratio < point_ratio and (1.0 - value_ratio) ** 2 < 1.0 - point_ratio:
            step_fraction = f_newest / (f_opposite - f_newest) * f_previous / (f_opposite - f_previous) + (
                previous_point - newest_point
            ) / (opposite_point - newest_point) * f_newest / (f_previous - f_newest) * f_opposite / (
                f_previous - f_opposite
            )
        step_fraction = min(max(step_fraction, min_fraction), 1.0 - min_fraction)
