"""Several heads on one spacecraft: mountings, fused attitude, agreement, misalignment and drift."""
