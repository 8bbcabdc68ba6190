"""SVG and HTML that stand alone, in light, dark and print."""
