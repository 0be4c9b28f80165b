"""Studies of very many cells: where what has been computed is kept, and who computes it.

In: a study, cut into chunks of which each is a pure function of its number. Out: all of them as one xarray.Dataset, in
memory or in a Zarr store that a later run goes on with; worked out by threads of this process or by a Dask cluster.
Start with `study`; `filling` does the work.
"""
