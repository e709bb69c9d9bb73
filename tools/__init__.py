"""Development tools; nothing here is shipped to users."""
