"""Self-contained SVG and HTML, for light and dark screens and for print."""
