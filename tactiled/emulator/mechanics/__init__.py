"""The mechanics of one bump of the skin on a surface: materials, and a ladder of contact models.

Units are mm, N, MPa (N/mm2), s. A model sees one taxel at a time or many at once, knows neither arrays nor
boards, and reads no clock.
"""
