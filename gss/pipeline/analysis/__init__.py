"""Sensor performance from a night's attitudes: accuracy, rates, sensitivity, noise, and problems with the data."""
