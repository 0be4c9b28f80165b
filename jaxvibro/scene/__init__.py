"""Define the scene: an oscillator, its drive and its walls.

The modules turn numbers from a user or a file into `Scene` and `State`, frozen pytrees that satisfy every rule. They
also define the integer codes of lanes, and the name, domain and leaf of each parameter. Flight and files are elsewhere.
Start with `scene`. `check` has the rules and their messages, and `soft_walls` relates stiffness to restitution.
"""
