"""What a module is, by its objects, from ``read(place)``: SDO, an EDS, or a live dictionary. Pure."""
