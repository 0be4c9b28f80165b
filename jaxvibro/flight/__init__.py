"""Fly a mass between its walls, with certified detection of every event.

The input is the coefficients of a scene (`coefficients`), a state (`entry`) and a duration. The output is the path at
the end of the duration and a log of the impacts. A step extends to the next event, or as far as certainly no event
occurs (`event`). The exact flow advances the state (`flow`) and an impact law acts (`impact`). Inside a soft wall the
mass is another oscillator (`soft_contact`). Start with `integrate`, then `step`.
"""
