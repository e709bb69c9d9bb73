"""What arrives from the device without being requested: frames, results, banks and tables find their place."""
