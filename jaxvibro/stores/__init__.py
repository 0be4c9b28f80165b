"""Run and store studies of many cells, chunk by chunk.

In: a study, cut into chunks, each of which is a pure function of its number. Out: all chunks as one xarray.Dataset, in
memory or in a Zarr store from which a later run resumes. Threads of this process or a Dask cluster compute the chunks.
Start with `study`; `filling` does the work.
"""
