"""Slip told by what sliding does, on arrays whose shear or pressure cannot be measured."""
