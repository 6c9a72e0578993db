"""Pictures and films of motions without a display.

`raster` makes pixels of triangles, `scene` a picture of bodies, `film` what is written.
"""
