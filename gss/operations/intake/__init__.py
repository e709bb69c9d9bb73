"""Processing of data that the device sends: frames, results, banks and tables."""
