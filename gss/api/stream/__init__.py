"""Event stream to the pages: each message is serialized once and sent to all listeners."""
