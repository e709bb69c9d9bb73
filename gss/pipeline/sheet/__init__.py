"""Performance sheet of a sensor in the terms of ECSS-E-ST-60-20C: each row is a figure with interval, method and
conditions."""
