"""The flight of a mass between its walls, certified from event to event.

In: a scene's `coefficients`, a state (`entry`), a time to go. Out: the path at the end of that time, and a log of
the impacts on the way. A step goes to the next event or as far as surely none is (`event`), the exact flow carries
it (`flow`), an impact law acts (`impact`); soft walls are another oscillator (`soft_contact`). Start with
`integrate`, then `step`.
"""
