"""The explorer: a page in a browser for one scene, served on this machine.

In: a scene, and what a user asks on the page. Out: pictures, numbers, and all that was asked as lines of Python. Start
with `lines`, which says what can be asked; `session` is one page's state; `server` the only file that knows of HTTP.
"""
