"""A drive in three dimensions, live in a browser: what there is to see, and the server that shows it (viser)."""
