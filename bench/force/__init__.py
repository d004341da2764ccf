"""Force calibration on drawn rigs: error against time, baselines, intervals, a hold of an hour, cost."""
