"""Continue special points of branches in two parameters.

Input: a special point of a branch and two parameters. Output: a `Locus` with its points of codimension two, the
derivatives of the value of the point, families of loci for values of a third parameter, and the loci that emanate from
a point of codimension two. Start reading at `locus`. The equations are in `locus_equations`, the continuation loop is
in `locus_start`, and the loci that emanate from a point are in `switch`.
"""
