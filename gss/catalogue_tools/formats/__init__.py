"""On-board formats: one file each, one registry, everything byte-exact both ways (docs/catalogue-formats.md)."""
