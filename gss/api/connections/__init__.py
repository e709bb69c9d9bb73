"""Limits on connections, so that clients without an account cannot use up the server's file descriptors, time or log."""
