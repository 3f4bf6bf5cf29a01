"""The cores without a board: Verilated, and behind PYNQ's own device interface."""
