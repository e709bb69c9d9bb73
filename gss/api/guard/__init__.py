"""Access control: origin, identity and permission of each request, and the headers of every response."""
