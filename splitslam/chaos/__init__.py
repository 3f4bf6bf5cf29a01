"""Plugs are pulled on purpose: links, processes and robots that break when told to."""
