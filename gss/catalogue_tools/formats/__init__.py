"""On-board formats: one module per format and a registry. Encoding and decoding are byte-exact
(docs/catalogue-formats.md)."""
