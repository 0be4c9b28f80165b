"""Define the matrix of a flight, the derivative of the final state with respect to the initial state."""


def apply_matrix(matrix, x, v):
    """Multiply the matrix of a flight by a vector.

    Parameters
    ----------
    matrix : tuple of array
        Entries (p00, p01, p11) with p10 = -p01 for the linear oscillator, or (p00, p01, p11, p10).
    x : array
        First component of the vector.
    v : array
        Second component of the vector.

    Returns
    -------
    x : array
        First component of the product.
    v : array
        Second component of the product.
    """
    p00, p01, p11, *p10 = matrix
    return p00 * x + p01 * v, p11 * v + p10[0] * x if p10 else p11 * v - p01 * x


def matrix_by_rows(matrix):
    """Return the four entries of a matrix row by row.

    Parameters
    ----------
    matrix : tuple of array
        Matrix as in `apply_matrix`.

    Returns
    -------
    tuple of array
        Entries (p00, p01, p10, p11).
    """
    p00, p01, p11, *p10 = matrix
    return p00, p01, p10[0] if p10 else -p01, p11


def determinant(matrix):
    """Return the determinant of the matrix of a flight.

    Parameters
    ----------
    matrix : tuple of array
        Matrix as in `apply_matrix`.

    Returns
    -------
    array
        Determinant.
    """
    p00, p01, p11, *p10 = matrix
    return p00 * p11 - p01 * p10[0] if p10 else p00 * p11 + p01 * p01
