"""Interface to the star tracker: dictionary, protocol, host session, and a simulator that runs as a separate
process."""
