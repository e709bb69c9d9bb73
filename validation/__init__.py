"""Validation of the product: experiments of the five documents, and campaigns that search for false attitudes.

The extra ``validation`` installs this package. It has one folder per document."""
