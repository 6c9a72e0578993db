"""Motions, recordings and live poses in the browser, by viser.

`tracks` says what of a file can be shown, `stage` puts
bodies and sensors into a scene, `player` moves them in time, `live` shows poses as they come. The page
is served from the installed package; it loads nothing from anywhere else.
"""
