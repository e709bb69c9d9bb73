"""A twin of the sensor to train on; its own process on a pseudo-terminal or a TCP port."""
