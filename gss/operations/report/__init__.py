"""Reports with values, tables and plots, rendered in the same layout on a page, as HTML and as PDF."""
