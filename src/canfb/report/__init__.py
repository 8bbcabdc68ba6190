"""Pictures and pages: SVG and HTML that stand alone, in light, dark and print.

    plot       axes with round ticks, lines, dots, bars
    pictures   what a drive engineer looks at to trust a table and limits
    page       an HTML page of tables and pictures, an SVG file, and the CSS of both

It knows numbers and their units, tables and conditionings; not where they were measured.
"""
