"""Bytes to messages and back. Pure: feed(bytes) gives events, nothing blocks, nothing raises on what the line brings."""
