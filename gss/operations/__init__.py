"""Use cases, one file per user action: the imperative shell around the pure packages."""
