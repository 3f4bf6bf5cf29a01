"""Tests of the cores on Verilator, bit for bit against `fpga_overlay.golden`."""
