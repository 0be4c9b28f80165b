"""Implement the command line: run the analyses in a scene file.

A run of a scene file (TOML) writes a picture, data and a table, either all or none. Start with `studies/run.py`.
`studies/schema.py` and `studies/validate.py` define the valid contents of a scene file. `studies/scene_file_studies.py`
runs the analyses. `studies/results_dataset.py`, `studies/result_pictures.py` and `studies/results_report.py` make the
output."""
