"""Validation of the product: experiments of the five documents and campaigns that search for false attitudes. Installed with
the extra ``validation``; one folder per document."""
