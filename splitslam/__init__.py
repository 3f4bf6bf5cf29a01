"""What the edge agent and the map service share: types, wire contract, codec, commands."""

__version__ = "0.2.0"
