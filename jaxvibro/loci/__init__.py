"""Continue special points of branches in two parameters.

In: a special point of a branch and two parameters. Out: `Locus` with its points of codimension two, derivatives of the
value of the point, families along a third parameter, and the loci that emanate from a point of codimension two. Start
reading at `locus`. The equations are in `extended_system`, the loop in `track`, and `switch` in `locus_switching`.
"""
