"""Use cases, one file per user action. They perform the input and output for the packages that only compute."""
