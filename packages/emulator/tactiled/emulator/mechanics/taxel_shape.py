"""Dimensions of one taxel: the chip, the rubber base and the bump above it, in millimetres.

Shapes are assumed where the paper gives none (Wang et al. 2019, figure 1 has heights only).
"""

CHIP_MM = 0.5  # paper: adhesive layer that holds the chips
BASE_MM = 0.4  # assumed: half of the 0.8 mm of PDMS
RIM_MM = 0.1  # assumed: straight side of the bump
CAP_MM = 0.3  # assumed: height of its spherical cap; base + rim + cap are the paper's 0.8 mm
BUMP_MM = RIM_MM + CAP_MM  # height of the bump: pressed deeper, the plate meets the base
BUMP_RADIUS_MM = 1.25  # assumed
