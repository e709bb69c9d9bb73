"""Convert bytes to messages and back. Pure: feed(bytes) returns events, nothing blocks, and no received data raises an error."""
