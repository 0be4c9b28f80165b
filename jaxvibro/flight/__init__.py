"""Fly a mass between its walls, with certified detection of every event.

The input is the coefficients of a scene (`flight_coefficients`), a state (`path_start`) and a duration. The output is
the path at the end of the duration and a log of the impacts. A step ends at the next event, or at a time before which
certainly no event occurs (`event_certificates`). The flow advances the state (`protocols`). It is exact for a
spring and a damper. An impact law acts at a rigid wall (`impact`). Inside a soft wall with spring and damper the mass
is another oscillator (`motion_in_soft_wall`). Start with `integration_loop`, then `flight_step`.
"""
