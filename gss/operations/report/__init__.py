"""Reports: figures, tables and plots that are rendered alike by a page, as HTML and as PDF."""
