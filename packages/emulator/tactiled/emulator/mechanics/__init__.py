"""Mechanics of the bumps of the skin on a surface: materials, and contact models of growing cost.

Units are mm, N, MPa (N/mm2), s. A model computes many taxels at once, independent of array and board, and
reads no clock.
"""
