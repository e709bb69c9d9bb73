"""The star tracker as the ground sees it: dictionary, protocol, host session, and a simulator that runs as a separate process."""
