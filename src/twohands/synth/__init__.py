"""The generator of labelled pictures.

Its rooms, from the ground up: `backgrounds` and `production` need no other; `scene` is who does what before which
camera; `render` draws it; `sets` puts all together into pictures in folders, caches and streams.
"""
