"""Use cases: one file per thing a user does. The imperative shell round the pure rooms below."""
