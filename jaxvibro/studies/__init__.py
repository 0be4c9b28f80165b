"""Run the analyses in a scene file: the implementation of the command line.

A TOML file gives a picture, data and a table, written all together or not at all. Start with `run`. `schema` and
`validate` define the valid contents of a file. `compute` runs the analyses. `results_dataset`, `figures` and `report`
make the output.
"""
