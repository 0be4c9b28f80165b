"""The scene: an oscillator, its drive and its walls.

In: numbers, as a user or a file gives them. Out: `Scene` and `State`, frozen pytrees that have passed every rule;
the codes that lanes are told by; what a parameter is called, where it may lie and which leaf of a scene it is. No
flight, no file. Start with `scene`; `check` has the rules and the words of every refusal, `soft_walls` what
stiffness means for restitution.
"""
