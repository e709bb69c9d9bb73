"""The line to the device: the link that owns the port, its events and their dispatch, raw captures and the contact log."""
