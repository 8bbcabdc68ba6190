"""Pictures and pages: SVG and HTML that stand alone, in light, dark and print.

    plot       axes, lines, dots, bars; scale: from values to places
    pictures   what a drive engineer looks at to trust a table; lissajous: the tracks
    page       an HTML page of tables and pictures; picture_file: an SVG file; style: their CSS

It knows numbers and their units, tables and conditionings; not where they were measured.
"""
