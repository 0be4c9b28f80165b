"""Define the scene: an oscillator, its drive and its walls.

The modules convert numbers from a user or a file into `Scene` and `State`, frozen pytrees that satisfy all rules. They
also define the integer codes of results, and the name, domain and leaf of each parameter. Simulation and file formats
are in other packages. Start with `scene`. `check` contains the errors
and the general checks of arguments. `scene_checks` and `user_function_checks` contain the rules for
scenes. `soft_walls` relates stiffness to restitution.
"""
