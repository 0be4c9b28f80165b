"""The maps of a scene, and their derivatives.

In: a scene and a state. Out: the stroboscopic map, its inverse and its return maps on the walls, derivatives of any
order by replay of the recorded impacts, the monodromy matrix as a product, trajectories, many states run on for
many periods. Start with `strobe`; `one_period` is what it runs, `derivatives` what makes it smooth.
"""
