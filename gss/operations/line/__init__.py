"""The line to the device: the link that owns it, its events and their dispatch, raw captures, contacts and gaps."""
