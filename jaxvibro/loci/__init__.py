"""Loci: special points of branches along two parameters.

In: a special point of a branch and two parameters. Out: `Locus`, with its points of codimension two; derivatives of
the point's value; families along a third parameter; what leaves a point of codimension two. Start with `locus`; the
equations are in `extended_system`, the loop in `track`, `switch` in `leaving`.
"""
