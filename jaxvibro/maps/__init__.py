"""Maps of a scene and their derivatives.

Input is a scene and a state. Output is the stroboscopic map, its inverse and its return maps on the walls, derivatives
of any order by replay of the recorded impacts, the monodromy matrix as a product, trajectories, and iterates of many
states over many periods. Start with `strobe`; `reference_strobe` computes a period, and `derivatives` makes it
differentiable.
"""
