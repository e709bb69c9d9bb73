"""Star tracking from frame to frame."""
