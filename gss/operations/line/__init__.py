"""The line and what came over it: reception, captures, contacts, gaps."""
