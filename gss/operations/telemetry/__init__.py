"""Values, limits, alarms, plots and exports."""
