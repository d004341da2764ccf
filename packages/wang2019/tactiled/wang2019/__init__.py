"""The procedures published by Wang, Chen, Mei: Micromachines 2019, 10(9), 579, doi 10.3390/mi10090579.

======================================  ==============================================================
In the paper                            Here
======================================  ==============================================================
Slip: coif1 coefficient above 0.002 V   `slip`: the rule, and the end of a slip
Three taxels of a column, 10 s          `texture`: which channels; the flow chart, online
Frequency of largest amplitude (MAF)    `spectrum`
Period and inclination (eqs 3 to 6)     `grooves`: cross-correlation, delays, ``D`` and ``alpha``
======================================  ==============================================================

`detectors` makes both for a suite, as the setting ``wang2019``.
"""
