"""A scene file, from its text to its picture: the command line's work.

In: TOML. Out: picture, data and table, all of them or none. Start with `run`; `schema` and `validate` say what a
file may hold, `compute` does what it asks, `results_dataset`, `figures` and `report` write it down.
"""
