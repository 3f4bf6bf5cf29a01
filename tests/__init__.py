"""A package proper, since others (pynq) install a top-level `tests` of their own."""
