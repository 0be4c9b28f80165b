"""Run and store studies of many cells, chunk by chunk.

A study is divided into chunks, and each chunk is a pure function of its number. Threads of this process or a Dask
cluster compute the chunks. The result is one xarray.Dataset, in memory or in a Zarr store from which a later run
resumes. Start with `stores/study.py`; `stores/study.py` does the work.
"""
