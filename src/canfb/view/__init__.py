"""What a module is, by its objects: PDO map, layout of a sample, limits in force.

Pure. The objects come from ``read(place)``, whose source may be SDO, an EDS with a configuration, or a live
dictionary; None stands for what is not there. So all who look at a module from outside see the same.
"""
