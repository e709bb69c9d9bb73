"""SQLAlchemy models and one module of queries per subject. All SQL is in this package."""
