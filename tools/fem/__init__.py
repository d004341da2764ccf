"""Finite elements of one taxel: mesh, linear compliance, and press-and-slide with friction (optional extra).

Only `contact` and `command` need `felupe`, the optional extra ``tactiled[fem]``; everything else of tactiled
reads the reference data that they wrote into ``config/contact/``.
"""
