"""Performance sheet of a sensor in the terms of ECSS-E-ST-60-20C. Each row has figures with intervals, method and conditions."""
