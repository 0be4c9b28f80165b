"""Explore a scene in a browser page that this machine serves.

The input is a scene and the actions of a user on the page. The output is figures, numbers, and all actions as Python
code. `page_calls` defines the calls that a page can make, `session` is the state of one page, and `server` is the only
module that uses HTTP.
"""
