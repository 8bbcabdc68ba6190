"""Properties of a module by its objects, given ``read(place)``: by SDO, EDS or live dictionary. Pure."""
