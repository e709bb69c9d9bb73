"""Several star-tracker heads on one body: fused attitude, agreement, and the misalignment between two heads."""
