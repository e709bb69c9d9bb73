"""Convert bytes to messages and back. Pure: ``feed`` returns the results, no call blocks, and no received data raises
an error."""
