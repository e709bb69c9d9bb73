"""Telemetry: values, limits, alarms, archive, plots and exports."""
