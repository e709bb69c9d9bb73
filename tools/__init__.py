"""Development tools, which are not shipped to users."""
