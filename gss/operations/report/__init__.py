"""A report: what was measured, as figures, tables and plots that a page, a sheet of HTML and a PDF show alike."""
