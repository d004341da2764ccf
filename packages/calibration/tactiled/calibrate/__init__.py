"""``tactiled calibrate``: fit a force calibration to a log and the record of a force sensor."""
