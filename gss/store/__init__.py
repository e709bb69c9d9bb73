"""SQLAlchemy models and one repository per aggregate. All SQL is here."""
