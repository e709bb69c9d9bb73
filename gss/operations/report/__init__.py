"""Reports with values, tables and plots. A page, the HTML file and the PDF file show the same content."""
