"""The instrument as seen from the ground: dictionary, protocol, host session, and a simulator that is its own process."""
