"""The procedures published by Wang, Chen, Mei: Micromachines 2019, 10(9), 579, doi 10.3390/mi10090579.

======================================  ==============================================================
In the paper                            Here
======================================  ==============================================================
Slip: coif1 coefficient above 0.002 V   `slip`: the rule; `slide`: the slip in progress and its end
(no onset instant is stated)            `kink`: onset instant from the delay of the filter
(slides in one direction only)          `heading`: changes of the slip's direction
Three taxels of a column, 10 s          `column`: which channels; `texture`: the flow chart, online
Frequency of largest amplitude (MAF)    `spectrum`
Period and inclination (eqs 3 to 6)     `grooves`: cross-correlation, delays, ``D`` and ``alpha``
======================================  ==============================================================
"""
